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

FIRST_SHARE = 0.3
"""Share of the time of a model of two stages that the first takes."""

Told = Callable[[str], object]
Wanted = tuple[Scene, Box]
"""What a model is wanted for."""
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


def takes_long(scene: Scene, box: Box, phases: Phases = "hg") -> bool:
    """Whether a first model of a scene is there much sooner than the whole one."""
    return phases == "hg" and box != LOOK and not shift_invariant(scene) and not is_kept(scene, box)


class _NotWantedError(Exception):
    """Raised in the middle of a preparation that is not wanted any more."""


class Preparing:
    """Prepares models in a thread of its own, one computation at a time, and hands them out as they become ready.

    Where somebody waits for fits, first models of all that is wanted come before whole ones, each in their order; the
    whole ones go on with what first ones have followed. What was begun when it is closed stays in the cache folder, and
    the next run goes on with it.

    Parameters
    ----------
    told
        Called, in that thread, with a sentence when models are ready or cannot be prepared.
    clock
        Seconds; for the time that is left.
    phases
        Which phase functions the models are for.
    first
        Whether first models are made where whole ones take long.
    """

    def __init__(
        self,
        told: Told = lambda _: None,
        clock: Callable[[], float] = time.monotonic,
        phases: Phases = "hg",
        first: bool = False,
    ) -> None:
        self._told, self._clock, self._phases, self._with_first = told, clock, phases, first
        self._closing = False
        self._began_s, self._share, self._note = clock(), 0.0, ""
        self._spent_s: dict[Wanted, float] = {}
        self._took_s: dict[Wanted, float] = {}
        self._change = threading.Condition()
        self._waiting: list[Wanted] = []
        self._two_stages: set[Wanted] = set()
        self._first: dict[Wanted, Prepared] = {}
        self._models: dict[Wanted, Prepared] = {}
        self._refused: set[Wanted] = set()
        self._thread = threading.Thread(target=self._work, name="preparing", daemon=True)
        self._thread.start()

    def box(self, liquid: Medium) -> Box:
        """A box that models are or will be prepared for, if one holds the liquid well inside; else a new one."""
        with self._change:
            boxes = {box: None for _, box in (*self._models, *self._waiting) if box != LOOK}
        return next((box for box in boxes if holds(box, liquid)), box_for(liquid))

    def want(self, wanted: Iterable[tuple[Iterable[Scene], Box]]) -> None:
        """Prepare models of scenes for boxes, in this order, where they are not ready, and nothing else.

        Returns at once. What was wanted before and is not any more is left where it is: later calls go on with it.
        """
        every = dict.fromkeys((scene, box) for scenes, box in wanted for scene in scenes)
        with self._change:
            new = set(every) - self._two_stages - self._models.keys() if self._with_first else set()
        long = {one for one in new if takes_long(*one, self._phases)}
        with self._change:
            self._two_stages |= long
            self._waiting = [one for one in every if one not in self._models and one not in self._refused]
            self._change.notify_all()

    def models(self, scenes: Iterable[Scene], box: Box) -> list[Prepared] | None:
        """Models of scenes; None while one of them is not ready."""
        with self._change:
            found = [self._models.get((scene, box)) for scene in scenes]
        ready = [model for model in found if model is not None]
        return ready if len(ready) == len(found) else None

    def model_so_far(self, scene: Scene, box: Box) -> Prepared | None:
        """The model of a scene, or a first one until that is ready; None where there is neither."""
        with self._change:
            return self._models.get((scene, box), self._first.get((scene, box)))

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
            waiting, stage, note = list(self._waiting), self._stage(), self._note
            spent_s, took_s = dict(self._spent_s), dict(self._took_s)
            here_s, share = self._clock() - self._began_s, self._share
        if stage is None:
            return Preparation(0, 0.0)
        under_way, first = stage
        spent_s[under_way] = spent_s.get(under_way, 0.0) + here_s
        before = FIRST_SHARE if under_way in self._first else 0.0
        done = before + share * (FIRST_SHARE if first else 1.0 - before)
        if done > 0.0:
            took_s.setdefault(under_way, spent_s[under_way] / done)
        each_s = [_like(took_s, *one) for one in waiting]
        left_s = [
            max(0.0, whole_s - spent_s.get(one, 0.0))
            for one, whole_s in zip(waiting, each_s, strict=True)
            if whole_s is not None
        ]
        return Preparation(len(waiting), sum(left_s) if len(left_s) == len(waiting) else None, note)

    def close(self) -> None:
        """End; the computation under way is finished first, which takes a second or so."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        self._thread.join()

    def _stage(self) -> tuple[Wanted, bool] | None:
        """What is to be prepared now, and whether as a first model; None where nothing is. With the lock held."""
        for one in self._waiting:
            if one not in self._first:
                return one, one in self._two_stages
        return (self._waiting[0], False) if self._waiting else None

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._waiting or self._closing)
                stage = self._stage()
                if self._closing or stage is None:
                    return
                self._began_s, self._share, self._note = self._clock(), 0.0, ""
            one, first = stage
            try:
                note = unlike_learned(*one, self._phases)
                with self._change:
                    self._note = note
                model = self._prepared(stage)
            except _NotWantedError:
                self._count_time(one)
                continue
            except Exception as error:  # whatever it is, today's fit goes on
                with self._change:
                    self._refused.add(one)
                    self._waiting = [other for other in self._waiting if other != one]
                self._told(f"no model could be prepared for the live fit: {error}")
                continue
            took_s = self._count_time(one)
            with self._change:
                if first:
                    self._first[one] = model
                else:
                    self._models[one] = model
                    self._first.pop(one, None)
                    self._waiting = [other for other in self._waiting if other != one]
                    if took_s > KEPT_S:
                        self._took_s[one] = took_s
            self._told("")

    def _count_time(self, one: Wanted) -> float:
        """Seconds that a model has taken so far, with what has just ended."""
        with self._change:
            self._spent_s[one] = self._spent_s.get(one, 0.0) + self._clock() - self._began_s
            self._began_s, self._share = self._clock(), 0.0
            return self._spent_s[one]

    def _prepared(self, stage: tuple[Wanted, bool]) -> Prepared:
        (scene, box), first = stage

        def progress(share: float) -> None:
            with self._change:
                self._share = share
                if self._closing or self._stage() != stage:
                    raise _NotWantedError

        return model_for(scene, box, progress, self._phases, first)


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
    scene: Scene,
    box: Box,
    progress: Callable[[float], object] = lambda _: None,
    phases: Phases = "hg",
    first: bool = False,
) -> Prepared:
    """The model of a scene for a box as a live fit asks for it, from the cache or made now; see `prepare`.

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
        return prepare(scene, tolerance_for(scene, box), rest, box, phases=phases, first=first)


def tolerance_for(scene: Scene, box: Box) -> float:
    """What is asked of a model of a scene for a box."""
    if box == LOOK:
        return LOOK_TOLERANCE
    return TOLERANCE if shift_invariant(scene) else SLANTED_TOLERANCE
