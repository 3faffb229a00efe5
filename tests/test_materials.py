"""Reference liquids: what is known of them is what their sources say, and a run is judged by both uncertainties."""

import json
import math
from dataclasses import replace
from functools import cache

import miepython
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tankrig.devices import Delivered
from tankrig.dosing.limits import DoseLimits
from tankrig.errors import SceneError
from tankrig.estimation.result import Linearity
from tankrig.live.results import DoseFit, SeriesFit
from tankrig.materials.coefficients import Optics, optics
from tankrig.materials.dosing import planned
from tankrig.materials.library import material, materials
from tankrig.materials.scalar_light import band_change, polarised, second_order
from tankrig.report.beside_reference import validated
from tankrig.scene import Medium
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import HenyeyGreenstein, Mixture
from ui.cli import main

LIMITS = DoseLimits(1000.0, 4000.0, 4000.0)
BEADS, LIPID = "polystyrene-1.0", "intralipid-20"


@cache
def at(name: str, wavelength_nm: float = 633.0) -> Optics:
    return optics(material(name), wavelength_nm)


@pytest.mark.parametrize(
    ("wavelength_nm", "sigma_s", "g"), [(633.0, 74.7, 0.659), (532.0, 113.2, 0.728), (450.0, 169.2, 0.783)]
)
def test_intralipid_is_as_published(wavelength_nm: float, sigma_s: float, g: float) -> None:
    """Michels et al. 2008; σs(1−g) is what nine batches had (Di Ninni et al. 2011) within both uncertainties."""
    found = at(LIPID, wavelength_nm)
    assert found.sigma_s.value == pytest.approx(sigma_s, rel=1e-3)
    assert found.medium.g == pytest.approx(g, abs=1e-3)
    measured = found.material.reduced
    assert measured is not None
    if measured.covers(wavelength_nm):
        apart = found.reduced.value - measured.at(wavelength_nm)
        assert abs(apart) < math.hypot(found.reduced.sd, measured.uncertainty(wavelength_nm))


def test_a_calculated_emulsion_sends_as_much_sideways_as_its_droplets_do() -> None:
    """Mie over Henyey–Greenstein of the same mean cosine at 90° is .70 … .79 for such droplets, and not 1."""
    found = at(LIPID).medium
    ratio = float(found.phase_function.at(0.0) / HenyeyGreenstein(found.g).at(0.0))
    assert 0.69 < ratio < 0.80


@settings(max_examples=25, deadline=None)
@given(st.floats(0.1, 3.0), st.floats(405.0, 695.0))
def test_beads_scatter_as_mie_and_their_label_say(diameter_um: float, wavelength_nm: float) -> None:
    """σs = 1.5 · share · Q / d for spheres that are all alike, by miepython's own efficiencies."""
    name = f"polystyrene-{diameter_um:.3f}"
    beads = material(name).labelled({"spread": (0.0, None), "solids": (0.025, 0.0005)}).beads
    assert beads is not None
    liquid = beads.liquid(wavelength_nm)
    mie = beads.mie(wavelength_nm)
    size = math.pi * mie.water_index * mie.diameter_um / (wavelength_nm / 1000.0)
    q = float(miepython.efficiencies_mx(mie.particle_index / mie.water_index, size)[1])
    assert liquid.sigma_s == pytest.approx(1e3 * 1.5 * 0.025 / 1.05 * q / mie.diameter_um, rel=1e-6)


def test_an_uncertainty_is_what_its_causes_make() -> None:
    """An index off by .003 is ± 1.5 – 2.5 % in σs for .2 – 1 µm, and solids count as they are."""
    for name in ("polystyrene-0.2", "polystyrene-0.5", BEADS):
        number = at(name).sigma_s
        assert 0.013 < abs(number.parts["refractive index"]) / number.value < 0.028
        assert number.parts["solids"] / number.value == pytest.approx(0.02, rel=1e-6)
        assert number.sd == pytest.approx(math.hypot(*number.parts.values()))


@pytest.mark.parametrize("name", [one.name for one in materials()])
def test_every_number_of_the_library_has_a_source_and_an_uncertainty(name: str) -> None:
    found = material(name)
    for curve in (found.sigma_s, found.sigma_a, found.g, found.reduced):
        if curve is not None:
            middle = 0.5 * sum(curve.range_nm or ())
            assert curve.source
            assert curve.uncertainty(middle) > 0.0
    assert found.note


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([LIPID, BEADS, "milk-regular"]), st.floats(1e-4, 0.2), st.floats(200.0, 20_000.0),
       st.floats(50.0, 2000.0), st.floats(500.0, 8000.0), st.floats(5.0, 100.0))  # fmt: skip
def test_planned_doses_keep_to_the_limits_and_reach_what_was_asked(
    name: str, sigma_s: float, tank_ml: float, dose_ul: float, run_ul: float, least_ul: float
) -> None:
    """A plan that the rig refuses at its last dose has wasted the tank."""
    limits = DoseLimits(dose_ul, run_ul, run_ul)
    try:
        plan = planned(at(name, 540.0), sigma_s, tank_ml, limits=limits, least_ul=least_ul)
    except SceneError:
        return
    assert plan.totals_ul[0] == 0.0
    held = 0.0
    for total_ul in plan.totals_ul[1:]:
        tank = Delivered(held, held, held)
        assert limits.refusal(total_ul, tank, held) is None
        assert total_ul > held
        held = total_ul
    assert plan.totals_ul[1] >= min(least_ul, 0.5 * dose_ul) - 0.3  # a dose above the limit is made of equal ones
    assert plan.sigma_s.value == pytest.approx(sigma_s, rel=0.1 / plan.totals_ul[-1] + 1e-6)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plan", "intralipid20", "--wavelength", "633", "--sigma-s", "0.02"], '"intralipid-20"'),
        (["plan", LIPID, "--sigma-s", "0.02"], "--wavelength from 400 to 900 nm"),
        (["plan", LIPID, "--wavelength", "1064", "--sigma-s", "0.02"], "from 400 to 900 nm, not at 1064 nm"),
        (["show", "milk-whole"], "give --wavelength from 460 to 620 nm"),
        (["show", "milk-whole", "--wavelength", "633"], "milk-whole: is published from 460 to 620 nm"),
        (["show", "water", "--wavelength", "360"], "water: is published from 400 to 700 nm"),
        (["show", BEADS, "--wavelength", "380"], "from 400 to 700 nm"),
        (["plan", LIPID, "--wavelength", "633", "--sigma-s", "-1"], "not positive"),
        (["plan", "polystyrene-0.2", "--wavelength", "633", "--sigma-s", "0.02"], "the rig allows"),
        (["plan", "india-ink", "--wavelength", "633", "--sigma-s", "0.02"], "measure a dilution"),
        (["show", "polystyrene-99", "--wavelength", "633"], "outside 0.05"),
        (["show", LIPID, "--wavelength", "633", "--label", "solids=0.01"], "no label"),
        (["show", BEADS, "--wavelength", "633", "--label", "colour=3"], "diameter_um"),
        (["show", BEADS, "--wavelength", "633", "--label", "solids"], "KEY=VALUE"),
        (["show", BEADS, "--wavelength", "633", "--label", "diameter_um=-1"], "'diameter_um=-1' has a number below 0"),
        (["plan", LIPID, "--wavelength", "633", "--sigma-s", "0.02", "--tank-ml", "inf"], "not a finite number"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["materials", *arguments]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.strip().splitlines()) == 1


@pytest.mark.parametrize("name", [LIPID, BEADS, "water", "milk-regular", "milk-whole"])
def test_a_listed_range_is_known_to_its_ends(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Water was listed from 350 nm and refused below 400, and the hint of a wavelength was one that milk has not."""
    low, high = material(name).range_nm or (0.0, 0.0)
    for wavelength_nm in (low, high):
        assert main(["materials", "show", name, "--wavelength", f"{wavelength_nm:g}"]) == 0
        assert f"at {wavelength_nm:g} nm" in capsys.readouterr().out
    assert main(["materials", "show", name, "--wavelength", f"{high + 1:g}"]) == 2
    assert f"from {low:g} to {high:g} nm" in capsys.readouterr().err


def test_a_plan_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """1.23 ml of Intralipid 20 % are .02/mm in 4.6 l, and dose 0 belongs to a series."""
    assert main(["materials", "plan", LIPID, "--wavelength", "633", "--sigma-s", "0.02"]) == 0
    told = capsys.readouterr().out
    assert "1234.4 µl" in told
    assert "total_ul = [0, " in told
    assert "photograph it too" in told
    assert main(["materials", "plan", BEADS, "--wavelength", "633", "--sigma-s", "0.01", "--tank-ml", "5"]) == 0
    told = capsys.readouterr().out
    assert "dilute       1 part of it with 499 parts of water" in told
    assert f"tankrig validate RUN --material {BEADS} --stock 500 --tank-ml 5" in told  # else it would not pass
    assert main(["materials", "plan", LIPID, "--wavelength", "633", "--sigma-s", "0.02", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sigma_s"] == pytest.approx(0.02, rel=1e-4)
    assert main(["materials", "--json"]) == 0
    listed = {one["name"]: one["range_nm"] for one in json.loads(capsys.readouterr().out)}
    assert {LIPID, BEADS, "water", "india-ink"} <= listed.keys()
    assert listed["milk-whole"] == listed["milk-regular"], "σs(1−g) alone is known there, and materials show tells it"
    assert listed["india-ink"] is None


def test_what_polarisation_does_is_miepythons_and_rayleighs() -> None:
    cosine = np.linspace(-0.95, 0.95, 13)
    mie = Mie(0.5, 1.59, 1.33, 532.0)
    across, along = miepython.S1_S2(1.59 / 1.33, math.pi * 1.33 * 0.5 / 0.532, cosine)
    expected = (np.abs(across) ** 2 - np.abs(along) ** 2) / (np.abs(across) ** 2 + np.abs(along) ** 2)
    assert mie.polarisation(cosine) == pytest.approx(expected, abs=2e-3)
    small = Mie(0.01, 1.59, 1.33, 532.0)
    assert small.polarisation(cosine) == pytest.approx((1.0 - cosine**2) / (1.0 + cosine**2), abs=1e-3)
    assert polarised(Mixture((mie, mie), (0.5, 0.5))) == pytest.approx(polarised(mie))
    assert polarised(HenyeyGreenstein(0.5)) is None


def test_scalar_second_order_errs_as_two_mueller_matrices_say() -> None:
    """Written once more by drawing directions and turning Stokes vectors, for small spheres and for large ones."""
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(400_000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    begin, end = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    normals = np.cross(begin, ways), np.cross(ways, end)
    cos_phi = np.sum(normals[0] * normals[1], axis=1) / np.prod(
        [np.linalg.norm(one, axis=1) for one in normals], axis=0
    )
    turned = 2.0 * cos_phi**2 - 1.0
    for mie in (Mie(0.2, 1.582, 1.3317, 633.0), Mie(0.5, 1.582, 1.3317, 532.0)):
        first, second = ways @ begin, ways @ end
        stokes_i, stokes_q = mie.at(first), mie.at(first) * mie.polarisation(first)
        seen = mie.at(second) * (stokes_i + mie.polarisation(second) * turned * stokes_q)
        expected = seen.mean() / (mie.at(second) * stokes_i).mean() - 1.0
        assert second_order(mie) == pytest.approx(expected, abs=3e-3)
    assert -0.16 < second_order(Mie(0.2, 1.582, 1.3317, 633.0)) < -0.08
    assert abs(second_order(Mie(1.0, 1.582, 1.3317, 633.0))) < 0.012


def test_a_band_changes_what_is_seen_the_more_the_wider_it_is() -> None:
    mie = Mie(1.0, 1.582, 1.3317, 633.0, spread=0.02)
    bands = [band_change(mie, band_nm) for band_nm in (1.0, 20.0, 60.0)]
    assert bands[0] < 1e-3
    assert bands[0] < bands[1] < bands[2] < 0.4


TANK_ML = 4608.0
DOSES_ML = (0.2, 0.4, 0.8, 1.6)


def series_of(
    reference: Optics, off: float = 0.0, sd: float = 0.01, bend: float = 0.0
) -> tuple[SeriesFit, list[DoseFit]]:
    """A run that found the reference, `off` by a share, with relative errors `sd`."""
    by = 1.0 / TANK_ML
    ink = Medium(1e-6, by * reference.medium.sigma_s * (1.0 + off), phase=reference.medium.phase)
    sds = np.array([1e-7, sd * ink.sigma_s, 0.003])
    covariance = tuple(tuple(row) for row in np.diag([*sds**2, 1e-12]).tolist())
    known = dict.fromkeys(("sigma_a", "sigma_s", "g"), True)
    series = SeriesFit(DOSES_ML, ink, Medium(1e-4, 0.0, 0.0), (*sds, 1e-6), linearity=Linearity(bend, 0.01),
                       identifiable=known, covariance=covariance)  # fmt: skip
    doses = [
        DoseFit(ml, replace(ink, sigma_s=ink.sigma_s * ml, sigma_a=1e-4), tuple(sds * ml), known) for ml in DOSES_ML
    ]
    return series, doses


@pytest.mark.parametrize(("off", "sd", "bend", "passed"), [
    (0.0, 0.01, 0.0, True), (0.03, 0.01, 0.0, True), (0.15, 0.01, 0.0, False), (0.0, 0.2, 0.0, False),
    (0.1, 0.2, 0.0, False), (0.0, 0.01, 0.1, False),
])  # fmt: skip
@pytest.mark.parametrize("name", [LIPID, BEADS])
def test_a_run_passes_only_where_it_agrees_and_could_have_disagreed(
    name: str, off: float, sd: float, bend: float, passed: bool
) -> None:
    """A pass of a wrong liquid, or of a run that knows nothing, would be worth nothing to whoever relies on it."""
    series, doses = series_of(at(name), off, sd, bend)
    found = validated(at(name), series, doses, TANK_ML, polarisation=0.0)
    assert found.passed is passed, found.verdict
    assert found.verdict.startswith("Passed" if passed else "Not passed")


def test_nothing_passes_that_the_fit_did_not_determine_or_test() -> None:
    series, doses = series_of(at(BEADS))
    unsure = replace(series, identifiable={"sigma_a": False, "sigma_s": False, "g": True})
    assert not validated(at(BEADS), unsure, doses, TANK_ML, polarisation=0.0).passed
    assert not validated(at(BEADS), replace(series, linearity=None), doses, TANK_ML, polarisation=0.0).passed


def test_light_whose_polarisation_nobody_knows_proves_nothing_of_beads() -> None:
    """It changes order 1 by half: a run that agrees may do so by accident."""
    series, doses = series_of(at(BEADS))
    assert validated(at(BEADS), series, doses, TANK_ML, polarisation=0.0).passed
    assert not validated(at(BEADS), series, doses, TANK_ML).passed


def test_a_diluted_stock_and_another_tank_are_counted() -> None:
    """Without that, σs per ml would be off by the dilution."""
    reference = at(LIPID)
    series, doses = series_of(reference)
    thin = replace(series, ink=replace(series.ink, sigma_s=series.ink.sigma_s / 20.0))
    rows = validated(reference, thin, doses, 2.0 * TANK_ML, stock=10.0, polarisation=0.0).rows
    assert rows[0].deviations == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.2, 0.2), st.floats(0.001, 0.05))
def test_deviations_are_the_difference_over_both_uncertainties(off: float, sd: float) -> None:
    series, doses = series_of(at(LIPID), off, sd)
    row = validated(at(LIPID), series, doses, TANK_ML, tank_relative_sd=0.01, polarisation=0.0).rows[0]
    expected = off / math.hypot(sd * (1.0 + off), 0.03, 0.01)
    assert row.deviations == pytest.approx(expected, rel=1e-3, abs=1e-6)
    assert sum(one**2 for one in row.known.parts.values()) == pytest.approx(row.known.sd**2)
