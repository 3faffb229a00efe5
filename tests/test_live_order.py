"""What a live fit does next: the newest dose first, and each dose once there are models for it."""

from dataclasses import replace

import numpy as np
import pytest

from tankrig.devices import CameraSettings, Delivered
from tankrig.errors import ImageError
from tankrig.light.prepared.about import box_for
from tankrig.light.prepared.box import Box
from tankrig.live import next_fit
from tankrig.live.exposures import Exposures, Photograph
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import LOOK
from tankrig.live.results import (
    FIRST_LOOK,
    DoseFit,
    FailedFit,
    SeriesFit,
    SingleScattering,
    diluted,
    from_fields,
    to_fields,
)
from tankrig.pattern import Pattern
from tankrig.run.conditions import Conditions
from tankrig.scene.description import Medium
from tests.live_plan import BENCH, INK, PATTERNS, SEQUENCE, dosed, event, frame, plan, seen_at
from tests.preparing_stand_ins import Boxes, ByPattern, Model, Ready


def test_the_newest_dose_is_fitted_first_and_the_series_only_over_doses_that_are_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A fit that falls behind must catch up with what a person is looking at, not work off old frames."""
    asked: list[tuple[str, object]] = []

    def fit_dose(photographs: list[Photograph], *_: object, **__: object) -> DoseFit:
        asked.append(("dose", photographs[0].dose_ml))
        return DoseFit(photographs[0].dose_ml, INK)

    def fit_all(photographs: list[Photograph], *_: object) -> SeriesFit:
        asked.append(("series", tuple(one.dose_ml for one in photographs)))
        return SeriesFit((), INK, INK)

    monkeypatch.setattr(next_fit, "fit_dose", fit_dose)
    monkeypatch.setattr(next_fit, "fit_all", fit_all)
    exposures, fitter = Exposures(plan()), next_fit.Fitter()
    pixels = np.full((40, 60), 500, np.uint16)
    for volume_ul in (100.0, 200.0):
        exposures.take(dosed(volume_ul), None)
        exposures.take(frame(PATTERNS["sheet"], 2), pixels)
    while fitter.next(exposures, last=False):
        pass
    assert asked == [("dose", 0.2), ("dose", 0.1)]
    while fitter.next(exposures, last=True):
        pass
    assert asked[2:] == [("series", (0.1, 0.2))]


def test_a_fit_that_fails_says_which_frames_it_has_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step that waits for the fit of its last frame would else wait for its whole time limit."""

    def refused(*_: object, **__: object) -> DoseFit:
        raise ImageError("too dark")

    monkeypatch.setattr(next_fit, "fit_dose", refused)
    exposures = Exposures(plan())
    exposures.take(dosed(100.0), None)
    seen = frame(PATTERNS["sheet"], 2)
    exposures.take(event("frame", **seen.fields, index=7), np.full((40, 60), 500, np.uint16))
    fit = next_fit.Fitter().next(exposures, last=True)
    assert fit == FailedFit(0.1, "too dark", 7)
    assert to_fields(fit)["newest"] == 7


def test_a_run_that_goes_on_is_not_fitted_again_where_it_was_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Resuming a long run would else begin with minutes of fits that stand in its journal already."""
    starts: list[tuple[float, Medium | None]] = []

    def fit_dose(photographs: list[Photograph], start: Medium | None, *_: object, **__: object) -> DoseFit:
        starts.append((photographs[0].dose_ml, start))
        return DoseFit(photographs[0].dose_ml, INK)

    monkeypatch.setattr(next_fit, "fit_dose", fit_dose)
    found = DoseFit(0.1, Medium(0.001, 0.02, 0.5), frames=1)
    exposures, fitter = Exposures(plan()), next_fit.Fitter([found, FailedFit(0.1, "too dark")])
    for volume_ul in (100.0, 200.0):
        exposures.take(dosed(volume_ul), None)
        exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    while fitter.next(exposures, last=False):
        pass
    assert starts == [(0.2, Medium(0.002, 0.04, 0.5))]


def test_a_rough_fit_of_a_run_that_was_too_busy_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """A dose would else keep its first fit, which sees the floor by few light paths, with errors as wide."""
    monkeypatch.setattr(next_fit, "fit_dose", lambda photographs, *_, **__: DoseFit(photographs[0].dose_ml, INK))
    rough = DoseFit(0.1, INK, frames=1, model="prepared", astray={"floor": (0.02, 0.01)})
    exposures = Exposures(plan())
    exposures.take(dosed(100.0), None)
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    assert isinstance(next_fit.Fitter([rough]).next(exposures, last=True), DoseFit)
    whole = replace(rough, single=SingleScattering(0.02, 1.0))
    assert next_fit.Fitter([whole]).next(exposures, last=True) is None


def test_a_dose_waits_for_its_models_then_each_frame_is_fitted_and_the_last_fit_is_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A window and the journal need single scattering too, which takes longer than a frame may."""
    liquid = Medium(0.0004, 0.008, 0.6)
    quick, single = DoseFit(0.1, liquid, model="prepared"), SingleScattering(0.008, 1.0)
    monkeypatch.setattr(next_fit, "fit_dose_prepared", lambda *_, **__: quick)
    monkeypatch.setattr(next_fit, "with_single", lambda fit, _: replace(fit, single=single))
    earlier = DoseFit(0.1, liquid, frames=1)
    ready = Ready()
    fitter, exposures = next_fit.Fitter([earlier], ready, plan()), Exposures(plan())  # type: ignore[arg-type]
    exposures.take(dosed(100.0), None)
    for index in (3, 4):
        seen = frame(PATTERNS["sheet"], 2)
        exposures.take(event("frame", **seen.fields, index=index), np.full((40, 60), 500, np.uint16))
    assert fitter.next(exposures, last=True) is None
    assert fitter.waiting
    ready.there = True
    fit = fitter.next(exposures, last=True)
    assert isinstance(fit, DoseFit)
    assert (fit.passing, fit.newest, fit.single) == (True, 4, None)
    recorded, whole = fitter.finish(), fitter.finish()
    assert isinstance(recorded, DoseFit)
    assert isinstance(whole, DoseFit)
    assert (recorded.passing, recorded.newest, recorded.single) == (False, 4, None)  # nobody waits for the rest
    assert (whole.passing, whole.newest, whole.single) == (False, 4, single)
    assert fitter.next(exposures, last=True) is None


def test_a_floor_is_seen_without_its_noise_once_nobody_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light by way of a floor takes 7 CPU s of each photograph so, which the first fit of a dose had been waiting for.

    What stands in the journal in the end must not have the noise: σs of a thin dose came out 1.8 % too large.
    """
    foreseen, rough, fine = (Medium(0.0004, sigma_s, 0.6) for sigma_s in (0.007, 0.0082, 0.008))
    assert box_for(foreseen) != box_for(rough)

    def fit(*_: object, quick: bool = False) -> DoseFit:
        return DoseFit(0.1, rough if quick else fine, model="prepared", astray={"floor": (0.04, 0.01)})

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    monkeypatch.setattr(next_fit, "with_single", lambda fit, _: replace(fit, single=SingleScattering(0.008, 1.0)))
    boxes, exposures = Boxes(), seen_at(100.0)
    boxes.ready.add(box_for(foreseen))  # where the fit ends models would be prepared for another box
    fitter = next_fit.Fitter([DoseFit(0.1, foreseen)], boxes, plan())  # type: ignore[arg-type]
    fits = [fitter.next(exposures, last=True), fitter.finish(), fitter.finish()]
    found = [(one.medium, one.newest) for one in fits if isinstance(one, DoseFit)]
    assert [medium for medium, _ in found] == [rough, rough, fine]
    assert len({newest for _, newest in found}) == 1


def test_a_first_look_tells_which_models_the_first_dose_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it the first dose on a bench was searched for by the tank model, for six minutes."""
    looked, liquid = Medium(0.0003, 0.009, 0.5), Medium(0.0004, 0.008, 0.59)
    asked: list[Box] = []

    def fit(photographs: list[Photograph], models: list[Model], _start: Medium, *_: object, **__: object) -> DoseFit:
        asked.append(models[0].box)
        return DoseFit(photographs[0].dose_ml, looked if models[0].box == LOOK else liquid, model="prepared")

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    boxes, exposures = Boxes(), seen_at(100.0)
    fitter = next_fit.Fitter((), boxes, plan())  # type: ignore[arg-type]
    assert boxes.wanted == [LOOK]  # before there is any frame
    assert fitter.next(exposures, last=False) is None
    assert fitter.waiting
    boxes.ready.add(LOOK)
    told = fitter.next(exposures, last=False)  # a person sees about what it is while models are prepared
    assert isinstance(told, DoseFit)
    assert (told.medium, told.model, told.passing, told.newest) == (looked, FIRST_LOOK, True, -1)
    assert fitter.next(exposures, last=False) is None  # once
    assert (fitter.waiting, fitter.unfinished) == (True, False)
    assert boxes.wanted[0] == box_for(looked)
    boxes.ready.add(box_for(looked))
    found = fitter.next(exposures, last=False)
    assert isinstance(found, DoseFit)
    assert (found.medium, found.passing) == (liquid, True)
    assert asked == [LOOK, box_for(looked)]
    assert box_for(liquid) != box_for(looked), "a minute of another model, for a liquid that this one holds"
    assert set(boxes.wanted[:2]) == {box_for(looked), box_for(diluted(liquid, 0.1, 0.2))}


def test_models_are_prepared_by_a_picture_of_ink_that_still_mixes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ink mixes for minutes, in which nothing was prepared as there was no frame: the first fit came later."""
    looked, uneven, mixed = Medium(0.0003, 0.009, 0.5), Medium(0.0003, 0.009, 0.9), Medium(0.0003, 0.018, 0.6)
    images: list[np.ndarray] = []

    def fit(photographs: list[Photograph], *_: object, **__: object) -> DoseFit:
        (one,) = photographs
        images.append(one.image)
        liquid, structure = [(looked, None), (uneven, 0.04), (mixed, None)][len(images) - 1]
        return DoseFit(one.dose_ml, liquid, model="prepared", structure=structure)

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    boxes, exposures = Boxes(), Exposures(plan())
    exposures.take(dosed(100.0), None)
    fitter = next_fit.Fitter((), boxes, plan())  # type: ignore[arg-type]
    boxes.ready.add(LOOK)
    conditions = Conditions(Delivered(100.0, 99.0, 101.0), CameraSettings(10.0))
    assert not exposures.watch(PATTERNS["dark"], np.full((40, 60), 9, np.uint16), conditions)
    assert fitter.next(exposures, last=False) is None
    assert boxes.wanted == [LOOK]
    assert exposures.watch(PATTERNS["sheet"], np.full((40, 60), 500, np.uint16), conditions)
    assert not exposures.watch(PATTERNS["sheet"], np.full((40, 60), 505, np.uint16), conditions)  # nothing to wake for
    for _ in range(2):
        assert fitter.next(exposures, last=False) is None
        assert not fitter.waiting  # a run that ends here has nothing to wait for
    assert [float(image[0, 0]) for image in images] == [50.5]  # the newest, once; counts per ms
    assert boxes.wanted == [LOOK, box_for(looked), box_for(diluted(looked, 0.1, 0.2))]
    for counts in (550, 600):  # ink has mixed further, and of the first picture a look explains too little
        assert exposures.watch(PATTERNS["sheet"], np.full((40, 60), counts, np.uint16), conditions)
        assert fitter.next(exposures, last=False) is None
        assert boxes.wanted[1] == box_for(looked if counts == 550 else mixed)
    assert [float(image[0, 0]) for image in images] == [50.5, 55.0, 60.0]
    assert boxes.wanted == [LOOK, box_for(mixed), box_for(diluted(mixed, 0.1, 0.2))], "others are wanted no more"
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 700, np.uint16))
    assert exposures.while_mixing is None
    assert exposures.photographs()[0].frames == 1


def of_two_patterns() -> tuple[next_fit.Fitter, Exposures, ByPattern]:
    """A fitter that knows the ink, a dose photographed with two patterns, and their models."""
    two = Pattern("bar", np.roll(PATTERNS["sheet"].pixels, 3, axis=1))
    planned = PhotographPlan.of(BENCH, SEQUENCE, [*PATTERNS.values(), two])
    exposures, models = Exposures(planned), ByPattern()
    exposures.take(dosed(100.0), None)
    for pattern in (PATTERNS["sheet"], two):
        exposures.take(frame(pattern, 2), np.full((40, 60), 500, np.uint16))
    earlier = DoseFit(0.05, Medium(0.0002, 0.004, 0.6), frames=1)
    return next_fit.Fitter([earlier], models, planned), exposures, models  # type: ignore[arg-type]


def test_a_dose_is_fitted_by_the_patterns_whose_models_are_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bench the first fit of a dose came when the models of all its patterns were there, twice as late."""
    fitted: list[tuple[str, ...]] = []

    def fit(photographs: list[Photograph], _models: list[Model], start: Medium, *_: object, **__: object) -> DoseFit:
        fitted.append(tuple(one.pattern for one in photographs))
        return DoseFit(0.1, start, frames=sum(one.frames for one in photographs), patterns=fitted[-1], model="prepared")

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    fitter, exposures, models = of_two_patterns()
    assert fitter.next(exposures, last=False) is None
    first, second = exposures.photographs(0)
    models.ready_scenes = [first.scene]
    some = fitter.next(exposures, last=False)
    assert isinstance(some, DoseFit)
    assert (some.patterns, some.passing, fitter.waiting) == ((first.pattern,), False, True)  # it is recorded
    assert models.wanted[0] == box_for(some.medium)
    assert fitter.next(exposures, last=False) is None  # once
    assert fitter.unfinished is False
    models.ready_scenes = [first.scene, second.scene]
    assert isinstance(fitter.next(exposures, last=False), DoseFit)
    assert fitted == [(first.pattern,), (first.pattern, second.pattern)]


def test_a_dose_is_fitted_by_first_models_until_whole_ones_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind glass a whole model takes four times as long; a dose that is left with first ones is to be fitted anew."""
    stages: list[tuple[bool, ...]] = []

    def fit(photographs: list[Photograph], models: list[Model], start: Medium, *_: object, **__: object) -> DoseFit:
        stages.append(tuple(one.first for one in models))
        frames = sum(one.frames for one in photographs)
        return DoseFit(0.1, start, frames=frames, model="prepared", first=any(one.first for one in models))

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    monkeypatch.setattr(next_fit, "with_single", lambda fit, _: replace(fit, single=SingleScattering(0.008, 1.0)))
    fitter, exposures, models = of_two_patterns()
    scenes = [one.scene for one in exposures.photographs(0)]
    fits = []
    for models.first_scenes, models.ready_scenes in (
        ([], []), (scenes[:1], []), (scenes, []), (scenes, scenes[:1]), (scenes, scenes[:1]), (scenes, scenes),
    ):  # fmt: skip
        fits.append(fitter.next(exposures, last=True))
    assert stages == [(True,), (True, True), (False, True), (False, False)]
    assert [None if one is None else one.rough for one in fits if not isinstance(one, FailedFit | SeriesFit)] == [
        None, True, True, True, None, False,
    ]  # fmt: skip
    kept = from_fields(to_fields(next(one for one in fits if one is not None)))
    assert isinstance(kept, DoseFit)
    assert kept.rough


def test_a_series_waits_for_the_models_of_doses_that_were_fitted_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that went on did not ask for them, and fitted its series by light paths: 40 minutes on a bench of glass."""
    monkeypatch.setattr(next_fit, "fit_all", lambda *_: SeriesFit((), INK, INK))
    doses_ml, exposures, boxes = (0.1, 0.25), Exposures(plan()), Boxes()
    for dose_ml in doses_ml:
        exposures.take(dosed(1000.0 * dose_ml), None)
        exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 500, np.uint16))
    before = [DoseFit(dose_ml, diluted(INK, 1.0, dose_ml), frames=1) for dose_ml in doses_ml]
    fitter = next_fit.Fitter(before, boxes, plan())  # type: ignore[arg-type]
    wanted = [box_for(fit.medium) for fit in before]
    for ready in ([], wanted[:1]):
        boxes.ready = set(ready)
        assert fitter.next(exposures, last=True) is None
        assert fitter.waiting
    assert set(wanted) <= set(boxes.wanted)
    boxes.ready = set(wanted)
    assert isinstance(fitter.next(exposures, last=True), SeriesFit)


@pytest.mark.parametrize("ink", [Medium(0.0004, 0.02, 0.96), Medium(0.0, 1e-5, 0.5), Medium(0.1, 9.0, 0.5)])
def test_ink_that_no_box_holds_is_expected_all_the_same(ink: Medium) -> None:
    """The fits' process would end as it begins."""
    boxes = Boxes()
    next_fit.Fitter((), boxes, replace(plan(), ink=ink))  # type: ignore[arg-type]
    assert boxes.wanted[-1] == LOOK
    assert boxes.wanted[0] == box_for(diluted(ink, 1.0, 0.1))


def test_all_doses_to_come_are_prepared_for_and_the_next_one_first() -> None:
    """On a bench the last dose's models were begun when its frames were in, and a person waited for minutes."""
    liquid = Medium(0.0004, 0.008, 0.6)
    three = replace(plan(), doses_ml=(0.1, 0.25, 1.0))
    boxes = Boxes()
    next_fit.Fitter([DoseFit(0.1, liquid, frames=1)], boxes, three)  # type: ignore[arg-type]
    assert boxes.wanted == [box_for(diluted(liquid, 0.1, dose_ml)) for dose_ml in three.doses_ml]


def test_the_thinnest_dose_is_looked_at_first_where_nothing_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first look is good in thin ink; by one in thick ink a refit prepared models of the wrong media."""
    looked = Medium(0.0003, 0.009, 0.5)
    seen: list[float] = []

    def fit(photographs: list[Photograph], _models: list[Model], _start: Medium, *_: object, **__: object) -> DoseFit:
        seen.append(photographs[0].dose_ml)
        return DoseFit(photographs[0].dose_ml, looked, model="prepared")

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    boxes, exposures = Boxes(), seen_at(100.0)
    exposures.take(dosed(200.0), None)
    exposures.take(frame(PATTERNS["sheet"], 2), np.full((40, 60), 900, np.uint16))
    fitter = next_fit.Fitter((), boxes, plan())  # type: ignore[arg-type]
    boxes.ready.add(LOOK)
    fitter.next(exposures, last=True)
    assert seen == [0.1]
    assert boxes.wanted[0] == box_for(looked)


def test_models_of_the_ink_expected_come_first_and_a_look_corrects_a_wrong_word(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a bottle says must not keep a dose from being fitted, nor be believed."""
    stated, true = Medium(0.004, 0.1, 0.6), Medium(0.0004, 0.02, 0.6)
    found_in: list[Box] = []

    def fit(
        photographs: list[Photograph], models: list[Model], _start: Medium, *_: object, **__: object
    ) -> DoseFit | None:
        found_in.append(models[0].box)
        low, high = models[0].box.sigma_t
        right = low < true.sigma_t < high
        return DoseFit(photographs[0].dose_ml, true, model="prepared") if right else None

    monkeypatch.setattr(next_fit, "fit_dose_prepared", fit)
    expected = replace(plan(), ink=stated)
    boxes, exposures = Boxes(), seen_at(100.0)
    fitter = next_fit.Fitter((), boxes, expected)  # type: ignore[arg-type]
    first, second = (box_for(diluted(stated, 1.0, dose_ml)) for dose_ml in (0.1, 0.2))
    assert boxes.wanted == [first, second, LOOK]
    boxes.ready |= {first, LOOK, box_for(true)}
    found = fitter.next(exposures, last=False)
    assert isinstance(found, DoseFit)
    assert found.medium == true
    assert found_in == [first, LOOK, box_for(true)]
