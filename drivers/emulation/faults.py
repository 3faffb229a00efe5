"""Faults of the line and of the board, drawn from one seed."""

import random
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Faults:
    """What goes wrong from now on; meanings as on firmware_notes/rig_doser.md."""

    lose: float = 0.0
    corrupt: float = 0.0
    duplicate: float = 0.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    mute: bool = False
    deaf: bool = False
    junk: bool = False
    stranger: bool = False
    stall_after: int | None = None
    reset_after: int | None = None
    unplug_after: int | None = None


class FaultInjector:
    """Does to each byte on the line what the faults in force say.

    Parameters
    ----------
    seed
        What they are drawn from.
    most_hits
        Most bytes that are damaged or lost of what is sent at once: what the device's checksum is sure to notice.
    """

    def __init__(self, seed: int, most_hits: int | None = None) -> None:
        self._random, self._most_hits = random.Random(seed), most_hits
        self.faults = Faults()
        self._steps = 0

    def set(self, changes: dict[str, object]) -> None:
        """Change some of the faults; step counts run from now."""
        self.faults = replace(self.faults, **changes)  # type: ignore[arg-type]
        self._steps = 0

    def on_line(self, data: bytes) -> bytes:
        """What arrives of `data`."""
        if not (self.faults.lose or self.faults.corrupt):
            return data
        arrived, hits = bytearray(), 0
        for byte in data:
            lost, flipped = self._random.random() < self.faults.lose, self._random.random() < self.faults.corrupt
            if (lost or flipped) and (self._most_hits is None or hits < self._most_hits):
                hits += 1
                if not lost:
                    arrived.append(byte ^ 1 << self._random.randrange(8))
            else:
                arrived.append(byte)
        return bytes(arrived)

    def twice(self) -> bool:
        """Whether this request arrives twice."""
        return self._random.random() < self.faults.duplicate

    def delay_s(self) -> float:
        """How much too late this reply is."""
        return (self.faults.delay_ms + self._random.random() * self.faults.jitter_ms) / 1e3

    def junk(self) -> bytes:
        """What a boot loader may leave on the line."""
        return self._random.randbytes(self._random.randrange(1, 40))

    def undisturbed(self, steps: int) -> int:
        """How many of the next `steps` nothing befalls; they are then made."""
        faults = self.faults
        for after in (faults.stall_after, faults.reset_after, faults.unplug_after):
            if after is not None:
                steps = min(steps, max(0, after - self._steps))
        self._steps += steps
        return steps

    def on_step(self) -> str | None:
        """What befalls this step: 'stall', 'reset', 'unplug' or nothing."""
        self._steps += 1
        faults = self.faults
        if faults.reset_after is not None and self._steps > faults.reset_after:
            self.faults = replace(faults, reset_after=None)
            return "reset"
        if faults.unplug_after is not None and self._steps > faults.unplug_after:
            self.faults = replace(faults, unplug_after=None)
            return "unplug"
        return "stall" if faults.stall_after is not None and self._steps > faults.stall_after else None
