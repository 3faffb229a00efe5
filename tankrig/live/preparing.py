"""Models prepared while a run goes on: of its patterns, for the media that its doses can give."""

import threading
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Literal

from tankrig.image.prepare import Prepared, prepare
from tankrig.light.prepared.about import box_for, holds
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.low_orders import are_dear, prepare_low_orders
from tankrig.light.rays import shift_invariant
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.results import diluted
from tankrig.scene.description import Medium, Scene

TOLERANCE, SLANTED_TOLERANCE = 0.02, 0.01
"""Asked for; where light and sight run straight, in so small a box the least work gives a tenth of that (decision 216).
Elsewhere order 2 is coarse from 5 % on, and paths are noisier: .02 gave 1.2 % on a bench; .01 gives .13 % on average,
.32 % at most, in 22 CPU s, .005 gives .09 and .21 % in 38 (rays of a bench, σs .005, three by twelve pixels a bin)."""
LOOK, LOOK_TOLERANCE, LOOK_START = Box((5e-4, 0.06), (0.5, 0.9999), (0.0, 0.93)), 0.1, Medium(5e-4, 0.01, 0.6)
"""Media among which a first look finds about where the liquid is, from one pattern; the error that is asked for, and
where the look begins."""
LOW_SHARE = 0.7
"""Share of the time that a model takes in which orders 1 and 2 of all liquids are prepared, where they are first."""
KEPT_S = 1.0
"""A model that took no longer was kept on disk, and tells nothing of what others take."""

Told = Callable[[str], object]
Phases = Literal["hg", "any"]
"""Phase functions that a model answers for: Henyey–Greenstein's, or any."""


@dataclass(frozen=True)
class Preparation:
    """How far the preparing of models is.

    Parameters
    ----------
    models
        That are not ready.
    seconds_left
        That all of them will still take; None where nothing tells yet.
    note
        Why what was learned of a bench does not serve the one under way; empty where it does, or nothing was learned.
    """

    models: int
    seconds_left: float | None
    note: str = ""


def foreseen(
    scenes: Sequence[Scene], doses_ml: Iterable[float], ink: Medium | None
) -> list[tuple[Sequence[Scene], Box]]:
    """Models that can be prepared before there is any ink, the most wanted first: scenes, and the box they share.

    A first look wants one pattern's. In a tank of glass others' are prepared too, for the orders 1 and 2 of all liquids
    that come with them.

    Parameters
    ----------
    scenes
        Of the patterns.
    doses_ml
        Ink in the tank at each dose.
    ink
        What is expected of it, per mm and ml; None where nothing is: then only a first look can be prepared.
    """
    boxes: list[Box] = []
    for dose_ml in sorted(doses_ml) if ink is not None else ():
        liquid = None if ink is None or dose_ml <= 0.0 else diluted(ink, 1.0, dose_ml)
        if liquid is not None and not any(holds(box, liquid) for box in boxes):
            boxes.append(box_for(liquid))
    looked = [one for number, one in enumerate(scenes) if number == 0 or are_dear(one)]
    return [*((scenes, box) for box in boxes), (looked, LOOK)]


def phases_prepared(plan: PhotographPlan) -> Phases | None:
    """Which phase functions a run's models are prepared for; None where fits prepare their own.

    Those of any phase function want light and sight that run straight. A fit of a free one prepares what it needs at
    each dose's liquid itself: these models' stated error, for a whole box, would leave it ten times wider than it need
    be (beads: σs ± 18 % instead of .7).
    """
    if plan.phase in ("hg", "free", "any"):
        return "hg" if plan.phase == "hg" else None
    from tankrig.light.prepared.phases.preparation import can_be_prepared

    return "any" if all(can_be_prepared(scene) for scene in plan.scenes.values()) else None


def file_of(scene: Scene, box: Box, phases: Phases = "hg") -> Path:
    """The file that keeps the model of a scene for a box, whether it is there or not."""
    from tankrig.light.prepared import preparation
    from tankrig.light.prepared.phases import preparation as of_any

    place_of = preparation.place_of if phases == "hg" else of_any.place_of
    return place_of(scene, box, tolerance_for(scene, box)).model


def unlike_learned(scene: Scene, box: Box, phases: Phases = "hg") -> str:
    """One sentence on what the nearest learned bench has otherwise than a model that is to be made; empty where none.

    First looks follow fewer paths than learning takes.
    """
    from tankrig.light.prepared.entrance import Entrance

    if phases != "hg" or box == LOOK or is_kept(scene, box, phases):
        return ""
    return Entrance.unlike(scene, box, tolerance_for(scene, box))


def is_kept(scene: Scene, box: Box, phases: Phases = "hg") -> bool:
    """Whether the cache holds the model of a scene for a box, so that a run need not wait for it."""
    return file_of(scene, box, phases).exists()


class _NotWantedError(Exception):
    """Raised in the middle of a preparation that is not wanted any more."""


class Preparing:
    """Prepares models in a thread of its own, one computation at a time, and hands them out as they become ready.

    What was begun when it is closed stays in the cache folder, and the next run goes on with it.

    Parameters
    ----------
    told
        Called, in that thread, with a sentence when models are ready or cannot be prepared.
    clock
        Seconds; for the time that is left.
    phases
        Which phase functions the models are for.
    """

    def __init__(
        self, told: Told = lambda _: None, clock: Callable[[], float] = time.monotonic, phases: Phases = "hg"
    ) -> None:
        self._told, self._clock, self._phases = told, clock, phases
        self._closing = False
        self._began_s, self._share, self._note = clock(), 0.0, ""
        self._took_s: dict[tuple[Scene, Box], float] = {}
        self._change = threading.Condition()
        self._waiting: list[tuple[Scene, Box]] = []
        self._models: dict[tuple[Scene, Box], Prepared] = {}
        self._refused: set[tuple[Scene, Box]] = set()
        self._thread = threading.Thread(target=self._work, name="preparing", daemon=True)
        self._thread.start()

    def box(self, liquid: Medium) -> Box:
        """A box that models are or will be prepared for, if one holds the liquid well inside; else a new one."""
        with self._change:
            boxes = {box: None for _, box in (*self._models, *self._waiting) if box != LOOK}
        return next((box for box in boxes if holds(box, liquid)), box_for(liquid))

    def want(self, scenes: Iterable[Scene], box: Box) -> None:
        """Prepare models of scenes next, in their order, where they are not ready; returns at once."""
        wanted = [(scene, box) for scene in scenes]
        with self._change:
            self._waiting = [
                *(one for one in wanted if one not in self._models and one not in self._refused),
                *(one for one in self._waiting if one not in wanted),
            ]
            self._change.notify_all()

    def models(self, scenes: Iterable[Scene], box: Box) -> list[Prepared] | None:
        """Models of scenes; None while one of them is not ready."""
        with self._change:
            found = [self._models.get((scene, box)) for scene in scenes]
        ready = [model for model in found if model is not None]
        return ready if len(ready) == len(found) else None

    def under_way(self, scenes: Iterable[Scene], box: Box) -> bool:
        """Whether models of scenes are going to be ready."""
        with self._change:
            return not any((scene, box) in self._refused for scene in scenes)

    @property
    def all_models(self) -> list[Prepared]:
        """All that are ready, but for those of a first look."""
        with self._change:
            return [model for (_, box), model in self._models.items() if box != LOOK]

    @property
    def left(self) -> Preparation:
        """What is still to be prepared, and how long that takes at the pace so far."""
        with self._change:
            waiting, share, spent_s = list(self._waiting), self._share, self._clock() - self._began_s
            note = self._note
            took_s = dict(self._took_s)
        if not waiting:
            return Preparation(0, 0.0)
        if share > 0.0:
            took_s.setdefault(waiting[0], spent_s / share)
        each_s = [_like(took_s, *one) for one in waiting]
        known_s = [one for one in each_s if one is not None]
        if len(known_s) < len(each_s):
            return Preparation(len(waiting), None, note)
        return Preparation(len(waiting), known_s[0] * (1.0 - share) + sum(known_s[1:]), note)

    def close(self) -> None:
        """End; the computation under way is finished first, which takes a second or so."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._closing)
                if self._closing:
                    return
                scene, box = wanted = self._waiting[0]
                self._began_s, self._share, self._note = self._clock(), 0.0, ""
            try:
                note = unlike_learned(scene, box, self._phases)
                with self._change:
                    self._note = note
                model = self._prepared(scene, box)
            except _NotWantedError:
                continue
            except Exception as error:  # whatever it is, today's fit goes on
                with self._change:
                    self._refused.add(wanted)
                self._told(f"no model could be prepared for the live fit: {error}")
            else:
                with self._change:
                    self._models[wanted] = model
                    took_s = self._clock() - self._began_s
                    if took_s > KEPT_S:
                        self._took_s[wanted] = took_s
            with self._change:
                self._waiting = [one for one in self._waiting if one != wanted]
                self._share = 0.0
            self._told("")

    def _prepared(self, scene: Scene, box: Box) -> Prepared:
        def progress(share: float) -> None:
            self._share = share
            if self._closing or self._waiting[:1] != [(scene, box)]:
                raise _NotWantedError

        return model_for(scene, box, progress, self._phases)


def _like(took_s: Mapping[tuple[Scene, Box], float], scene: Scene, box: Box) -> float | None:
    """What a model took, or the mean of those that are most like it: of its pattern, else of any; looks are no doses'.

    None where there is none.
    """
    if (scene, box) in took_s:
        return took_s[scene, box]
    alike = {key: seconds for key, seconds in took_s.items() if (key[1] == LOOK) == (box == LOOK)}
    of_pattern = [seconds for key, seconds in alike.items() if key[0] == scene]
    return fmean(of_pattern or alike.values()) if alike else None


def model_for(
    scene: Scene, box: Box, progress: Callable[[float], object] = lambda _: None, phases: Phases = "hg"
) -> Prepared:
    """The model of a scene for a box as a live fit asks for it, from the cache or made now.

    Raises
    ------
    TankrigError
        When it cannot be prepared or kept.
    """
    wanted = phases == "hg" and not is_kept(scene, box)
    made = wanted and prepare_low_orders(scene, box, lambda share: progress(LOW_SHARE * share))
    before = LOW_SHARE if made else 0.0

    def rest(share: float) -> None:
        progress(before + (1.0 - before) * share)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the error is counted in every covariance
        return prepare(scene, tolerance_for(scene, box), rest, box, phases=phases)


def tolerance_for(scene: Scene, box: Box) -> float:
    """What is asked of a model of a scene for a box."""
    if box == LOOK:
        return LOOK_TOLERANCE
    return TOLERANCE if shift_invariant(scene) else SLANTED_TOLERANCE
