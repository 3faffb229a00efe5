"""What runs in the pump: its program, plunger, valve, speeds and errors.

Written from the XCalibur's operating manual (733085-B) and the XLP 6000's (734237-C).
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .frames import Command
from .motion import Stroke

FINER = 8
VALVE_S, HOMING_S = 0.2, 1.0  # neither is in the manuals
INITIALISING_HZ = 500.0
STROKE = 3000
INVALID, OPERAND, NOT_INITIALISED, OVERLOAD, NOT_ALLOWED, OVERFLOW = 2, 3, 7, 9, 11, 15
FASTEST_ON_THE_FLY = 1024
SPEED_CODES = (
    *(6000, 5600, 5000, 4400, 3800, 3200, 2600, 2200, 2000, 1800, 1600, 1400, 1200, 1000, 800, 600, 400),
    *range(200, 10, -10),
    *(18, 16, 14, 12, 10),
)
BUSY, READY = 0x40, 0x60  # the ready bit means something in the answer to `Q` only; elsewhere it is always set
_PROGRAM = re.compile(r"(?:[A-Za-z](?:\d+(?:,\d+)*)?)*")
_WORD = re.compile(r"([A-Za-z])(\d*)(?:,\d+)*")
_LETTERS = frozenset("AaPpDdIOBZYWNKLvVcSMHGgRTX")
_RANGES = {"v": (50, 1000), "V": (5, 6000), "c": (50, 2700), "L": (1, 20), "S": (0, 40), "N": (0, 1)}
_RANGES |= {"M": (0, 30_000), "H": (0, 2), "G": (0, 30_000)}


Program = list[tuple[str, int | None]]


@dataclass(frozen=True)
class Model:
    """A pump of the family.

    Parameters
    ----------
    increments
        Of a stroke, without fine positioning.
    pulses
        Of one increment: what the speeds count.
    firmware
        What it answers to `&`.
    """

    name: str
    increments: int
    pulses: int
    firmware: str


XCALIBUR = Model("xcalibur", 3000, 2, "737230 A")
XLP = Model("xlp", 6000, 1, "XLP6000 A")
MODELS = {model.name: model for model in (XCALIBUR, XLP)}


@dataclass(frozen=True)
class Habits:
    """What the models differ in, and what the manuals leave open.

    Parameters
    ----------
    model
        Which pump.
    speeds_interact
        Whether start and cutoff speed are kept at or below the top speed, as the manuals say (section 3.5.4). Off for
        as long as the driver takes the start speed that it has set for a mark.
    speed_rounding
        Added to each speed that it reports: "may not reflect the exact programmed value due to rounding".
    repeat_flag_decides
        Whether a command with the number of the one before is obeyed all the same unless its repeat flag is set, as
        the manuals say; else the number alone decides.
    overload_stays
        Whether an overload stays in the status until the pump is initialised; else `Q` clears it, and the next move
        has it again. The manuals say both.
    """

    model: Model = XCALIBUR
    speeds_interact: bool = False
    speed_rounding: int = 0
    repeat_flag_decides: bool = False
    overload_stays: bool = False


class Core:
    """The pump from one power-up to the next. Positions are fine increments from the top.

    Parameters
    ----------
    pulse
        One step of the motor; returns whether the plunger has followed; raises to end the pump's life there.
    expelled
        Called with the fine increments of liquid that leave the output.
    lost
        Fine increments that a plunger stopped in motion has not made though they were counted.
    ready
        Whether it has been initialised and filled already.
    habits
        What the manuals leave open.
    run
        So many steps that are due; returns how many of them were made at once, the plunger following.

    Attributes
    ----------
    initialised
        Whether it knows its zero.
    """

    def __init__(
        self,
        pulse: Callable[[], bool],
        expelled: Callable[[int], None],
        lost: Callable[[], int],
        ready: bool = False,
        habits: Habits | None = None,
        run: Callable[[int], int] = lambda _: 0,
    ) -> None:
        self._pulse, self._run, self._expelled, self._lost = pulse, run, expelled, lost
        self._habits = habits or Habits()
        model = self._habits.model
        self._fine_stroke, self._fine_per_pulse = model.increments * FINER, FINER / model.pulses
        self.initialised, self._overloaded = ready, False
        self._position = self._target = self._from = self._fine_stroke if ready else 0
        self._stroke: Stroke | None = None
        self._quiet = False
        self._free_s = 0.0
        self._homing = False
        self._valve, self._finer = "b" if not ready else "i", 1
        self._speeds, self._slope, self._backlash = {"v": 900, "V": 1400, "c": 900}, 14, 12
        self._on_the_fly: int | None = None
        self._program: Program = []
        self._buffer: Program = []
        self._executed: Program = []
        self._next, self._loops = 0, list[list[int]]()
        self._halted = False
        self._resume: int | None = None
        self._last: int | None = None
        self._error = 0
        self._immediate: int | None = None
        self.initialised_times = 0

    @property
    def moving(self) -> bool:
        """Whether the plunger moves."""
        return self._position != self._target

    def believed(self) -> dict[str, Any]:
        """For the control channel."""
        return {
            "position": self._position,
            "valve": self._valve,
            "error": self._error,
            "times": self.initialised_times,
            "model": self._habits.model.name,
            "speeds": self._speeds | {"v": self._start_speed},
        }

    # -- time ----------------------------------------------------------------------------------------------------------

    def advance(self, now_s: float) -> None:
        """Let program, plunger and valve go on until `now_s`."""
        while True:
            if self._stroke:
                self._go_on(now_s, self._stroke)
            if self._stroke or now_s < self._free_s:
                return
            if self._homing:
                self._at_home()
            if self._halted or self._resume is not None:
                return
            if self._next >= len(self._program):
                self._program = []
                return
            letter, value = self._program[self._next]
            self._next += 1
            if error := self._carry_out(letter, value):
                self._fail(error)

    def _go_on(self, now_s: float, stroke: Stroke) -> None:
        size, pulses = FINER // self._finer, stroke.made(now_s)
        made = math.floor(pulses * self._fine_per_pulse / size + 1e-9) * size
        if pulses >= stroke.pulses:  # the last step is a shorter one where fine positioning was switched off in between
            made = abs(self._target - self._from)
        while self.moving and abs(self._position - self._from) < made:
            due = min(made - abs(self._position - self._from), abs(self._target - self._position))
            if at_once := self._run(due // size):
                self._follow(at_once)
            else:
                self._step()
        if not self.moving and self._stroke:
            self._free_s = max(self._free_s, stroke.start_s + stroke.duration_s + self._backlash_s())
            self._stroke, self._on_the_fly, self._quiet = None, None, False

    def _backlash_s(self) -> float:
        """How long the plunger goes too far and back after an aspiration, s."""
        aspired = self._position > self._from
        increments = self._backlash / self._finer
        return 2 * increments * self._habits.model.pulses / self._top_speed if aspired else 0.0

    def _step(self) -> None:
        """One increment of the resolution that is set."""
        if self._pulse():
            self._follow(1)
        else:
            self._position += self._way(1)
            self._overloaded = True
            self._target, self._stroke = self._position, None
            self._fail(OVERLOAD)

    def _follow(self, steps: int) -> None:
        """So many increments that the plunger has followed."""
        way = self._way(steps)
        self._position += way
        if way < 0 and self._valve == "o":
            self._expelled(-way)

    def _way(self, steps: int) -> int:
        """Fine increments of so many increments towards the target, no farther; up is negative."""
        way = min(FINER // self._finer * steps, abs(self._target - self._position))
        return -way if self._target < self._position else way

    def _fail(self, error: int) -> None:
        """Stop executing; an error that the answer itself can carry is not kept."""
        self._program, self._buffer, self._next, self._resume = [], [], 0, None
        if self._immediate is None:
            self._error = error
        else:
            self._immediate = error

    # -- speeds --------------------------------------------------------------------------------------------------------

    @property
    def _start_speed(self) -> int:
        return min(self._speeds["v"], self._speeds["V"]) if self._habits.speeds_interact else self._speeds["v"]

    @property
    def _top_speed(self) -> int:
        return self._speeds["V"] if self._on_the_fly is None else self._on_the_fly

    def _set_speed(self, letter: str, value: int) -> None:
        """Section 3.5.4 of the manual: v ≤ c ≤ V, whatever is asked for."""
        speeds = self._speeds
        if not self._habits.speeds_interact and letter != "S":
            speeds[letter] = value
        elif letter == "S":
            speeds["V"] = SPEED_CODES[value]
            speeds["v"] = min(speeds["v"], speeds["V"])
            speeds["c"] = min(max(speeds["c"], speeds["v"]), speeds["V"])
        elif letter == "V":
            speeds["V"] = value
            speeds["c"] = min(max(speeds["c"], self._start_speed), value)
        elif letter == "v":
            speeds["v"] = min(value, speeds["V"])
            speeds["c"] = max(speeds["c"], speeds["v"])
        else:
            speeds["c"] = min(max(value, self._start_speed), speeds["V"])

    def _change_on_the_fly(self, program: Program, now_s: float) -> int:
        """What a busy pump takes: a new top speed for the rest of this move, without ramps and only while fine steps.

        Returns the error.
        """
        if [letter for letter, _ in program] != ["V"]:
            return OVERFLOW
        value, stroke = program[0][1] or 0, self._stroke
        if error := self._check("V", value):
            return error
        if not stroke:
            self._set_speed("V", value)
        elif not stroke.ramped and max(value, stroke.top) <= FASTEST_ON_THE_FLY:
            self._on_the_fly = value
            left = abs(self._target - self._position) / self._fine_per_pulse
            self._from = self._position
            self._stroke = Stroke(now_s, left, value, value, value, stroke.slope)
        return 0

    # -- commands ------------------------------------------------------------------------------------------------------

    def obey(self, command: Command, now_s: float) -> tuple[int, str]:
        """Carry out a command: status and data of its answer."""
        self.advance(now_s)
        again = command.sequence == self._last and (command.repeated or not self._habits.repeat_flag_decides)
        self._last = command.sequence
        if again:
            return READY | self._error, ""
        if command.text == "Q":
            return self._queried(now_s), ""
        if command.text.startswith("?") or command.text in ("&", "F"):
            return READY | self._error, self._report(command.text)
        self._immediate = 0
        error = self._act(command.text, now_s) or self._immediate
        self._immediate = None
        return READY | (error or self._error), ""

    def _queried(self, now_s: float) -> int:
        """The answer to `Q`: the only one whose ready bit can be trusted."""
        error = self._error or (0 if self.initialised else NOT_INITIALISED)
        if not (self._overloaded and self._habits.overload_stays):
            self._error = 0
        ready = not self._busy(now_s) or (self._quiet and self._stroke is not None)
        return (READY if ready else BUSY) | error

    def _busy(self, now_s: float) -> bool:
        return self._stroke is not None or now_s < self._free_s or (bool(self._program) and self._resume is None)

    def _report(self, text: str) -> str:
        rounding = self._habits.speed_rounding
        reports: dict[str, object] = {
            "&": self._habits.model.firmware,
            "?23": self._habits.model.firmware,
            "?": self._position * self._finer // FINER,
            "?4": self._position * self._finer // FINER,
            "?1": self._start_speed + rounding,
            "?2": self._top_speed + rounding,
            "?3": self._speeds["c"] + rounding,
            "?6": self._valve,
            "?10": int(bool(self._buffer)),
            "F": int(bool(self._buffer)),
            "?12": self._backlash,
            "?15": self.initialised_times,
        }
        return str(reports.get(text, ""))

    def _act(self, text: str, now_s: float) -> int:
        if text == "T":
            self._terminate(now_s)
            return 0
        if not text or not _PROGRAM.fullmatch(text):
            return INVALID
        words = [(letter, int(value) if value else None) for letter, value in _WORD.findall(text)]
        letters = {letter for letter, _ in words}
        execute = words[-1][0] == "R"
        program = words[:-1] if execute else words
        if not letters <= _LETTERS or any(letter in "RTX" for letter, _ in program[: None if execute else -1]):
            return INVALID
        if words == [("X", None)]:
            program, execute = self._executed, True
        elif "X" in letters or "T" in letters:
            return INVALID
        if execute and not program:
            self._execute_or_resume(now_s)
            return 0
        if self._busy(now_s):
            return self._change_on_the_fly(program, now_s)
        if not execute:
            self._buffer = program
            return 0
        self._execute(program, now_s)
        return 0

    def _execute_or_resume(self, now_s: float) -> None:
        """`R` alone: what was halted, terminated, or loaded and not executed yet."""
        self._free_s = max(self._free_s, now_s)
        if self._halted:
            self._halted = False
        elif self._resume is not None:
            target, self._resume = self._resume, None
            self._set_off(target, now_s)
        elif self._buffer and not self._busy(now_s):
            program, self._buffer = self._buffer, []
            self._execute(program, now_s)
        self.advance(now_s)

    def _execute(self, program: Program, now_s: float) -> None:
        self._executed, self._program, self._next, self._loops = program, program, 0, []
        self._buffer, self._resume, self._halted = [], None, False
        self._free_s = max(self._free_s, now_s)
        self.advance(now_s)

    def _terminate(self, now_s: float) -> None:
        """Plunger moves, loops and delays end at once; valve moves and initialising do not."""
        if self._stroke:
            size = FINER // self._finer
            skipped = min(self._lost(), abs(self._target - self._position)) // size * size
            self._resume = self._target
            self._position += -skipped if self._target < self._position else skipped
            self._target, self._stroke, self._on_the_fly, self._quiet = self._position, None, None, False
        elif self._program and self._next and self._program[self._next - 1][0] == "M":
            self._free_s = now_s
        if self._program and self._resume is None:
            self._resume = self._position

    def _check(self, letter: str, value: int | None) -> int:
        """OPERAND if `value` is out of range, else 0."""
        low, high = _RANGES.get(letter, (0, math.inf))
        if letter == "K":
            high = 31 if self._finer == 1 else 248
        return 0 if low <= (value or 0) <= high else OPERAND

    def _carry_out(self, letter: str, value: int | None) -> int:
        """Begin one command of the program at the time when the one before has ended; its error, or 0."""
        now_s, operand = self._free_s, value or 0
        if error := self._check(letter, value):
            return error
        if letter in "vVcS":
            self._set_speed(letter, operand)
        elif letter == "L":
            self._slope = operand
        elif letter == "N":
            self._finer, self._backlash = (FINER, 96) if operand else (1, 12)
        elif letter == "K":
            self._backlash = operand
        elif letter == "M":
            self._free_s = now_s + 5 * round(operand / 5) / 1000
        elif letter == "H":
            self._halted = True
        elif letter in "gG":
            self._loop(letter, operand)
        elif letter in "ZYW":
            self._initialise(letter, now_s)
        else:
            return self._drive(letter, operand, now_s)
        return 0

    def _loop(self, letter: str, times: int) -> None:
        if letter == "g":
            self._loops.append([self._next, 0])
            return
        loop = self._loops[-1] if self._loops else [0, 0]
        if not self._loops:
            self._loops.append(loop)
        loop[1] += 1
        if times and loop[1] >= times:
            self._loops.pop()
        else:
            self._next = loop[0]
            self._free_s += 0.001  # a loop of nothing takes time too

    def _initialise(self, letter: str, now_s: float) -> None:
        """The plunger goes to the top at the initialisation speed, which pushes out what the syringe holds."""
        self._free_s = now_s + self._position / self._fine_per_pulse / INITIALISING_HZ + HOMING_S
        self._homing, self._overloaded, self._error = True, False, 0
        if letter != "W":
            self._valve = "o"
        self.initialised_times += 1

    def _at_home(self) -> None:
        self._homing, self.initialised = False, True
        self._position = self._target = 0

    def _drive(self, letter: str, value: int, now_s: float) -> int:
        """Valve and plunger moves."""
        if self._overloaded:
            return OVERLOAD
        if not self.initialised:
            return NOT_INITIALISED
        if letter in "IOB":
            self._free_s = now_s + (VALVE_S if self._valve != letter.lower() else 0.0)
            self._valve = letter.lower()
            return 0
        distance = value * FINER // self._finer
        sign = {"a": 0, "p": 1, "d": -1}[letter.lower()]
        target = self._position * abs(sign) + (sign or 1) * distance
        highest = self._fine_stroke * 1.05 if sign else self._fine_stroke
        if not 0 <= target <= highest:
            return OPERAND
        if self._valve == "b":
            return NOT_ALLOWED
        self._quiet = letter.islower()
        self._set_off(target, now_s)
        return 0

    def _set_off(self, target: int, now_s: float) -> None:
        if target == self._position:
            return
        self._from, self._target = self._position, target
        up = target < self._position
        pulses = abs(target - self._position) / self._fine_per_pulse
        v, V, c = self._start_speed, self._speeds["V"], self._speeds["c"]
        self._stroke = Stroke(now_s, pulses, v, V, c if up else v, 2500.0 * self._slope)
