"""Prepared models for the refit of many runs: made when they are wanted, once for all processes, and shared."""

import fcntl
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from tankrig.errors import TankrigError
from tankrig.image.prepare import Prepared
from tankrig.light.prepared.about import box_for, holds
from tankrig.light.prepared.box import Box
from tankrig.live.preparing import LOOK, Phases, Preparation, Preparing, file_of, model_for
from tankrig.scene.description import Medium, Scene

KEPT = 24
"""Models that a process keeps in memory, some hundred kB each; the others are read from disk again."""


class ModelsOnDemand(Preparing):
    """Models of one run, prepared in the caller's thread when they are asked for and not before.

    The live fit prepares what may come, beside the experiment, and so what it has at a moment depends on how quick the
    machine is. Here a run gets the same models whoever fits it, whenever, which makes its fits repeat bit for bit.

    Parameters
    ----------
    progress
        Told in a few words what is being done; what it raises ends it.
    phases
        Which phase functions the models are for.
    """

    def __init__(self, progress: Callable[[str], None] = lambda _: None, phases: Phases = "hg") -> None:
        self._progress, self._phases = progress, phases
        self._used: dict[tuple[Scene, Box], Prepared] = {}
        self._not_prepared: set[tuple[Scene, Box]] = set()

    def box(self, liquid: Medium) -> Box:
        """One that models of this run were prepared for, if it holds the liquid well inside; else a new one."""
        boxes = {box: None for _, box in self._used if box != LOOK}
        return next((box for box in boxes if holds(box, liquid)), box_for(liquid))

    def want(self, wanted: Iterable[tuple[Iterable[Scene], Box]]) -> None:
        """Nothing is prepared before it is asked for."""

    def models(self, scenes: Iterable[Scene], box: Box) -> list[Prepared] | None:
        """Models of scenes; None where one of them cannot be prepared."""
        wanted = [(scene, box) for scene in scenes]
        for scene, _ in wanted:
            if (scene, box) in self._used or (scene, box) in self._not_prepared:
                continue
            try:
                self._used[scene, box] = shared_model(scene, box, self._progress, self._phases)
            except TankrigError as error:
                self._progress(f"no model could be prepared: {error}")
                self._not_prepared.add((scene, box))
        ready = [self._used[one] for one in wanted if one in self._used]
        return ready if len(ready) == len(wanted) else None

    def model_so_far(self, scene: Scene, box: Box) -> Prepared | None:
        """The whole one."""
        return next(iter(self.models([scene], box) or ()), None)

    def under_way(self, scenes: Iterable[Scene], box: Box) -> bool:  # noqa: ARG002
        """Never: what is not there when it is asked for cannot be prepared."""
        return False

    @property
    def all_models(self) -> list[Prepared]:
        """All that this run has used, but for those of a first look."""
        return [model for (_, box), model in self._used.items() if box != LOOK]

    @property
    def left(self) -> Preparation:
        """Nothing is waited for."""
        return Preparation(0, 0.0)

    def close(self) -> None:
        """There is nothing to end."""


def shared_model(
    scene: Scene, box: Box, progress: Callable[[str], None] = lambda _: None, phases: Phases = "hg"
) -> Prepared:
    """The model of a scene for a box: from memory, from disk, or made now, by one process for all."""
    return _in_memory(scene, box, _Listener(progress), phases)


class _Listener:
    """Whom to tell; all are equal, so that a cache of models does not tell them apart."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.tell = tell

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Listener)

    def __hash__(self) -> int:
        return 0


@lru_cache(maxsize=KEPT)
def _in_memory(scene: Scene, box: Box, telling: _Listener, phases: Phases) -> Prepared:
    file = file_of(scene, box, phases)
    if file.exists():
        return model_for(scene, box, phases=phases)
    telling.tell("preparing a model")
    with alone(file.with_suffix(".lock")):
        return model_for(scene, box, lambda _: telling.tell("preparing a model"), phases)


@contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Wait until no other process has the file `lock`; it is let go of when this process ends, however it does."""
    lock.parent.mkdir(parents=True, exist_ok=True)
    handle = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
