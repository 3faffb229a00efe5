"""One measurement in a fresh process: `python -m tankrig.benchmark.trial JOB RESULT`.

The process compiles its code and warms it on the same scene in another medium, so that nothing of the scene is known
beforehand, and then makes the image once. Its time and the most memory that the process ever had are what is reported.
It ends with the process that started it, whatever ends that: its standard input is then closed.
"""

import json
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import threading
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


def run_trial(contestant: Contestant, scene: Scene, threads: int | None = None, limit_s: float = 600.0) -> Trial:
    """Measure in a process of its own.

    Parameters
    ----------
    contestant
        Makes the image.
    scene
        Of the image.
    threads
        Processors that the process may use; None for all.
    limit_s
        When it takes longer, its warming up included, it is given up.

    Raises
    ------
    SceneError
        When the contestant cannot treat the scene.
    TankrigError
        When the process fails or takes longer than `limit_s`.
    """
    with tempfile.TemporaryDirectory(prefix="tankrig-benchmark-") as folder:
        job, result = Path(folder, "job"), Path(folder, "result.npz")
        job.write_bytes(pickle.dumps((contestant, scene, threads)))
        complaint = Path(folder, "complaint")
        command = [sys.executable, "-m", "tankrig.benchmark.trial", str(job), str(result)]
        with complaint.open("w") as stderr, subprocess.Popen(command, stdin=subprocess.PIPE, stderr=stderr) as process:
            try:
                process.wait(limit_s)
            except subprocess.TimeoutExpired as error:
                raise TankrigError(f"not done in {limit_s:g} s") from error
            finally:
                process.kill()
        if process.returncode != 0:
            last = (complaint.read_text(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise TankrigError(f"its process failed ({last})")
        with np.load(result) as data:
            said = json.loads(str(data["said"]))
            if "refused" in said:
                raise SceneError(said["refused"])
            return Trial(said["seconds"], said["cpu_seconds"], said["peak_bytes"], data["image"])


def measure(contestant: Contestant, scene: Scene, threads: int | None) -> tuple[dict[str, object], Array]:
    """What is said of a trial, and its image, made in this process; `threads` holds for all that it does later."""
    if threads is not None:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
    warnings.simplefilter("ignore")
    medium = scene.medium
    other = replace(scene, medium=Medium(1.3 * medium.sigma_a + 1e-5, 0.7 * medium.sigma_s, 0.9 * medium.g))
    try:
        contestant.warm(other)
        make = contestant.maker(scene)
        started, busy = time.perf_counter(), time.process_time()
        image = make()
        seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - busy
    except SceneError as error:
        return {"refused": str(error)}, np.zeros(0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return {"seconds": seconds, "cpu_seconds": cpu_seconds, "peak_bytes": peak}, image


def _end_with_parent() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, daemon=True).start()
    said, image = measure(*pickle.loads(Path(sys.argv[1]).read_bytes()))
    np.savez(sys.argv[2], image=image, said=np.array(json.dumps(said)))
