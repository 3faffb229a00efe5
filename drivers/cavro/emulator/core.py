"""What runs in the pump: plunger, valve, errors."""

import math
import re
from collections.abc import Callable
from typing import Any

from .frames import Command

STROKE, FINER = 3000, 8
VALVE_S = 0.2
FIRMWARE = "30013720-C"
INVALID, OPERAND, NOT_INITIALISED, OVERLOAD, OVERFLOW = 2, 3, 7, 9, 15
_WORD = re.compile(r"([A-Za-z])(\d*)(R?)")


class Core:
    """The pump from one power-up to the next. Positions are fine increments from the top.

    Parameters
    ----------
    pulse
        One step of the motor; returns whether the plunger has followed; raises to end the pump's life there.
    run
        So many steps that are due; returns how many of them were made at once, the plunger following.
    expelled
        Called with the fine increments of liquid that leave the output.
    lost
        Fine increments that a plunger stopped in motion has not made though they were counted.
    ready
        Whether it has been initialised and filled already.
    """

    def __init__(
        self,
        pulse: Callable[[], bool],
        run: Callable[[int], int],
        expelled: Callable[[int], None],
        lost: Callable[[], int],
        ready: bool = False,
    ) -> None:
        self._pulse, self._run, self._expelled, self._lost = pulse, run, expelled, lost
        self._initialised, self._overloaded = ready, False
        self._position = self._target = self._from = STROKE * FINER if ready else 0
        self._since_s, self._free_s = 0.0, 0.0
        self._valve, self._finer = "b", 1
        self._speeds = {"v": 900, "V": 1400, "c": 900}
        self._last: int | None = None
        self._error = 0
        self.initialised_times = 0

    @property
    def moving(self) -> bool:
        """Whether the plunger moves."""
        return self._position != self._target

    def believed(self) -> dict[str, Any]:
        """For the control channel."""
        return {"position": self._position, "valve": self._valve, "error": self._error, "times": self.initialised_times}

    def advance(self, now_s: float) -> None:
        """Let the plunger go on until `now_s`."""
        self._now_s = now_s
        made = math.floor((now_s - self._since_s) * self._speeds["V"]) * FINER
        while self.moving and abs(self._position - self._from) < made:
            due = min(made - abs(self._position - self._from), abs(self._target - self._position))
            if at_once := self._run(due // (FINER // self._finer)):
                self._go_on(at_once)
            else:
                self._step()

    def _step(self) -> None:
        """One increment of the resolution that is set."""
        if self._pulse():
            self._go_on(1)
        else:
            self._position += -FINER // self._finer if self._target < self._position else FINER // self._finer
            self._overloaded, self._error = True, OVERLOAD
            self._target = self._position

    def _go_on(self, steps: int) -> None:
        """Steps that the plunger has followed."""
        up, size = self._target < self._position, FINER // self._finer * steps
        self._position += -size if up else size
        if up and self._valve == "o":
            self._expelled(size)

    def _terminate(self) -> None:
        if self.moving:
            size = FINER // self._finer
            skipped = min(self._lost(), abs(self._target - self._position)) // size * size
            self._position += -skipped if self._target < self._position else skipped
            self._target = self._position

    def obey(self, command: Command, now_s: float) -> tuple[int, str]:
        """Carry out a command: status and data of its answer."""
        self.advance(now_s)
        if command.sequence == self._last:
            return self._status(now_s, self._error), ""
        self._last = command.sequence
        if command.text == "Q":
            error, self._error = self._error or (0 if self._initialised else NOT_INITIALISED), 0
            return self._status(now_s, error), ""
        if command.text.startswith("?") or command.text == "&":
            return self._status(now_s, 0), self._report(command.text)
        error = self._act(command.text, now_s)
        return self._status(now_s, error), ""

    def _status(self, now_s: float, error: int) -> int:
        busy = self.moving or now_s < self._free_s
        return 0x40 | (0 if busy else 0x20) | error

    def _report(self, text: str) -> str:
        reports: dict[str, object] = {
            "&": FIRMWARE,
            "?": self._position * self._finer // FINER,
            "?1": self._speeds["v"],
            "?2": self._speeds["V"],
            "?3": self._speeds["c"],
            "?6": self._valve,
        }
        return str(reports.get(text, ""))

    def _act(self, text: str, now_s: float) -> int:
        if text == "T":
            self._terminate()
            return 0
        word = _WORD.fullmatch(text)
        if not word or not word[3]:
            return INVALID
        if (self.moving or now_s < self._free_s) and word[1] != "V":
            return OVERFLOW
        return self._carry_out(word[1], int(word[2] or 0), now_s)

    def _carry_out(self, letter: str, value: int, now_s: float) -> int:
        if letter in self._speeds:
            self._speeds[letter] = value
        elif letter == "N":
            self._finer = FINER if value else 1
        elif letter in "ZY":
            self._position = self._target = 0
            self._initialised, self._overloaded, self._valve = True, False, "o"
            self._free_s = now_s + 1.0
            self.initialised_times += 1
        elif letter not in "AIO":
            return INVALID
        elif self._overloaded:
            return OVERLOAD
        elif not self._initialised:
            return NOT_INITIALISED
        elif letter == "A":
            return self._move(value, now_s)
        else:
            self._valve = letter.lower()
            self._free_s = now_s + VALVE_S
        return 0

    def _move(self, value: int, now_s: float) -> int:
        if value > STROKE * self._finer:
            return OPERAND
        self._from, self._since_s = self._position, now_s
        self._target = value * FINER // self._finer
        return 0
