"""A New Era pump on its line, as `drivers.counted.counter.Counter` (firmware_notes/new_era.md)."""

import itertools
import math
import random
import re
from collections.abc import Callable
from contextlib import suppress

from drivers.clock import Clock
from drivers.counted.counter import Reading, Trust
from drivers.dosing.pump import Count
from drivers.serial_line import Line, NoReplyError, PortOpener, open_port
from tankrig.errors import DeviceError

from . import wire
from .settings import NewEraSettings

ATTEMPTS = 3
LARGEST_IN_UL_MM = 14.0
_DIGITS = 9999
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
    }.items()
}
"""What the pump answers to a query; a reply of another shape belongs to another command."""


class NewEraPump:
    """An NE-500 or NE-1000 in Safe mode.

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
        self.rests_after_s = 1.5 * settings.watchdog_s
        self._stop = 2 * wire.packet(f"{settings.address}STP")
        self._heard_alarms: set[str] = set()
        self._gap = self._stopping = True
        self._marks = itertools.cycle(random.sample(range(3, 41), 38))  # not those of the last program
        self._line = Line(settings.port, settings.baud, name, wire.packets, self._heard, clock, opener)

    # -- who -----------------------------------------------------------------------------------------------------------

    def greet(self) -> None:
        """Put it into Safe mode, with the watchdog, and see who it is."""
        for attempts, safe_already in ((1, True), (ATTEMPTS, False), (ATTEMPTS, True)):
            if not safe_already:
                self._line.send(f"\r{self._settings.address}SAF{self._settings.watchdog_s}\r".encode())
            with suppress(NoReplyError):
                self.model = self._ask("VER", _SHAPES["VER"].fullmatch, attempts).data
                break
        else:
            raise DeviceError(
                f"{self._name}: no New Era pump answers there at {self._settings.baud} baud; check port, baud, address "
                f"{self._settings.address}, cable and power"
            )
        if not _VERSION.fullmatch(self.model):
            raise DeviceError(f"{self._name}: {self.model!r} answers there, which is no New Era pump; correct the port")
        self._set("SAF", str(self._settings.watchdog_s))

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
        error: DeviceError | None = None
        for _ in range(2 * ATTEMPTS):
            try:
                if not self._mark():
                    self.stop()
                    continue
                counted = self._ask("DIS", lambda text: wire.dispensed(text, self._unit_ul) is not None)
            except NoReplyError as missing:
                error = missing
                continue
            count = wire.dispensed(counted.data, self._unit_ul)
            if counted.status == "S" and count:
                return self._reading(count)
            self.stop()
        raise error or NoReplyError(f"{self._name}: does not stop; pull its power")

    def _reading(self, count: Count) -> Reading:
        alarms, self._heard_alarms = self._heard_alarms, set()
        gap, self._gap = self._gap, True  # until the next dose sets off, nothing is known of alarms between
        trust = Trust.UNWITNESSED if gap and "T" not in alarms else Trust.EXACT
        if "S" in alarms:
            trust = Trust.STALLED
        if "R" in alarms:
            trust = Trust.RESTARTED
        why = next((wire.ALARMS[alarm] for alarm in "RSEOT" if alarm in alarms), "it was stopped")
        return Reading(count, trust, why)

    def _mark(self) -> bool:
        """Have it select a phase and say which: replies from before are then past. False if it does not rest."""
        mark = next(self._marks)
        refused = self._ask(f"PHN{mark}", lambda text: text == "" or text.startswith("?")).error
        return not refused and bool(self._ask("PHN", lambda text: wire.same(text, str(mark)), attempts=1))

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
        for what in ("INF", "WDR"):
            self._command(f"CLD{what}")

    # -- moving --------------------------------------------------------------------------------------------------------

    def prepare(self, ticks: int, count: Count) -> None:
        """Program phase 1 to pump `ticks` and phase 2 to stop, and read all of it back."""
        if ticks <= 0:  # a volume of 0 would pump for ever
            raise DeviceError(f"{self._name}: asked to pump {ticks} thousandths; this is a fault of the driver")
        rate, unit = self._rate
        self._set("PHN", "1")
        self._set("FUN", "RAT")
        self._command(f"RAT{rate}{unit}", self._query("RAT") == f"{rate}{unit}")
        self._command(f"VOL{self._unit}", self._query("VOL").endswith(self._unit))
        self._command(f"VOL{wire.number(ticks)}")
        self._command("DIRINF")
        self._set("PHN", "2")
        self._set("FUN", "STP")
        self._set("PHN", "1")
        self._verify(ticks, rate, unit)
        counted = self._ask("DIS", lambda text: wire.dispensed(text, self._unit_ul) is not None)
        if counted.status != "S" or wire.dispensed(counted.data, self._unit_ul) != count:
            raise DeviceError(f"{self._name}: was reset or used while it was made ready; dose again")

    def _verify(self, ticks: int, rate: str, unit: str) -> None:
        expected = {
            "DIA": self._diameter,
            "RAT": f"{rate}{unit}",
            "VOL": f"{wire.number(ticks)}{self._unit}",
            "DIR": "INF",
            "FUN": "RAT",
            "PHN": "1",
        }
        for command, wanted in expected.items():
            found = self._query(command)
            if not _same_setting(found, wanted):
                raise DeviceError(f"{self._name}: {command} reads back as {found!r} and not {wanted!r}; reset the pump")

    def go(self, unless: Callable[[], bool]) -> bool:
        """RUN, sent once; without a reply it may have been obeyed, which the counter will tell."""
        self._heard_alarms.clear()
        self._gap = self._stopping = False
        try:
            answer = self._once("RUN", lambda _: True, unless)
        except NoReplyError:
            return True
        return answer.error is None

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
        self._line.send(self._stop)

    def close(self) -> None:
        """Leave Safe mode, so that the pump raises no alarm for want of a computer."""
        self._line.send(wire.packet(f"{self._settings.address or ''}SAF0"))
        self._line.close()

    # -- asking --------------------------------------------------------------------------------------------------------

    @property
    def _diameter(self) -> str:
        return _four_digits(self._settings.diameter_mm)

    @property
    def _rate(self) -> tuple[str, str]:
        if self._settings.rate_ml_per_min < 1.0:
            return _four_digits(1000.0 * self._settings.rate_ml_per_min), "UM"
        return _four_digits(self._settings.rate_ml_per_min), "MM"

    def _query(self, command: str) -> str:
        return self._ask(command, _SHAPES[command].fullmatch).data

    def _set(self, command: str, value: str) -> None:
        """Set, and read back."""
        self._command(f"{command}{value}")
        if not _same_setting(found := self._query(command), value):
            raise DeviceError(f"{self._name}: {command} reads back as {found!r} and not {value!r}; reset the pump")

    def _command(self, command: str, done: bool = False) -> None:
        """Give a command that may be given twice."""
        if done:
            return
        if refused := self._ask(command, lambda text: text == "" or text.startswith("?")).error:
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
                continue
            if answer.alarm is None or give_up_on_alarm:
                return answer
        raise last or NoReplyError(f"{self._name}: answers only with alarms; look at its display")

    def _once(
        self, command: str, accept: Callable[[str], object], unless: Callable[[], bool] = lambda: False
    ) -> wire.Reply:
        def answer(text: bytes) -> wire.Reply | None:
            found = wire.reply(text)
            if found is None or found.address != self._settings.address:
                return None
            return found if found.alarm or accept(found.data) else None

        missed = self._line.missed
        try:
            found = self._line.exchange(wire.packet(f"{self._settings.address}{command}"), answer, unless)
        finally:
            self._gap |= self._line.missed != missed
        if found.alarm:  # which the pump may have sent by itself, so that its reply to the command is still to come
            self._line.unsettle()
        return found

    def _heard(self, text: bytes) -> None:
        """Every packet, wanted or not: none may hide an alarm; a pump that still moves or pauses has had none."""
        found = wire.reply(text)
        if found is None:
            return
        if found.alarm:
            self._heard_alarms.add(found.alarm)
        elif found.status == "P" or (found.status == "I" and not self._stopping):
            self._gap = False


def _unit(diameter_mm: float) -> tuple[str, float, int]:
    """Unit of volume, its µl, and the thousandths of it that are shown whatever is counted."""
    return ("UL", 1.0, 100) if diameter_mm <= LARGEST_IN_UL_MM else ("ML", 1000.0, 1)


def _four_digits(value: float) -> str:
    """A number in at most four digits.

    >>> _four_digits(14.3256), _four_digits(0.5), _four_digits(1000.0)
    ('14.33', '0.500', '1000')
    """
    decimals = max(0, min(3, 3 - math.floor(math.log10(value))))
    return f"{value:.{decimals}f}"


def _same_setting(found: str, wanted: str) -> bool:
    """Whether a setting reads back as it was given, however its number is written."""
    split = re.compile(r"([\d.]*)([A-Z]*)")
    read, given = split.fullmatch(found), split.fullmatch(wanted)
    if not read or not given or read[2] != given[2]:
        return False
    return read[1] == given[1] or wire.same(read[1], given[1])
