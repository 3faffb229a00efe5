"""A program to be killed: begins a run with the simulated doser, or resumes it, and says what is acknowledged.

Its camera sees what the tank really holds: the doser's true steps, which nothing of tankrig reads, stand in two pixels
of every frame.

`python killed_run.py FOLDER DOSES [DELIVERED_UL]`; exit status 0 done, 3 a person has to decide.
"""

import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.emulation.truth import read_truth
from drivers.registry import open_device
from tankrig.errors import UndecidedError
from tankrig.run.start import new_run, resumed_run
from tankrig.run.state import FinishReason
from tankrig.sequence import Capture, Mix, Sequence, Series

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.memory_rig import memory_rig

STEPS_PER_UL = 100.0
_BITS = 11


def seen_ul(pixels: np.ndarray) -> float:
    """What the tank really held when a frame was exposed."""
    return (int(pixels[0, 0]) << _BITS | int(pixels[0, 1])) / STEPS_PER_UL


def killed_sequence(doses: int) -> Sequence:
    """Doses of 10 µl, with 3 dark and 10 bright frames after each."""
    steps = (Mix(at_least_s=0.0, every_s=0.0), Capture("dark", frames=3), Capture("full", frames=10))
    return Sequence("killed", (Series(tuple(10.0 * number for number in range(1, doses + 1)), steps),), exposure_ms=1.0)


def main(folder: Path, doses: int, delivered_ul: float | None) -> int:
    doser = {"folder": str(folder / "doser"), "steps_per_ul": STEPS_PER_UL, "rate": 8000.0, "linger_s": 60.0}
    rig = replace(memory_rig(folder), doser=open_device("simulated-doser", doser))
    rig.camera.frame_s = 0.005
    plain = rig.camera.picture

    def picture(time_ns: int) -> np.ndarray:
        pixels = plain(time_ns)
        pixels[0, :2] = divmod(read_truth(folder / "doser" / "state").steps, 1 << _BITS)
        return pixels

    rig.camera.picture = picture
    run = folder / "run"
    try:
        runner = resumed_run(run, rig, delivered_ul) if run.exists() else new_run(killed_sequence(doses), rig, run)
    except UndecidedError as error:
        print(error, flush=True)
        return 3

    def tell(event, _):
        if event.kind == "frame":
            os.write(1, f"frame {event['index']} {event['sha256']}\n".encode())

    runner.listen(tell)
    os.write(1, b"ready\n")
    outcome = runner.run()
    if outcome.error:
        print(outcome.error, flush=True)
    return 0 if outcome.reason is FinishReason.COMPLETED else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]) if len(sys.argv) > 3 else None))
