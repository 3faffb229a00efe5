"""A New Era pump on its line, as `drivers.counted.counter.Counter` (firmware_notes/new_era.md)."""

import itertools
import math
import random
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from enum import Enum

from drivers.clock import Clock
from drivers.counted.counter import Reading, Trust
from drivers.dosing.pump import Count
from drivers.serial_line import NoReplyError, PortOpener, SerialLine, open_port
from tankrig.errors import DeviceError

from . import wire
from .settings import NewEraSettings

ATTEMPTS = 3
GREETINGS = 3
IGNORED = 4
"""Commands that a pump may ignore, or answer with an alarm, after its power has come."""
WATCHDOG_EARLY = 0.9
"""Part of the watchdog's time that a pump surely moves on for (unverified)."""
LARGEST_IN_UL_MM = 14.0
_DIGITS, _DIGITS_AND_POINT = 9999, 5
_VERSION = re.compile(r"NE\d+X?V[\d.]+")
_SHAPES = {
    command: re.compile(pattern)
    for command, pattern in {
        "VER": r"[A-Z].*",
        "DIA": r"[\d.]+",
        "RAT": r"[\d.]+[UM][MH]",
        "VOL": r"[\d.]+[UM]L",
        "DIR": r"INF|WDR|REV",
        "FUN": r"[A-Z]{3}.*",
        "PHN": r"\d+",
        "SAF": r"\d+",
        "PF": r"[01]|\?",
    }.items()
}
"""What the pump answers to a query; a reply of another shape belongs to another command."""


class Mode(Enum):
    """How the pump is spoken to."""

    SAFE = "packets with checksums; its watchdog minds"
    BASIC = "lines; its watchdog does not mind"
    UNCERTAIN = "what would have told was lost, or nobody has asked yet"


class NewEraPump:
    """An NE-500 or NE-1000.

    It is in Safe mode, where packets have checksums and its watchdog minds, only while it is used: the watchdog also
    sounds an alarm when nothing moves and nothing is asked.

    Its program is phase 1 (pump the ordered volume) and phase 2 (stop). Ticks are thousandths of its unit of volume.

    Parameters
    ----------
    settings
        From the rig file.
    name
        For messages.
    clock, opener
        Its time, and how its port is opened.
    """

    lost_by_stopping, stroke, counter_restarts = 0, 0, True

    def __init__(self, settings: NewEraSettings, name: str, clock: Clock, opener: PortOpener = open_port) -> None:
        self._settings, self._name, self.model = settings, name, ""
        self._unit, self._unit_ul, self.order = _unit(settings.diameter_mm)
        self.tick_ul, self.ticks_per_ul = self._unit_ul / 1000.0, 1000.0 / self._unit_ul
        self.margin, self.most_doubt, self.increment = 3 * self.order, 5 * self.order, 10 * self.order
        self.on_its_own = math.floor(WATCHDOG_EARLY * settings.watchdog_s / self.duration_s(1))
        self._enter = f"{settings.address}SAF{settings.watchdog_s}\r".encode()
        self._stop = 2 * wire.packet(f"{settings.address}STP") + 2 * f"\r{settings.address}STP".encode() + b"\r"
        status = f"{settings.address}"
        self._wake = b"\r" + IGNORED * wire.packet(status) + b"\r" + IGNORED * f"{status}\r".encode()
        self._heard_alarms: set[str] = set()
        self._alarms_told = 0
        self._ready_in: tuple[int, int] | None = None
        self._gap = self._stopping = True
        self._marks = itertools.cycle(random.sample(range(3, 41), 38))  # not those of the last program
        self.repeats = self._tells_power_failure_mode = False
        self._mode: Mode = Mode.UNCERTAIN
        self._shown_at_rest, self._count_at_rest = "", Count.exactly(0)
        self._line = SerialLine(settings.port, settings.baud, name, self._frames, self._heard, clock, opener)

    # -- who -----------------------------------------------------------------------------------------------------------

    def greet(self) -> None:
        """See who it is, and whether it begins anew by itself when its power comes back.

        After power-up it may ignore some commands and answers one with an alarm: status queries, in the form of either
        mode, take their place.
        """
        for _ in range(GREETINGS):
            self._line.send(self._wake, replies=2 * IGNORED + 2)
            with suppress(NoReplyError):
                self.model = self._ask("VER", _SHAPES["VER"].fullmatch, attempts=1).data
                break
        else:
            raise DeviceError(
                f"{self._name}: no New Era pump answers there at {self._settings.baud} baud; check port, baud, address "
                f"{self._settings.address}, cable and power"
            )
        if not _VERSION.fullmatch(self.model):
            raise DeviceError(f"{self._name}: {self.model!r} answers there, which is no New Era pump; correct the port")
        power_failure_mode = self._query("PF")
        self._tells_power_failure_mode = power_failure_mode != "?"
        self.repeats = power_failure_mode == "1"
        if not self._tells_power_failure_mode and self._settings.power_failure_mode is None:
            raise DeviceError(
                f"{self._name}: does not know the command PF; see on its keypad that it does not start by itself after "
                'a power failure, and give power_failure_mode = "off" in the rig file'
            )

    def set_up(self) -> None:
        """Power failure mode off, so that no program starts by itself; and the rate, if it can do that."""
        if self._tells_power_failure_mode and self._query("PF") != "0":
            self._set("PF", "0")
        self.repeats = False
        self._set_rate()

    def _set_rate(self) -> None:
        """The rate of phase 1, which depends on the diameter that is set."""
        rate, unit = rate_in_unit(self._settings.rate_ml_per_min)
        self._set("PHN", "1")
        self._set("FUN", "RAT")
        refused = self._ask(f"RAT{rate}{unit}", _done_or_refused).error
        if refused or not _same_setting(found := self._query("RAT"), f"{rate}{unit}"):
            raise DeviceError(
                f"{self._name}: rate_ml_per_min = {self._settings.rate_ml_per_min:g} is not one it can do with a "
                f"syringe of {self._settings.diameter_mm:g} mm "
                f"({refused or f'it reads back as {found}'}); give another rate"
            )

    # -- counting ------------------------------------------------------------------------------------------------------

    def answers(self) -> bool:
        """Whether it answers a question for its version, or with an alarm, asked once."""
        try:
            self._once("VER", _SHAPES["VER"].fullmatch)
        except NoReplyError:
            return False
        return True

    def read(self) -> Reading:
        """Bring it to rest if it moves, and read its counter."""
        if self._mode is Mode.BASIC and self._shows_the_same():
            return Reading(self._count_at_rest)
        error: DeviceError | None = None
        for _ in range(2 * ATTEMPTS):
            try:
                if not self._mark():
                    self.stop()
                    continue
                counted = self._ask("DIS", lambda text: wire.dispensed(text, self._unit_ul) is not None)
            except NoReplyError as missing:
                error = missing
                if not self._line.patient:
                    break
                continue
            count = wire.dispensed(counted.data, self._unit_ul)
            if counted.status == "S" and count:
                self._shown_at_rest, self._count_at_rest = counted.data, count
                return self._reading(count)
            self.stop()
        raise error or NoReplyError(f"{self._name}: does not stop; pull its power")

    def _shows_the_same(self) -> bool:
        """Whether it stands as it was left, at rest with the same count: then nothing has moved.

        Asked in Basic mode, as the pump stores each change of mode. Whatever else it says is asked again in Safe mode.
        """
        try:
            found = self._line.exchange(f"{self._settings.address}DIS\r".encode(), self._of_this_pump)
        except NoReplyError:
            self._mode = Mode.UNCERTAIN
            return False
        return found.status == "S" and found.data == self._shown_at_rest

    def _reading(self, count: Count) -> Reading:
        alarms, self._heard_alarms = self._heard_alarms, set()
        gap, self._gap = self._gap, True  # until the next dose sets off, nothing is known of alarms between
        trust = Trust.UNWITNESSED if gap else Trust.EXACT
        if "T" in alarms:  # it may have taken the place of another that was not told yet
            trust = Trust.TIMED_OUT
        if "S" in alarms:
            trust = Trust.STALLED
        if "R" in alarms:
            trust = Trust.RESTARTED
        why = next((wire.ALARMS[alarm] for alarm in "RSEOT" if alarm in alarms), "it was stopped")
        return Reading(count, trust, why)

    def _mark(self) -> bool:
        """Have it select a phase and say which: replies from before are then past. False if it does not rest."""
        mark = next(self._marks)
        if self._ask(f"PHN{mark}", _done_or_refused).error:
            return False
        owed = self._line.owed
        self._ask("PHN", lambda text: wire.same(text, str(mark)), attempts=1)
        self._line.paid(owed)
        return True

    def stale(self) -> bool:
        """Whether it is set to another diameter; setting it clears the counter."""
        return not wire.same(self._query("DIA"), self._diameter)

    def room(self, count: Count) -> int:
        """Ticks until its display shows less than is ordered."""
        return _DIGITS * self.order - count.high

    def renew(self) -> None:
        """Set the diameter and clear the counter."""
        if self.stale():
            self._set("DIA", self._diameter)
            self._set_rate()
        for what in ("INF", "WDR"):
            self._command(f"CLD{what}")

    # -- moving --------------------------------------------------------------------------------------------------------

    def prepare(self, ticks: int, count: Count) -> None:
        """Program phase 1 to pump `ticks` and phase 2 to stop, and read all of it back."""
        if ticks <= 0:  # a volume of 0 would pump for ever
            raise DeviceError(f"{self._name}: asked to pump {ticks} thousandths; this is a fault of the driver")
        self.set_up()
        if not self._query("VOL").endswith(self._unit):
            self._command(f"VOL{self._unit}")
        self._command(f"VOL{wire.number(ticks)}")
        self._command("DIRINF")
        self._set("PHN", "2")
        self._set("FUN", "STP")
        for _ in range(2 * ATTEMPTS):
            life = self._life
            try:
                self._read_back(ticks, count)
            except NoReplyError:
                if not self._line.patient:
                    raise
            else:
                if self._life == life:
                    self._ready_in = life
                    return
        raise NoReplyError(f"{self._name}: loses replies while it is made ready; check the cable and dose again")

    @property
    def _life(self) -> tuple[int, int]:
        """Another one whenever the pump may have lost its power since, and with it all that was set.

        It answers the first command of each life with an alarm, and does not carry it out: so the alarm has been heard,
        or a reply was missed.
        """
        return self._line.missed, self._alarms_told

    def _read_back(self, ticks: int, count: Count) -> None:
        """Everything that decides what `RUN` does, in one pass that begins with the order of replies proved."""
        rests = self._mark()
        self._set("PHN", "2")
        self._expect(FUN="STP")
        self._set("PHN", "1")
        self._expect(
            DIA=self._diameter,
            RAT="".join(rate_in_unit(self._settings.rate_ml_per_min)),
            VOL=f"{wire.number(ticks)}{self._unit}",
            DIR="INF",
            FUN="RAT",
            PHN="1",
        )
        if self._tells_power_failure_mode:
            self._expect(PF="0")
        counted = self._ask("DIS", lambda text: wire.dispensed(text, self._unit_ul) is not None)
        if not rests or counted.status != "S" or wire.dispensed(counted.data, self._unit_ul) != count:
            raise DeviceError(f"{self._name}: was reset or used while it was made ready; dose again")

    def go(self, unless: Callable[[], bool]) -> bool:
        """RUN, sent once, in the life that was made ready; if nothing answers, the counter tells whether it moved."""
        ready_in, self._ready_in = self._ready_in, None
        if self._life != ready_in:
            return False
        self._heard_alarms.clear()
        self._gap = self._stopping = False
        try:
            answer = self._once("RUN", lambda _: True, unless)
        except NoReplyError:
            return True
        return answer.error is None or self._line.owed > 0  # else the refusal may be another's

    def poll(self) -> tuple[bool, Count | None]:
        """Whether it pumps, and its counter; the packet feeds its watchdog."""
        answer = self._ask("DIS", lambda text: wire.dispensed(text, self._unit_ul) is not None, give_up_on_alarm=True)
        return answer.status == "I", wire.dispensed(answer.data, self._unit_ul)

    def duration_s(self, ticks: int) -> float:
        """At the set rate."""
        return ticks * self.tick_ul / self._settings.rate_ml_per_min * 60e-3

    def stop(self) -> None:
        """The first STP pauses, the second ends the program, so that RUN would not resume it."""
        self._gap = self._stopping = True
        self._line.send(self._stop, replies=5)

    def leave_alone(self) -> None:
        """Leave Safe mode, so that it sounds no alarm for want of being asked."""
        if self._mode is Mode.SAFE:
            left = self._change_mode(wire.packet(f"{self._settings.address or ''}SAF0"))
            self._mode = Mode.BASIC if left else Mode.UNCERTAIN

    def close(self) -> None:
        """Let go of the port."""
        self._line.close()

    # -- asking --------------------------------------------------------------------------------------------------------

    @property
    def _diameter(self) -> str:
        return four_digits(self._settings.diameter_mm)

    def _query(self, command: str) -> str:
        return self._ask(command, _SHAPES[command].fullmatch).data

    def _set(self, command: str, value: str) -> None:
        """Set, and read back."""
        self._command(f"{command}{value}")
        self._expect(**{command: value})

    def _expect(self, **settings: str) -> None:
        for command, wanted in settings.items():
            if not _same_setting(found := self._query(command), wanted):
                raise DeviceError(
                    f"{self._name}: {command} reads back as {found!r} and not {wanted!r}; dose again, and if that "
                    "repeats reset the pump"
                )

    def _command(self, command: str) -> None:
        """Give a command that may be given twice."""
        if refused := self._ask(command, _done_or_refused).error:
            raise DeviceError(f"{self._name}: refused {command}: {refused}; correct the settings in the rig file")

    def _ask(
        self,
        command: str,
        accept: Callable[[str], object],
        attempts: int = ATTEMPTS,
        give_up_on_alarm: bool = False,
    ) -> wire.Reply:
        """Ask what may be asked twice; an alarm means that it was not executed, and is acknowledged by its reply."""
        last: NoReplyError | None = None
        for _ in range(attempts):
            try:
                answer = self._once(command, accept)
            except NoReplyError as error:
                last = error
                if not self._line.patient:
                    break
                continue
            if answer.damaged:
                last = NoReplyError(f"{self._name}: receives damaged packets; check the cable")
            elif answer.alarm is None or give_up_on_alarm:
                return answer
        raise last or NoReplyError(f"{self._name}: answers only with alarms; look at its display")

    def _once(
        self, command: str, accept: Callable[[str], object], unless: Callable[[], bool] = lambda: False
    ) -> wire.Reply:
        def answer(text: bytes) -> wire.Reply | None:
            found = wire.reply(text)
            if found is None or found.address != self._settings.address:
                return None
            return found if found.alarm or found.damaged or accept(found.data) else None

        self._be_safe()
        missed = self._line.missed
        try:
            found = self._line.exchange(wire.packet(f"{self._settings.address}{command}"), answer, unless)
        except NoReplyError:
            self._mode = Mode.UNCERTAIN  # it may have lost its power
            raise
        finally:
            self._gap |= self._line.missed != missed
        if found.alarm:  # which the pump may have sent by itself, so that its reply to the command is still to come
            self._line.unsettle()
        return found

    def _be_safe(self) -> None:
        """Have it in Safe mode, in which it ignores the lines that would put it there.

        While that is uncertain, a line of its own ends what may be left over of another; the next packet shows it.
        """
        if self._mode is Mode.SAFE:
            return
        if not (self._mode is Mode.BASIC and self._change_mode(self._enter)):
            self._line.send(b"\r" + self._enter, replies=2)
        self._mode = Mode.SAFE

    def _change_mode(self, request: bytes) -> bool:
        """Whether it says, in either mode, that it has changed; an alarm says that it has not."""
        self._mode, before = Mode.UNCERTAIN, self._mode
        try:
            for _ in range(ATTEMPTS):
                found = self._line.exchange(request, self._of_this_pump)
                if found.alarm is None:
                    return not found.data
        except NoReplyError:
            pass
        finally:
            self._mode = before
        return False

    def _of_this_pump(self, text: bytes) -> wire.Reply | None:
        found = wire.reply(text)
        return found if found and found.address == self._settings.address else None

    def _frames(self, received: bytearray) -> Iterator[bytes]:
        return (wire.packets if self._mode is Mode.SAFE else wire.packets_or_replies)(received)

    def _heard(self, text: bytes) -> None:
        """Every packet, wanted or not: none may hide an alarm; a pump that still moves or pauses has had none."""
        found = wire.reply(text)
        if found is None:
            return
        if found.alarm:
            self._heard_alarms.add(found.alarm)
            self._alarms_told += 1
        elif found.status == "P" or (found.status == "I" and not self._stopping):
            self._gap = False


def _unit(diameter_mm: float) -> tuple[str, float, int]:
    """Unit of volume, its µl, and the thousandths of it that are shown whatever is counted."""
    return ("UL", 1.0, 100) if diameter_mm <= LARGEST_IN_UL_MM else ("ML", 1000.0, 1)


def _done_or_refused(text: str) -> bool:
    return text == "" or text.startswith("?")


def rate_in_unit(ml_per_min: float) -> tuple[str, str]:
    """A rate as the pump takes it, in the unit that shows most of it.

    >>> rate_in_unit(5.0), rate_in_unit(0.25), rate_in_unit(1e-5)
    (('5.000', 'MM'), ('250.0', 'UM'), ('0.600', 'UH'))
    """
    if ml_per_min >= 1.0:
        return four_digits(ml_per_min), "MM"
    if ml_per_min >= 1e-3:
        return four_digits(1e3 * ml_per_min), "UM"
    return four_digits(60e3 * ml_per_min), "UH"


def four_digits(value: float) -> str:
    """A number in at most four digits.

    >>> four_digits(14.3256), four_digits(0.5), four_digits(9.9996), four_digits(1000.0)
    ('14.33', '0.500', '10.00', '1000')
    """
    shown = (f"{value:.{decimals}f}" for decimals in (3, 2, 1))
    return next((text for text in shown if len(text) <= _DIGITS_AND_POINT), f"{value:.0f}")


def _same_setting(found: str, wanted: str) -> bool:
    """Whether a setting reads back as it was given, however its number is written."""
    split = re.compile(r"([\d.]*)([A-Z]*)")
    read, given = split.fullmatch(found), split.fullmatch(wanted)
    if not read or not given or read[2] != given[2]:
        return False
    return read[1] == given[1] or wire.same(read[1], given[1])
