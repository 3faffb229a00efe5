"""What runs in the pump: its program, its counter, its alarms, its watchdog."""

import math
import re
from collections.abc import Callable
from typing import Any

VERSION = "NE1000V3.928"
_NUMBER = re.compile(r"(?=[\d.]*\d)(\d*\.?\d{0,3})")
_PER_SECOND = {"UM": 1 / 60, "MM": 1000 / 60, "UH": 1 / 3600, "MH": 1000 / 3600}  # µl
_LARGEST_IN_UL_MM = 14.0


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
    steps_per_ul, true_diameter_mm
        Of the syringe that is really in it.
    nearest
        Whether its display rounds (else it cuts digits off).
    counter_survives
        Whether the volume dispensed survives the loss of power (nobody knows).
    """

    def __init__(
        self,
        kept: dict[str, Any],
        keep: Callable[[], None],
        pulse: Callable[[], bool],
        run: Callable[[int], int],
        *,
        steps_per_ul: float,
        true_diameter_mm: float,
        nearest: bool,
        counter_survives: bool,
    ) -> None:
        self._kept, self._keep, self._pulse, self._run = kept, keep, pulse, run
        self._steps_per_ul, self._true_mm, self._nearest = steps_per_ul, true_diameter_mm, nearest
        if not kept:
            kept.update(dia=true_diameter_mm, safe=0, address=0, phases={}, steps=0)
        if not counter_survives:
            kept["steps"] = 0
        self._phase = 1
        self._state, self._running = "S", 1
        self._left: int | None = None
        self._since_s, self._done = 0.0, 0
        self._fed_s: float | None = None
        self._alarm: str | None = "R"
        self.unasked: list[str] = [self._answer("A?R")] if self.safe_mode else []

    @property
    def moving(self) -> bool:
        """Whether its motor runs."""
        return self._state in "IWX"

    @property
    def safe_mode(self) -> bool:
        """Which of the two protocols it speaks."""
        return bool(self._kept["safe"])

    def believed(self) -> dict[str, Any]:
        """For the control channel."""
        return {"status": self._state, "alarm": self._alarm, "phase": self._running, **self._kept}

    # -- time ----------------------------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Let motor and watchdog run until `now_s`."""
        deadline = math.inf if self._fed_s is None or not self.safe_mode else self._fed_s + self._kept["safe"]
        self._pump(min(now_s, deadline))
        if now_s > deadline:
            self._fed_s = None
            self._raise("T")

    def _pump(self, until_s: float) -> None:
        while self.moving:
            if self._left == 0:
                self._next_phase(until_s)
                continue
            due = math.floor((until_s - self._since_s) * self._rate() + 1e-9) - self._done
            due = due if self._left is None else min(due, self._left)
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
        self._left = None if self._left is None else self._left - steps
        if self._state != "W":
            self._kept["steps"] += steps

    def _next_phase(self, now_s: float) -> None:
        self._running += 1
        self._enter(now_s)

    def _enter(self, now_s: float) -> None:
        phase = self._program(self._running)
        if self._running > 41:
            self._raise("O")
        elif phase["fun"] == "STP":
            self._state = "S"
        else:
            self._state = "W" if phase["dir"] == "WDR" else "I"
            steps = round(phase["vol"] * self._unit_ul() / self._step_ul())
            self._left = steps if phase["vol"] else None
            self._since_s, self._done = now_s, 0

    def _raise(self, alarm: str) -> None:
        self._state, self._alarm = "S", alarm
        if self.safe_mode:
            self.unasked.append(self._answer(f"A?{alarm}"))

    # -- commands ------------------------------------------------------------------------------------------------------

    def obey(self, text: str, now_s: float) -> str | None:
        """Carry out a command; what it answers, or None when it is for another pump."""
        self._pump(now_s)
        self._fed_s = now_s
        command = text.upper().replace(" ", "")
        address = re.match(r"\d{0,2}", command)
        assert address
        if int(address[0] or 0) != self._kept["address"]:
            return None
        if self._alarm:
            alarm, self._alarm = self._alarm, None
            return self._answer(f"A?{alarm}")
        name, argument = command[address.end() :][:3], command[address.end() :][3:]
        handler = getattr(self, f"_do_{name.lower()}", None) if name else lambda *_: ""
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

    def _do_dia(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{self._kept['dia']:.4g}"
        value = _value(argument)
        if self._state != "S":
            return "?NA"
        if value is None or not 0.1 <= value <= 50.0:
            return "?OOR"
        self._kept.update(dia=value, steps=0)
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
        if argument not in ("RAT", "STP"):
            return "?OOR"
        return self._store(fun=argument)

    def _do_rat(self, argument: str, _now: float) -> str:
        phase = self._program(self._phase)
        if not argument:
            return f"{_shown(phase['rate'])}{phase['unit']}"
        unit = argument[-2:] if argument[-2:] in _PER_SECOND else ""
        value = _value(argument[: len(argument) - len(unit)])
        if self.moving and unit:
            return "?NA"
        if value is None or not value:
            return "?OOR"
        return self._store(rate=value, unit=unit or phase["unit"])

    def _do_vol(self, argument: str, _now: float) -> str:
        if not argument:
            return f"{_shown(self._program(self._phase)['vol'])}{self._unit()}"
        if self._state != "S":
            return "?NA"
        if argument in ("UL", "ML"):
            return "" if argument == self._unit() else "?NA"
        value = _value(argument)
        return "?OOR" if value is None else self._store(vol=value)

    def _do_dir(self, argument: str, _now: float) -> str:
        if not argument:
            return str(self._program(self._phase)["dir"])
        if self._state != "S" or argument not in ("INF", "WDR"):
            return "?NA" if self._state != "S" else "?OOR"
        return self._store(dir=argument)

    def _do_dis(self, _argument: str, _now: float) -> str:
        infused_ul = self._kept["steps"] * self._step_ul()
        return f"I{_shown(infused_ul / self._unit_ul(), self._nearest)}W0.000{self._unit()}"

    def _do_cld(self, argument: str, _now: float) -> str:
        if self.moving:
            return "?NA"
        if argument == "INF":
            self._kept["steps"] = 0
        return "" if argument in ("INF", "WDR") else "?"

    def _do_run(self, _argument: str, now: float) -> str:
        if self.moving:
            return "?NA"
        if self._state == "P":
            self._state, self._since_s, self._done = "I", now, 0
        else:
            self._running = 1
            self._enter(now)
        return ""

    def _do_stp(self, _argument: str, _now: float) -> str:
        if self._state == "S":
            return "?NA"
        self._state = "P" if self.moving else "S"
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
        return float(phase["rate"]) * _PER_SECOND[phase["unit"]] / self._step_ul()

    def _step_ul(self) -> float:
        """What it takes a step for; right only if its diameter is the syringe's."""
        return float(self._kept["dia"] / self._true_mm) ** 2 / self._steps_per_ul

    def _unit(self) -> str:
        return "UL" if self._kept["dia"] <= _LARGEST_IN_UL_MM else "ML"

    def _unit_ul(self) -> float:
        return 1.0 if self._unit() == "UL" else 1000.0


def _value(text: str) -> float | None:
    """A number of at most four digits, three of them decimals."""
    found = _NUMBER.fullmatch(text)
    return float(text) if found and len(text.replace(".", "").lstrip("0")) <= 4 else None


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
