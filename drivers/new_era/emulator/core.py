"""What runs in the pump: its program, its counter, its alarms, its watchdog.

Written from the manual of the NE-1000 series (publication 1200-01, firmware 3.9).
"""

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .frames import DAMAGED

VERSION = "NE1000V3.928"
SLOWEST_MM_PER_HOUR, FASTEST_MM_PER_MIN = 0.0421, 51.0
_NUMBER = re.compile(r"(?=[\d.]*\d)(\d*\.?\d{0,3})")
_COMMAND = re.compile(r"(\*|\d{0,2})(PF|AL|BP|[A-Z]{3}|)(.*)", re.DOTALL)
_FUNCTION = re.compile(r"RAT|STP|(?:PAS|JMP)(\d{1,2})")
_PER_SECOND = {"UM": 1 / 60, "MM": 1000 / 60, "UH": 1 / 3600, "MH": 1000 / 3600}  # µl
_LARGEST_IN_UL_MM = 14.0


@dataclass(frozen=True)
class Habits:
    """What a person has set at the pump, and what the manual leaves open.

    Parameters
    ----------
    power_failure
        Whether power failure mode is on in a new pump: a program that ran when the power went starts again from its
        beginning when the power comes back.
    knows_power_failure
        Whether the pump has the command `PF` at all.
    ignored_first
        How many commands after power-up get no answer and have no effect.
    answers_damaged
        Whether a packet with a wrong CRC is answered by `?COM`, as the manual says; else it is dropped.
    checks_rates
        Whether rates beyond what the motor can do with the diameter that is set are refused, as the manual says. Off
        for as long as the drivers' tests ask for more than a real pump can do.
    """

    power_failure: bool = False
    knows_power_failure: bool = True
    ignored_first: int = 0
    answers_damaged: bool = True
    checks_rates: bool = False


@dataclass(frozen=True)
class Syringe:
    """What is really in the pump.

    Parameters
    ----------
    steps_per_ul
        Of its motor.
    diameter_mm
        Inside.
    """

    steps_per_ul: float = 20.0
    diameter_mm: float = 12.0


class Core:
    """The pump from one power-up to the next.

    Parameters
    ----------
    kept
        Its non-volatile memory, as it was; changed in place.
    keep
        Writes that memory.
    pulse
        One step of the motor; returns whether the plunger has followed; raises to end the pump's life there.
    run
        So many steps that are due; returns how many of them were made at once, the plunger following.
    syringe
        That is really in it.
    nearest
        Whether its display rounds (else it cuts digits off).
    counter_survives
        Whether the volume dispensed survives the loss of power (nobody knows).
    habits
        How it is set up, and what the manual leaves open.

    Attributes
    ----------
    left
        Steps until it is through with its phase; None where that has no end.
    """

    def __init__(
        self,
        kept: dict[str, Any],
        keep: Callable[[], None],
        pulse: Callable[[], bool],
        run: Callable[[int], int] = lambda _: 0,
        *,
        syringe: Syringe,
        nearest: bool,
        counter_survives: bool,
        habits: Habits | None = None,
    ) -> None:
        self._habits = habits or Habits()
        self._kept, self._keep, self._pulse, self._run = kept, keep, pulse, run
        self._syringe, self._nearest = syringe, nearest
        if not kept:
            kept.update(dia=syringe.diameter_mm, safe=0, address=0, phases={}, steps=0)
        for key, value in {"pf": int(self._habits.power_failure), "operating": 0, "withdrawn": 0, "unit": ""}.items():
            kept.setdefault(key, value)
        if not counter_survives:
            kept["steps"] = kept["withdrawn"] = 0
        self._ignored_left = self._habits.ignored_first
        self._live_rate: float | None = None
        self._pause_ends_s = 0.0
        self._alarms: Counter[str] = Counter("R")
        self._restarts = bool(kept["operating"] and kept["pf"] and self._habits.knows_power_failure)
        self._phase = 1
        self._state, self._running = "S", 1
        self.left: int | None = None
        self._since_s, self._done = 0.0, 0
        self._fed_s: float | None = None
        self._alarm: str | None = "R"
        self.unasked: list[str] = [self._answer("A?R")] if self.safe_mode else []

    @property
    def moving(self) -> bool:
        """Whether its motor runs."""
        return self._state in "IWXT"

    @property
    def safe_mode(self) -> bool:
        """Which of the two protocols it speaks."""
        return bool(self._kept["safe"])

    def believed(self) -> dict[str, Any]:
        """For the control channel."""
        alarms = {"alarm": self._alarm, "buzzer": self._alarm is not None, "alarms": dict(self._alarms)}
        return {"status": self._state, **alarms, "phase": self._running, **self._kept}

    # -- time ----------------------------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Let motor and watchdog run until `now_s`."""
        if self._restarts:
            self._restarts = False
            self._start(1, now_s)
        deadline = math.inf if self._fed_s is None or not self.safe_mode else self._fed_s + self._kept["safe"]
        self._pump(min(now_s, deadline))
        if now_s > deadline:
            self._fed_s = None
            self._raise("T")

    def _pump(self, until_s: float) -> None:
        while self.moving:
            if self._state == "T":
                if until_s < self._pause_ends_s:
                    return
                self._next_phase(self._pause_ends_s)
                continue
            if self.left == 0:
                self._next_phase(self._since_s + self._done / self._rate())
                continue
            due = math.floor((until_s - self._since_s) * self._rate() + 1e-9) - self._done
            due = due if self.left is None else min(due, self.left)
            if due <= 0:
                return
            made = self._run(due) if self._state != "W" else due
            self._count(made)
            if made < due:
                self._count(1)
                if not self._pulse():
                    self._raise("S")

    def _count(self, steps: int) -> None:
        self._done += steps
        self.left = None if self.left is None else self.left - steps
        self._kept["withdrawn" if self._state == "W" else "steps"] += steps

    def _next_phase(self, now_s: float) -> None:
        self._running += 1
        self._enter(now_s)

    def _start(self, phase: int, now_s: float) -> None:
        self._running = phase
        self._enter(now_s)

    def _enter(self, now_s: float, jumps: int = 0) -> None:
        phase = self._program(self._running)
        function, number = phase["fun"][:3], int(phase["fun"][3:] or 0)
        self._live_rate = None
        if self._running > 41 or jumps > 41:
            self._raise("O")
        elif function == "STP":
            self._be("S")
        elif function == "JMP":
            self._running = number
            self._enter(now_s, jumps + 1)
        elif function == "PAS":
            self._pause_ends_s = now_s + number
            self._be("T")
        elif not self._in_range(phase["rate"], phase["unit"]):
            self._raise("E")
        else:
            self._be("W" if phase["dir"] == "WDR" else "I")
            steps = round(phase["vol"] * self._unit_ul() / self._step_ul())
            self.left = steps if phase["vol"] else None
            self._since_s, self._done = now_s, 0

    def _be(self, state: str) -> None:
        """Into another state; whether the program operates is remembered without power."""
        self._state = state
        if state == "S":
            self._live_rate = None
        operating = int(state in "IWXT")
        if operating != self._kept["operating"]:
            self._kept["operating"] = operating
            self._keep()

    def _raise(self, alarm: str) -> None:
        self._be("S")
        self._alarm = alarm
        self._alarms[alarm] += 1
        if self.safe_mode:
            self.unasked.append(self._answer(f"A?{alarm}"))

    # -- commands ------------------------------------------------------------------------------------------------------

    def obey(self, text: str, now_s: float) -> str | None:
        """Carry out a command; what it answers, or None when it is for another pump or ignored."""
        self.advance(now_s)
        if text == DAMAGED:
            return self._answer(f"{self._state}?COM")
        self._fed_s = now_s
        parts = _COMMAND.fullmatch(text.upper().replace(" ", ""))
        address, name, argument = parts.groups() if parts else ("", "?", "")
        if address != "*" and int(address or 0) != self._kept["address"]:
            return None
        if self._ignored_left:
            self._ignored_left -= 1
            return None
        if self._alarm:
            alarm, self._alarm = self._alarm, None
            return self._answer(f"A?{alarm}")
        handler = getattr(self, f"_do_{name.lower()}", None) if name else lambda *_: "?" if argument else ""
        data = handler(argument, now_s) if handler else "?"
        self._keep()
        return self._answer(f"{self._state}{data}")

    def _answer(self, text: str) -> str:
        return f"{self._kept['address']:02d}{text}"

    def _do_ver(self, _argument: str, _now: float) -> str:
        return VERSION

    def _do_saf(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{self._kept['safe']}"
        if not argument.isdigit() or int(argument) > 255:
            return "?OOR"
        self._kept["safe"] = int(argument)
        return ""

    def _do_pf(self, argument: str, _now: float) -> str:
        """Power failure mode."""
        if not self._habits.knows_power_failure:
            return "?"
        if not argument:
            return f"{self._kept['pf']}"
        if argument not in ("0", "1"):
            return "?OOR"
        self._kept["pf"] = int(argument)
        return ""

    def _do_adr(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{self._kept['address']}"
        if not argument.isdigit() or int(argument) > 99:
            return "?OOR"
        self._kept["address"] = int(argument)
        return ""

    def _do_dia(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{self._kept['dia']:.4g}"
        value = _value(argument)
        if self._state != "S":
            return "?NA"
        if value is None or not 0.1 <= value <= 50.0:
            return "?OOR"
        self._kept.update(dia=value, steps=0, withdrawn=0, unit="")
        return ""

    def _do_phn(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{self._phase:d}"
        if self._state != "S":
            return "?NA"
        if not argument.isdigit() or not 1 <= int(argument) <= 41:
            return "?OOR"
        self._phase = int(argument)
        return ""

    def _do_fun(self, argument: str, _now: float) -> str:
        if not argument:
            return str(self._program(self._phase)["fun"])
        if self._state != "S":
            return "?NA"
        function = _FUNCTION.fullmatch(argument)
        if not function or (function[1] and not 1 <= int(function[1]) <= (41 if argument[0] == "J" else 99)):
            return "?OOR"
        return self._store(fun=argument)

    def _do_rat(self, argument: str, now: float) -> str:
        phase = self._program(self._running if self.moving else self._phase)
        if not argument:
            rate = phase["rate"] if self._live_rate is None else self._live_rate
            return f"{_shown(rate)}{phase['unit']}"
        unit = argument[-2:] if argument[-2:] in _PER_SECOND else ""
        value = _value(argument[: len(argument) - len(unit)])
        if self.moving and unit:
            return "?NA"
        if not value or not self._in_range(value, unit or phase["unit"]):
            return "?OOR"
        if self.moving:  # takes effect at once and is not stored
            self._live_rate, self._since_s, self._done = value, now, 0
            return ""
        return self._store(rate=value, unit=unit or phase["unit"])

    def _in_range(self, rate: float, unit: str) -> bool:
        """Whether the motor can do this with the diameter that is set."""
        mm_per_s = rate * _PER_SECOND[unit] / (math.pi / 4 * self._kept["dia"] ** 2)
        in_range = SLOWEST_MM_PER_HOUR / 3600 <= mm_per_s <= FASTEST_MM_PER_MIN / 60
        return in_range or not self._habits.checks_rates

    def _do_vol(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{_shown(self._program(self._phase)['vol'])}{self._unit()}"
        if self._state != "S":
            return "?NA"
        if argument in ("UL", "ML"):
            self._kept["unit"] = argument
            return ""
        value = _value(argument)
        return "?OOR" if value is None else self._store(vol=value)

    def _do_dir(self, argument: str, _now: float) -> str:
        if not argument:
            return str(self._program(self._phase)["dir"])
        if self._state != "S" or argument not in ("INF", "WDR"):
            return "?NA" if self._state != "S" else "?OOR"
        return self._store(dir=argument)

    def _do_dis(self, _argument: str, _now: float) -> str:
        volumes = [self._kept[key] * self._step_ul() / self._unit_ul() for key in ("steps", "withdrawn")]
        infused, withdrawn = (_shown(volume, self._nearest) for volume in volumes)
        return f"I{infused}W{withdrawn}{self._unit()}"

    def _do_cld(self, argument: str, _now: float) -> str:
        if self.moving:
            return "?NA"
        if argument not in ("INF", "WDR"):
            return "?OOR"
        self._kept["steps" if argument == "INF" else "withdrawn"] = 0
        return ""

    def _do_run(self, argument: str, now: float) -> str:
        if self.moving:
            return "?NA"
        if argument and not (argument.isdigit() and 1 <= int(argument) <= 41):
            return "?OOR"
        paused = self._state == "P" and not argument
        if paused and self._program(self._running)["fun"].startswith("PAS"):
            self._enter(now)
        elif paused:
            self._be("W" if self._program(self._running)["dir"] == "WDR" else "I")
            self._since_s, self._done = now, 0
        elif self._program(int(argument or 1))["fun"] == "RAT" and not self._startable(int(argument or 1)):
            return "?OOR"
        else:
            self._start(int(argument or 1), now)
        return ""

    def _startable(self, phase: int) -> bool:
        """Whether the rate of the phase is still in range: the diameter may have changed since it was set."""
        program = self._program(phase)
        return self._in_range(program["rate"], program["unit"])

    def _do_stp(self, _argument: str, _now: float) -> str:
        if self._state == "S":
            return "?NA"
        self._be("P" if self.moving else "S")
        return ""

    # -- program and volumes -------------------------------------------------------------------------------------------

    def _program(self, phase: int) -> dict[str, Any]:
        """A phase; one that was never set pumps for ever."""
        default = {"fun": "RAT", "rate": 1.0, "unit": "MM", "vol": 0.0, "dir": "INF"}
        return {**default, **self._kept["phases"].get(str(phase), {})}

    def _store(self, **values: object) -> str:
        self._kept["phases"].setdefault(str(self._phase), {}).update(values)
        return ""

    def _rate(self) -> float:
        """Of the running phase, steps/s."""
        phase = self._program(self._running)
        rate = phase["rate"] if self._live_rate is None else self._live_rate
        return float(rate) * _PER_SECOND[phase["unit"]] / self._step_ul()

    def _step_ul(self) -> float:
        """What it takes a step for; right only if its diameter is the syringe's."""
        return float(self._kept["dia"] / self._syringe.diameter_mm) ** 2 / self._syringe.steps_per_ul

    def _unit(self) -> str:
        return self._kept["unit"] or ("UL" if self._kept["dia"] <= _LARGEST_IN_UL_MM else "ML")

    def _unit_ul(self) -> float:
        return 1.0 if self._unit() == "UL" else 1000.0


def _value(text: str) -> float | None:
    """A number of at most four digits, three of them decimals."""
    found = _NUMBER.fullmatch(text)
    return float(text) if found and len(text.replace(".", "")) <= 4 else None


def _shown(value: float, nearest: bool = True) -> str:
    """Four digits, as the display has them.

    >>> _shown(12.348), _shown(12.348, nearest=False), _shown(999.96)
    ('12.35', '12.34', '1000')
    """
    for decimals in (3, 2, 1, 0):
        scale = 10**decimals
        digits = round(value * scale) if nearest else math.floor(value * scale + 1e-6)
        if digits <= 9999:
            break
    return f"{digits / scale:.{decimals}f}"
