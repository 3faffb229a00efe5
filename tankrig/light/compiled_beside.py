"""What paths need is compiled by a second process, the first time, while the first one compiles for orders 1 and 2.

Numba compiles in one thread of a process, and paths have half of what a first prediction waits for.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache

import numpy as np

from tankrig.compiled import kept
from tankrig.light.entering import entering
from tankrig.light.high_orders import Allowance, high_orders
from tankrig.light.paths.trace import trace
from tankrig.scene import Scene
from tankrig.threads import THREADS

PATIENCE_S = 120.0
"""After which paths are compiled here all the same: twenty times what it takes."""


@contextmanager
def paths_compiled_beside(scene: Scene) -> Iterator[None]:
    """Have another process compile what a scene's paths need, unless that was done before, and wait for it in the end.

    It ends by itself when it has compiled; an error here ends it at once. Whatever becomes of it, the code that it has
    not left on disk is compiled where it is needed.

    Parameters
    ----------
    scene
        Any scene with σs > 0.
    """
    other = begun(scene) if wanted() else None
    if other is None:
        yield
        return
    try:
        yield
        with suppress(subprocess.TimeoutExpired):
            other.wait(PATIENCE_S)
    finally:
        other.kill()
        other.wait()


def wanted() -> bool:
    """Whether paths are still to be compiled, and there is a second processor for it; no more than once in a process.

    A fit makes hundreds of images, and this one compiles for itself what it has not read before it was kept on disk.
    """
    return next(first_time(), False) and THREADS > 1 and len(os.sched_getaffinity(0)) > 1 and not kept(trace)


@cache
def first_time() -> Iterator[bool]:
    """True, and then no more."""
    return iter((True,))


def begun(scene: Scene) -> "subprocess.Popen[bytes] | None":
    """The process, which finds the modules that this one finds; None where none can be started."""
    found = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", __name__]
    quiet = subprocess.DEVNULL
    try:
        other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet, env=found)
    except OSError:
        return None
    assert other.stdin is not None
    with suppress(OSError), other.stdin as told:  # it may have ended already
        pickle.dump(scene, told)
    return other


def compile_paths(scene: Scene) -> None:
    """Follow a few paths, by the calls that an image makes."""
    lit = entering(scene, fine=False)
    high_orders(lit, np.ones(lit.camera.shape), 1.0, max_order=3, allowance=Allowance(0.0))


if __name__ == "__main__":
    compile_paths(pickle.load(sys.stdin.buffer))
