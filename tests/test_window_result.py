"""What the window says of a fit with another phase function than Henyey–Greenstein's, and fitting such a run anew."""

import os

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.live.exposures import exposures_of
from tankrig.live.results import DoseFit, PhaseFound
from tankrig.run.reading import open_run
from tankrig.scene import Medium
from tankrig.scene.phase_functions import ReynoldsMcCormick, TwoTerm
from tests import on_page
from tests import recorded_runs as runs
from ui.window import jobs
from ui.window.as_python import as_python
from ui.window.fit_cards import ResultCard
from ui.window.fit_curves import FitCurves
from ui.window.refit_row import RefitRow
from ui.window.result import Z, of_dose, result_of, table
from ui.window.shown import Shown, TimedFit
from ui.window.source import Kind, RefitSettings, Source

LOBES = PhaseFound(
    (0.0, 180.0), (1.0, 0.1), (0.1, 0.1), (1e-3, 1e-4), (0.0012, 0.0001),
    {"forward": (0.9, 0.01), "backward": (-0.4, 0.05), "share": (0.95, 0.02)}, {"two-term": 1.0},
)  # fmt: skip


def with_lobes(dose_ml: float, **more: object) -> DoseFit:
    """A fit that found two lobes."""
    known = {"sigma_a": True, "sigma_s": True, "g": True}
    liquid = Medium(1e-4, 0.01, phase=TwoTerm(0.9, -0.4, 0.95))
    fit = DoseFit(dose_ml, liquid, (1e-5, 1e-4, 1e-3), known, frames=4, patterns=("rays",), scattering=LOBES)
    return replace(fit, **more)


def shown_with(*fits: DoseFit) -> Shown:
    shown = Shown(Source(Kind.REPLAY, Path("run-a")))
    shown.fits = [TimedFit(float(second), fit) for second, fit in enumerate(fits)]
    return shown


def asking(path: Path, phase: str) -> Path:
    """A recorded run whose sequence asks for other phase functions."""
    runs.recorded(path, 2)
    group = json.loads((path / "zarr.json").read_text())
    group["attributes"]["tankrig"]["settings"]["sequence"]["phase"] = phase
    (path / "zarr.json").write_text(json.dumps(group))
    return path


def test_the_card_shows_all_that_was_found_of_another_phase_function():
    """It named a class, "TwoTerm", called the mean cosine g, and kept both lobes to itself."""
    shown = shown_with(with_lobes(0.4))
    card = ResultCard()
    card.show_result(result_of(shown), "")
    assert "two lobes of Henyey–Greenstein" in card.belongs.whole
    assert "TwoTerm" not in card.belongs.whole
    assert card.values["g"][0].text() == "g, the mean cosine"
    assert card.scattering.whole == (
        "σs(1−g) 0.00120 ± 0.00020 per mm; g of the forward lobe 0.900 ± 0.020; "
        "g of the backward lobe -0.400 ± 0.098; forward share 0.950 ± 0.039 (95 %)"
    )
    assert not card.scattering.isHidden()
    card.show_result(of_dose(shown, DoseFit(0.4, Medium(1e-4, 0.01, 0.7), (1e-5, 1e-4, 1e-3))), "")
    assert card.scattering.isHidden()
    assert card.values["g"][0].text() == "g"


def test_another_phase_function_is_copied_as_text_and_as_a_table():
    plain = DoseFit(0.2, Medium(1e-4, 0.01, 0.7), (1e-5, 1e-4, 1e-3))
    shown = shown_with(plain, with_lobes(0.4))
    text = of_dose(shown, with_lobes(0.4)).text
    assert "\ng, the mean cosine = 0.8350 ± 0.0020 (95 %)\n" in text
    assert "\nσs(1−g) = 0.00120 ± 0.00020 per mm (95 %)\n" in text
    assert "\ng of the forward lobe = 0.900 ± 0.020 (95 %)\n" in text
    head, thin, thick = (line.split("\t") for line in table(shown).splitlines())
    assert len(head) == len(thin) == len(thick)
    at = head.index("forward share")
    assert (thin[at], thick[at], thick[at + 1]) == ("", "0.95", "0.0392")
    assert thick[head.index("σs(1−g) (1/mm, of ink 1/mm/ml)")] == "0.0012"
    assert thick[head.index("phase function")] == "two lobes of Henyey–Greenstein"


def test_what_a_series_does_not_determine_is_no_firm_line_through_the_doses(tmp_path):
    """A firm σa lay above all doses, with nothing to say that it might as well be 0."""
    series = replace(runs.series_fit(tmp_path, 2), identifiable={"sigma_a": False, "sigma_s": True, "g": True})
    curves = FitCurves()
    curves.show_fits([(fit.dose_ml, fit) for fit in (with_lobes(0.1), with_lobes(0.4))], "dose_ml", series)
    on_page.painted(curves)
    for name, held in (("σa", ["line", "band"]), ("σs", ["line"])):
        assert len([one for one in on_page.curves(curves, name) if one]) == len(held)
    edges = next(one for one in on_page.curves(curves, "σa") if len(one) > 2)
    last_ml, high = edges[-1]
    found = np.hypot(series.sd[0] * last_ml, series.sd[3])
    assert high == pytest.approx(series.at(last_ml).sigma_a + Z * found)
    assert edges[0][1] >= 0.0, "nothing absorbs less than nothing"
    curves.show_fits([(1.0, with_lobes(0.1))], "time_s", series)
    on_page.painted(curves)
    assert not any(on_page.curves(curves, "σa"))
    curves.deleteLater()


def test_light_that_the_model_does_not_have_is_told_with_the_result():
    """The terminal told it; the window, beside the same numbers, did not."""
    fit = with_lobes(0.4, structure=0.012)
    sentence = "1.2 % of the light is not as the model has it, and counted in the errors."
    assert of_dose(shown_with(fit), fit).verdict.endswith(sentence)
    both = shown_with(with_lobes(0.2), fit)
    both.series = replace(runs.series_fit(Path("run-a"), 2), verdict="All are determined.")
    assert result_of(both).verdict == f"All are determined. With 0.4 ml, {sentence}"


def test_a_run_is_fitted_anew_with_the_phase_functions_of_its_sequence(tmp_path, monkeypatch):
    """It came back as Henyey–Greenstein, whatever it had been fitted with."""
    path = asking(tmp_path / "run-a", "reynolds-mccormick")
    shown = Shown(Source(Kind.REPLAY, path))
    row = RefitRow()
    row.show_source(shown)
    shown.take_reading(jobs.read(path))
    assert row.settings == RefitSettings((runs.PATTERN,), phase="reynolds-mccormick")
    assert "Reynolds–McCormick asked for" in Source(Kind.REFIT, path, row.settings).title

    asked = []
    fitted = Medium(1e-4, 0.01, phase=ReynoldsMcCormick(0.7, 0.8))

    def one_dose(photographs, start, phase="hg"):
        asked.append((phase, start))
        return DoseFit(photographs[0].dose_ml, fitted)

    def series(_photographs, start=None, phase="hg"):
        asked.append((phase, start))
        return runs.series_fit(path, 2)

    monkeypatch.setattr("tankrig.live.fits.fit_dose", one_dose)
    monkeypatch.setattr("tankrig.live.fits.fit_all", series)
    photographs = [Photographed(0.1), Photographed(0.2)]
    monkeypatch.setattr("tankrig.live.exposures.Exposures.photographs", lambda _: photographs)
    monkeypatch.setattr("tankrig.live.exposures.replayed", lambda _: iter(()))
    jobs.refit(path, row.settings)
    assert [phase for phase, _ in asked] == ["reynolds-mccormick"] * 3
    assert asked[0][1] is None
    assert asked[2][1].phase == fitted.phase  # a series of such begins from what a dose has found

    by_window, asked = list(asked), []
    names: dict = {}
    exec(as_python(Source(Kind.REFIT, path, row.settings)), names)
    assert asked == by_window
    assert exposures_of(open_run(path)).plan.phase == row.settings.phase


class Photographed:
    """What a refit asks a photograph for."""

    pattern = runs.PATTERN

    def __init__(self, dose_ml: float) -> None:
        self.dose_ml = dose_ml
