"""Waves and the live fit: a search begins from order 1, order 1 has a say in the verdict, and neither can end a fit."""

import shutil
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.simulated.settings import PURE_WATER
from tankrig.light.prepared.box import Box
from tankrig.live import next_fit
from tankrig.live.exposures import Exposures, replayed
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import LOOK, LOOK_START
from tankrig.live.results import DoseFit, FailedFit, Fit, SeriesFit, SingleScattering, fits_in, from_fields
from tankrig.live.separated import Separated
from tankrig.live.sheets_so_far import SheetsSoFar
from tankrig.run.reading import Run, open_run
from tankrig.scene import Medium, Scene
from tankrig.separation import separations_of_run
from tankrig.separation.waves import Changed
from tests.live_plan import plan, seen_at
from tests.preparing_stand_ins import Ready
from tests.window_rig import write_rig
from ui.cli import main

INK = Medium(4e-4, 0.012, 0.71)
"""Of the rig that `write_rig` writes, per ml."""
THIN_ML, MORE_ML = 0.3, 0.45
SEQUENCE = """
name = "waves"
exposure_ms = 5.0
steps = [
    { do = "dose", total_ul = 300.0 },
    { do = "wait", seconds = 1.0 },
    { do = "separate", z_mm = [56.0, 64.0], periods_mm = [16, 32] },
    { do = "capture", pattern = "full", frames = 3 },
    { do = "dose", total_ul = 450.0 },
    { do = "wait", seconds = 1.0 },
    { do = "separate", z_mm = [56.0, 64.0], periods_mm = [16, 32], exposure_ms = 300.0 },
    { do = "capture", pattern = "full", frames = 3 },
]
"""


def sigma_t(dose_ml: float) -> float:
    return dose_ml * INK.sigma_t + PURE_WATER.sigma_t


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Thin ink, fitted live: the waves of the second dose are exposed for so long that all of them are saturated."""
    folder = tmp_path_factory.mktemp("waves")
    (folder / "waves.toml").write_text(SEQUENCE)
    words = ["run", str(folder / "waves.toml"), "--rig", str(write_rig(folder)), "--out", str(folder / "run")]
    assert main(words) == 0
    return open_run(folder / "run")


def test_a_live_fit_tells_what_order_1_has_against_it_and_what_keeps_order_1_from_counting(recorded: Run) -> None:
    """A doubt of waves that were exposed for too long is no error: the dose is fitted, and so is the series."""
    fits = [from_fields(event.fields) for event in recorded.fits]
    assert all(isinstance(one, DoseFit | SeriesFit) for one in fits), "no fit has failed"
    (thin, more), series = fits_in([event.fields for event in recorded.fits])
    assert abs(thin.medium.sigma_s - THIN_ML * INK.sigma_s) < 4.0 * thin.sd[1]
    assert thin.order_one == "", "order 1 and the fit agree"
    assert more.order_one.startswith("order 1 does not count, for 100 % of the sheet is saturated")
    assert "longer" not in more.order_one, "a finer wave would not help"
    assert series is not None
    assert f"At {MORE_ML:g} ml order 1 does not count" in series.verdict
    assert f"At {THIN_ML:g} ml" not in series.verdict


class AllReady(Ready):
    """Stands in for models that are all there: each is its box."""

    def models(self, scenes: list[Scene], box: Box) -> list[object]:
        return [box] * len(scenes)


def fitted(
    run: Run, sheets: SheetsSoFar, patch: pytest.MonkeyPatch, medium: Medium
) -> Iterator[tuple[Fit, list[Medium]]]:
    """Each fit as the run goes on event by event, with the starts of first looks so far; every one finds `medium`."""
    starts: list[Medium] = []

    def fit(photographs: list[object], models: list[object], start: Medium, *_: object, **__: object) -> DoseFit:
        if models[0] == LOOK:
            starts.append(start)
        return DoseFit(photographs[0].dose_ml, medium, (1e-6, 1e-5, 1e-3), gain=1.0, frames=1)

    patch.setattr(next_fit, "fit_dose_prepared", fit)
    patch.setattr(next_fit, "with_single", lambda one, _: replace(one, single=SingleScattering(0.01, 1.0)))
    exposures = Exposures(PhotographPlan.of_run(run))
    fitter = next_fit.Fitter((), AllReady(), exposures.plan, sheets=sheets)  # type: ignore[arg-type]
    for event, pixels in replayed(run):
        if exposures.take(event, pixels):
            while (found := fitter.next(exposures, last=False)) is not None:
                yield found, starts
            while fitter.unfinished:
                if (whole := fitter.finish()) is not None:
                    yield whole, starts


def test_the_search_begins_from_order_1_of_waves_that_came_before(
    recorded: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, starts = next(fitted(recorded, SheetsSoFar(recorded.path), monkeypatch, INK))
    assert starts[0].sigma_t == pytest.approx(sigma_t(THIN_ML), rel=0.1)
    assert LOOK_START.sigma_t > 2.0 * sigma_t(THIN_ML), "the start without waves is far from there"
    _, starts = next(fitted(recorded, SheetsSoFar(), monkeypatch, INK))
    assert starts[0] == LOOK_START


def test_a_wrong_fit_is_doubted_once_and_a_saturated_dose_says_why_it_is_not(
    recorded: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = Medium(1e-3, 0.03, 0.7)
    found = [one for one, _ in fitted(recorded, SheetsSoFar(recorded.path), monkeypatch, wrong)]
    last = {one.dose_ml: one for one in found if isinstance(one, DoseFit) and one.single is not None}
    assert "the fit has the wrong liquid" in last[THIN_ML].order_one
    assert "saturated" in last[MORE_ML].order_one
    assert not any(one.order_one for one in found if isinstance(one, DoseFit) and one.passing), "nobody waits for it"


def test_of_a_run_without_waves_nothing_is_read(recorded: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is anything separated: every frame of a fast run would wait for it."""
    asked = []
    monkeypatch.setattr(Separated, "of_run", lambda _, dose_ml: asked.append(dose_ml) or Separated())
    list(fitted(recorded, SheetsSoFar(recorded.path), monkeypatch, INK))
    assert set(asked) == {THIN_ML, MORE_ML}
    asked.clear()
    without = replace(PhotographPlan.of_run(recorded), sheet_ends=frozenset())
    monkeypatch.setattr(PhotographPlan, "of_run", lambda _: without)
    assert list(fitted(recorded, SheetsSoFar(recorded.path), monkeypatch, INK))
    assert asked == []


def test_what_a_search_begins_from_is_found_before_there_is_a_photograph(
    recorded: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a calibrated bench it takes half a minute, in which the first fit would wait."""
    sheets, frames, begun = SheetsSoFar(recorded.path), [], []
    monkeypatch.setattr(SheetsSoFar, "media", lambda _, dose_ml: begun.append((dose_ml, len(frames))) or ())
    exposures = Exposures(PhotographPlan.of_run(recorded))
    fitter = next_fit.Fitter((), AllReady(), exposures.plan, sheets=sheets)  # type: ignore[arg-type]
    for event, pixels in replayed(recorded):
        if exposures.take(event, pixels):
            frames += exposures.photographs()
            fitter.next(exposures, last=False)
            break
    assert begun == [(THIN_ML, 0)]


def test_waves_that_cannot_be_read_or_separated_end_no_fit(
    recorded: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "run"
    shutil.copytree(recorded.path, copy)
    frames = recorded.events("frame")
    wave = next(one["index"] for one in frames if "wave" in recorded.patterns[one["pattern_hash"]].name)
    (copy / "frames" / f"c.{wave}.0.0").unlink()
    found = list(fitted(recorded, SheetsSoFar(copy), monkeypatch, INK))
    assert found[0][1] == [LOOK_START]
    assert not any(isinstance(one, FailedFit) for one, _ in found)
    last = {one.dose_ml: one for one, _ in found if isinstance(one, DoseFit)}
    assert f"frame {wave} is missing" in last[THIN_ML].order_one
    assert "saturated" in last[MORE_ML].order_one, "the other dose's waves are whole"

    def broken(*_: object) -> Separated:
        raise ZeroDivisionError("something nobody has thought of")

    monkeypatch.setattr(Separated, "of_run", broken)
    last = {one.dose_ml: one for one, _ in fitted(recorded, SheetsSoFar(copy), monkeypatch, INK)}
    assert "nobody has thought of" in last[MORE_ML].order_one


class Later(SheetsSoFar):
    """Sheets of which there is one more when a test says so, and which then speak against any fit."""

    def __init__(self) -> None:
        super().__init__()
        self.whole, self.said = 0, "order 1 disagrees"

    def count(self, dose_ml: float) -> int:
        return self.whole if dose_ml > 0.0 else 0

    def beside(self, fit: DoseFit) -> DoseFit:
        return replace(fit, order_one=self.said if self.whole else "")


def test_waves_that_come_after_the_photographs_are_heard_and_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last steps of a dose may be its waves: what they say must stand in the journal all the same."""
    monkeypatch.setattr(next_fit, "fit_dose_prepared", lambda *_, **__: DoseFit(0.1, INK, frames=1))
    monkeypatch.setattr(next_fit, "with_single", lambda one, _: replace(one, single=SingleScattering(0.01, 1.0)))
    later = Later()
    fitter, exposures = next_fit.Fitter((), AllReady(), plan(), sheets=later), seen_at(100.0)  # type: ignore[arg-type]
    assert fitter.next(exposures, last=False) is not None
    whole = [fitter.finish(), fitter.finish()][-1]
    assert isinstance(whole, DoseFit)
    assert (whole.order_one, fitter.unfinished) == ("", False)
    later.whole = 1
    assert fitter.unfinished
    again = fitter.finish()
    assert again == replace(whole, order_one="order 1 disagrees")
    assert not fitter.unfinished
    later.whole = 2
    assert fitter.finish() is None, "it is said already"
    assert not fitter.unfinished


def test_a_sheet_with_a_fault_is_no_start_and_no_witness(recorded: Run) -> None:
    one, _ = separations_of_run(recorded)
    assert one.dose_ml == THIN_ML
    fit = DoseFit(THIN_ML, Medium(1e-3, 0.03, 0.7), (1e-6, 1e-5, 1e-3))
    moved = replace(one, changed=Changed(0.02, 0.1))
    assert Separated([one]).media
    assert "wrong liquid" in Separated([one]).beside(fit).order_one
    assert not Separated([moved]).media
    said = Separated([moved]).beside(fit).order_one
    assert said.startswith("order 1 does not count, for the ink moved while the waves were shown, by 2 %")
    assert "wrong liquid" not in said


def test_two_steps_with_the_same_waves_tell_of_a_sheet_once(recorded: Run) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a picture that is full all over is told, and bothers nobody with arithmetic
        assert [one.dose_ml for one in separations_of_run(recorded)] == [THIN_ML, MORE_ML]
    assert [one.dose_ml for one in separations_of_run(recorded, THIN_ML)] == [THIN_ML]
