"""One measurement in a fresh process: `python -m tankrig.benchmark.trial JOB RESULT`.

The process compiles its code and warms it on the same scene in another medium, so that nothing of the scene is known
beforehand, and then makes the image once. Its time and the most memory that the process ever had are what is reported.
"""

import json
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.benchmark.contestant import Contestant
from tankrig.errors import SceneError, TankrigError
from tankrig.scene import Medium, Scene

Array = NDArray[np.float64]

LONGEST_S = 900.0
"""A trial that takes longer is given up."""


@dataclass(frozen=True)
class Trial:
    """What one process measured.

    Parameters
    ----------
    seconds, cpu_seconds
        Of making the image, by the wall clock and by its processors.
    peak_bytes
        Most memory that was resident at a time, libraries included.
    image
        (rows, columns).
    """

    seconds: float
    cpu_seconds: float
    peak_bytes: int
    image: Array


def run_trial(contestant: Contestant, scene: Scene, threads: int | None = None) -> Trial:
    """Measure in a process of its own.

    Parameters
    ----------
    contestant
        Makes the image.
    scene
        Of the image.
    threads
        Processors that the process may use; None for all.

    Raises
    ------
    SceneError
        When the contestant cannot treat the scene.
    TankrigError
        When the process fails or takes more than `LONGEST_S`.
    """
    with tempfile.TemporaryDirectory(prefix="tankrig-benchmark-") as folder:
        job, result = Path(folder, "job"), Path(folder, "result.npz")
        job.write_bytes(pickle.dumps((contestant, scene, threads)))
        command = [sys.executable, "-m", "tankrig.benchmark.trial", str(job), str(result)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
        except subprocess.TimeoutExpired as error:
            late = f"benchmark of {contestant.label}: not done in {LONGEST_S:.0f} s; leave the case out"
            raise TankrigError(late) from error
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise TankrigError(f"benchmark of {contestant.label}: its process failed ({last})")
        said = json.loads(done.stdout)
        if "refused" in said:
            raise SceneError(said["refused"])
        with np.load(result) as data:
            return Trial(said["seconds"], said["cpu_seconds"], said["peak_bytes"], data["image"])


def _measure(job: Path, result: Path) -> dict[str, object]:
    contestant, scene, threads = pickle.loads(job.read_bytes())
    if threads is not None:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    warnings.simplefilter("ignore")
    medium = scene.medium
    other = replace(scene, medium=Medium(1.3 * medium.sigma_a + 1e-5, 0.7 * medium.sigma_s, 0.9 * medium.g))
    try:
        contestant.maker(other)()
        make = contestant.maker(scene)
        started, busy = time.perf_counter(), time.process_time()
        image = make()
        seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - busy
    except SceneError as error:
        return {"refused": str(error)}
    np.savez(result, image=image)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {"seconds": seconds, "cpu_seconds": cpu_seconds, "peak_bytes": peak}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure(Path(sys.argv[1]), Path(sys.argv[2]))))
