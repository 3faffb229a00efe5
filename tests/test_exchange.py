"""A liquid in other programs' files is the same liquid."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tankrig.exchange.even_cosines import CLOSE, even_cosines, inverse_distribution
from tankrig.exchange.formats import exported
from tankrig.exchange.liquid import Liquid, liquid_of
from tankrig.montecarlo import simulate
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import HenyeyGreenstein, ReynoldsMcCormick, TwoTerm
from tankrig.scene.phase_table import PhaseFunction
from tankrig.scene.writing import scene_text
from ui.cli import main

BEAD = Mie(1.0, 1.5868, 1.3317, 633.0)
LIQUID = Liquid(Medium(0.001, 0.02, phase=BEAD), "a test", sd={"sigma_s": 0.0003})

families = st.one_of(
    st.builds(HenyeyGreenstein, st.floats(-0.9, 0.95)),
    st.builds(TwoTerm, st.floats(0.0, 0.95), st.floats(-0.9, 0.0), st.floats(0.0, 1.0)),
    st.builds(ReynoldsMcCormick, st.floats(0.05, 0.9), st.floats(-0.4, 1.5)),
    st.builds(Mie, st.floats(0.1, 2.0), st.floats(1.4, 1.7), st.just(1.33), st.floats(400.0, 700.0)),
)


@settings(max_examples=40, deadline=None)
@given(families)
def test_tables_of_even_cosines_keep_light_and_mean_cosine(phase: PhaseFunction) -> None:
    """The other program would see a liquid of another g, and diffuse light elsewhere."""
    cosine, values, error = even_cosines(phase)
    assert values.min() >= 0.0
    assert 2.0 * math.pi * np.trapezoid(values, cosine) == pytest.approx(1.0)
    assert error <= CLOSE
    shown = values[np.abs(cosine) < 0.5] / phase.at(cosine[np.abs(cosine) < 0.5])
    assert shown == pytest.approx(np.ones_like(shown), rel=5e-3)


@settings(max_examples=40, deadline=None)
@given(families)
def test_what_mcx_draws_from_has_the_mean_cosine(phase: PhaseFunction) -> None:
    """MCX draws cos θ linearly between the entries, −1 and 1 put at the ends; wrong way round, g changes sign."""
    entries = inverse_distribution(phase, 4094)
    whole = np.concatenate([[-1.0], entries, [1.0]])
    assert np.all(np.diff(whole) >= 0.0)
    assert np.trapezoid(whole, dx=1.0 / (whole.size - 1)) == pytest.approx(phase.mean_cosine, abs=1e-3)


def test_coefficients_are_in_each_programs_unit() -> None:
    """A scene in cm with coefficients per mm is ten times too thin."""
    hg = replace(LIQUID, medium=Medium(0.001, 0.02, 0.7))
    mitsuba = exported(hg, "mitsuba", 10.0)
    assert float(re.search(r'"sigma_t" value="([^"]+)"', mitsuba)[1]) == pytest.approx(0.21)  # type: ignore[index]
    assert float(re.search(r'"albedo" value="([^"]+)"', mitsuba)[1]) == pytest.approx(0.02 / 0.021)  # type: ignore[index]
    pbrt = exported(hg, "pbrt", 10.0)
    assert re.search(r'sigma_s" \[300 0\.2 900 0\.2\]', pbrt)
    assert "lost" not in pbrt
    mcx = json.loads(exported(hg, "mcx", 10.0))["Domain"]
    assert mcx["LengthUnit"] == 10.0
    assert mcx["Media"][1] == {"mua": 0.001, "mus": 0.02, "g": 0.7, "n": 1.33}
    assert "InverseCDF" not in mcx


def test_what_pbrt_cannot_hold_is_said() -> None:
    """Nobody would know that sideways light is 2.5 times too bright there."""
    said = exported(LIQUID, "pbrt")
    ratio = float(re.search(r"([\d.]+) at 90", said)[1])  # type: ignore[index]
    assert ratio == pytest.approx(float(HenyeyGreenstein(BEAD.mean_cosine).at(0.0) / BEAD.at(0.0)), rel=0.01)
    assert "lost" in said


def test_the_table_is_the_phase_function() -> None:
    lines = [line for line in exported(LIQUID, "csv").splitlines() if not line.startswith("#")]
    assert lines[0] == "theta_deg,cosine,p_per_sr,beta_per_m_sr"
    rows = np.array([[float(one) for one in line.split(",")] for line in lines[1:]])
    assert rows[:, 2] == pytest.approx(BEAD.at(np.cos(np.radians(rows[:, 0]))), rel=1e-3)
    assert rows[:, 3] == pytest.approx(1000.0 * 0.02 * rows[:, 2], rel=1e-5)


SCENE = Scene(
    Tank((80.0, 60.0, 50.0)),
    Medium(0.001, 0.02, phase=BEAD),
    Projector("collimated", (Beam((-4.0, 4.0), (20.0, 30.0)),)),
    Camera("orthographic", (6, 8), 10.0),
)


def test_a_scenes_liquid_comes_out_as_it_went_in(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(scene_text(SCENE), encoding="utf-8")
    found = liquid_of(tmp_path / "scene.toml")
    assert found.medium == SCENE.medium
    fit = {"medium": {"sigma_a": 0.001, "sigma_s": 0.02, "g": 0.5}, "standard_deviation": {"sigma_s": 1e-4}}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    fitted = liquid_of(tmp_path / "fit.json")
    assert fitted.medium == Medium(0.001, 0.02, 0.5)
    assert "+- 0.0001" in exported(fitted, "csv")


@pytest.mark.parametrize("to", ["mitsuba", "pbrt", "mcx", "csv"])
def test_what_a_fit_did_not_determine_is_said_in_the_file_and_on_the_terminal(
    to: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever renders with it takes every number for a measurement."""
    fit = {
        "medium": {"sigma_a": 0.001, "sigma_s": 0.02, "g": 0.5},
        "identifiable": {"sigma_a": False, "sigma_s": True, "g": False},
    }
    file, out = tmp_path / "fit.json", tmp_path / "liquid"
    file.write_text(json.dumps(fit))
    assert main(["export-medium", str(file), "--to", to, "--out", str(out)]) == 0
    assert "σa and g are not determined by the fit" in capsys.readouterr().err
    text = out.read_text(encoding="utf-8")
    assert "sigma_a = 0.001 1/mm, not determined by the fit" in text
    assert "sigma_s = 0.02 1/mm, not" not in text
    fit["identifiable"]["sigma_a"] = fit["identifiable"]["g"] = True
    file.write_text(json.dumps(fit))
    assert main(["export-medium", str(file), "--to", to, "--out", str(out)]) == 0
    assert "not determined" not in capsys.readouterr().err + out.read_text(encoding="utf-8")


def test_a_fitted_curve_is_exported_as_that_liquid(tmp_path: Path) -> None:
    """Of a fit that weighed families only the curve at some angles is kept; by g alone it would be another liquid."""
    angle = np.array([0.0, 2.0, 5.0, *np.arange(10.0, 181.0, 5.0)])
    value = BEAD.at(np.cos(np.radians(angle)))
    curve = {"families": {"mie": 0.7, "free": 0.3}, "angle_deg": angle.tolist(), "value": value.tolist()}
    fit = {"medium": {"sigma_a": 0.001, "sigma_s": 0.02, "g": BEAD.mean_cosine}, "phase": curve}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    found = liquid_of(tmp_path / "fit.json").medium
    assert found.g == pytest.approx(BEAD.mean_cosine, abs=0.005)
    seen = np.cos(np.radians(np.linspace(60.0, 120.0, 25)))
    assert found.phase_function.at(seen) == pytest.approx(BEAD.at(seen), rel=0.05)
    fit["phase"] = {**curve, "families": {"hg": 1.0}}
    (tmp_path / "fit.json").write_text(json.dumps(fit))
    assert liquid_of(tmp_path / "fit.json").medium.phase is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"medium": {"sigma_a": 1, "sigma_s": 1, "g": 0}, "phase": {"angle_deg": [0, 1]}}', "is no curve"),
        ("{", "is not JSON"),
        ('{"medium": 3}', "holds no fitted medium"),
        ('{"medium": {"sigma_a": 1}}', "missing"),
        ("[]", "no fitted"),
    ],
)
def test_what_is_no_fit_is_refused_in_one_sentence(
    tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "fit.json").write_text(text)
    assert main(["export-medium", str(tmp_path / "fit.json"), "--to", "csv", "--out", str(tmp_path / "x.csv")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.strip().splitlines()) == 1
    assert not (tmp_path / "x.csv").exists()


OTHER = Scene(  # wide light in a small tank: Mitsuba's own noise is small there
    Tank((60.0, 60.0, 40.0)),
    Medium(0.001, 0.01, 0.6),
    Projector("collimated", (Beam((-24.0, 24.0), (8.0, 32.0)),)),
    Camera("orthographic", (4, 4), 15.0),
)


@pytest.mark.parametrize("phase", [BEAD, HenyeyGreenstein(0.6)], ids=["bead", "henyey-greenstein"])
def test_mitsuba_renders_the_exported_liquid_as_the_monte_carlo_does(phase: PhaseFunction, tmp_path: Path) -> None:
    """Another sign of cos θ, another unit or another normalisation would be another liquid there.

    The file is included in a scene with another tank, light, camera and density than that of the fit.
    """
    mitsuba = pytest.importorskip("mitsuba")
    from tankrig.benchmark.mitsuba_tank import described

    mitsuba.set_variant("scalar_rgb")
    medium = Medium(0.001, 0.01, phase=phase)
    scene = replace(OTHER, medium=medium)
    (tmp_path / "liquid.xml").write_text(exported(Liquid(medium, "a test"), "mitsuba"), encoding="utf-8")
    whole = described(mitsuba, scene, 6_000)
    picture = whole["emitter"]["irradiance"]
    picture.pop("bitmap").write(str(tmp_path / "light.exr"))
    picture["filename"] = str(tmp_path / "light.exr")
    parsed = mitsuba.parser.parse_dict(mitsuba.parser.ParserConfig("scalar_rgb"), whole)
    include = '<include filename="liquid.xml"/>'
    text, count = re.subn(r"<medium.*?</medium>", include, mitsuba.parser.write_string(parsed), flags=re.DOTALL)
    assert count == 1
    (tmp_path / "scene.xml").write_text(text.replace('id="water"', 'id="tankrig"'))
    loaded = mitsuba.load_file(str(tmp_path / "scene.xml"))
    images = np.array([halves(np.asarray(mitsuba.render(loaded, seed=seed), float)[:, :, 0]) for seed in range(24)])
    simulated = simulate(scene, 300_000)
    truth = halves(simulated.image)
    found, noise = images.mean(axis=0), images.std(axis=0, ddof=1) / math.sqrt(len(images))
    assert np.all(noise < 0.04 * truth)
    assert np.all(np.abs(found - truth) < 3.5 * np.hypot(noise, simulated.noise * truth))
    backwards, other = Medium(0.001, 0.01, -medium.g), Medium(0.001, 0.01, 0.8)
    for wrong in (backwards, other):
        theirs = halves(simulate(replace(scene, medium=wrong), 100_000).image)
        assert np.any(np.abs(theirs - found) > 10.0 * noise)


def halves(image: np.ndarray) -> np.ndarray:
    """Light of the half of the tank that is near the projector, and of the far half."""
    middle = image.shape[1] // 2
    return np.array([image[:, :middle].sum(), image[:, middle:].sum()])
