"""Fits of liquids that are not Henyey–Greenstein: families, a free phase function, and what they say together."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.estimation import phase_answer, phase_average
from tankrig.estimation.phase_average import averaged, unseen_peak
from tankrig.estimation.phase_evidence import Score, by_free, families, may_peak
from tankrig.estimation.phase_families import (
    CONE_DEG,
    FAMILIES,
    PLACES,
    Family,
    amplitudes_of,
    as_free,
    free,
    henyey_greenstein,
    labelled,
)
from tankrig.estimation.phase_result import ANGLES_DEG, Scattering, scattering_of
from tankrig.estimation.polydisperse import polydisperse
from tankrig.estimation.problem import Evaluation
from tankrig.scene import Camera, Medium
from tankrig.scene.free_phase import SHAPES, FreePhase
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import FournierForand, HenyeyGreenstein, Mixture, ReynoldsMcCormick, TwoTerm
from tankrig.scene.phase_table import PhaseFunction
from tests.phase_images import LABEL, TANK, TURNS, Array, fit, many_turns, off_in_sd, photographed

EVERY = [henyey_greenstein(), polydisperse(), *(one() for one in FAMILIES.values()), labelled(LABEL)]


@pytest.mark.parametrize("family", EVERY, ids=lambda one: one.name)
def test_coordinates_are_those_of_their_member(family: Family) -> None:
    """Steps, derivatives and corrections of a fit go back and forth between the two."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        at = family.low + rng.uniform(0.05, 0.95, family.low.size) * (family.high - family.low)
        assert family.coordinates(family.phase(at)) == pytest.approx(at, rel=1e-6, abs=1e-6)


def exponential(size_um: float, index: float) -> Mixture:
    """Droplets whose number falls exponentially with their diameter, as an emulsion's are described."""
    sizes = np.linspace(0.04, 12.0 * size_um, 40)
    drops = [Mie(float(one), index, 1.3317, 633.0) for one in sizes]
    light = np.array([one.cross_section_um2 for one in drops]) * np.exp(-sizes / size_um)
    return Mixture(tuple(drops), tuple((light / light.sum()).tolist()))


@pytest.mark.parametrize(("size_um", "index"), [(0.097, 1.47), (0.05, 1.45), (0.25, 1.40)])
def test_what_liquids_have_in_common_is_theirs_whom_it_was_not_taken_from(size_um: float, index: float) -> None:
    """None of the calculated liquids has exponential sizes. Free shapes expect Henyey–Greenstein's p at a right
    angle, which is up to .4 of its logarithm more."""
    from scipy.optimize import least_squares

    liquid, family, turns = exponential(size_um, index), polydisperse(), np.cos(np.radians(np.arange(5.0, 180.0, 5.0)))
    wanted = np.log(liquid.at(turns))
    end = least_squares(
        lambda at: np.concatenate([(np.log(family.phase(at).at(turns)) - wanted) / 0.03, at[1:]]),
        family.like(liquid.mean_cosine),
    )
    assert float(end.x[1:] @ end.x[1:]) < 8.0 + 2.0 * 4.0
    assert np.abs(np.log(family.phase(end.x).at(turns)) - wanted).max() < 0.06
    usual = family.phase(family.like(liquid.mean_cosine))
    plain = HenyeyGreenstein(liquid.mean_cosine)
    assert abs(math.log(usual.at(0.0) / liquid.at(0.0))) < abs(math.log(plain.at(0.0) / liquid.at(0.0))) + 0.05


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.9, 0.95), st.lists(st.floats(-3.0, 3.0), max_size=SHAPES))
def test_any_amplitudes_are_a_phase_function(g: float, amplitudes: list[float]) -> None:
    phase = FreePhase(g, tuple(amplitudes))
    moments = phase.moments(2)
    assert moments[0] == pytest.approx(1.0, abs=1e-9)
    assert abs(moments[1]) < 1.0
    assert np.all(phase.at(TURNS) > 0.0)


def test_free_shapes_hold_an_emulsions_phase_function() -> None:
    """Were they too coarse or too stiff, coefficients would bend to make up for it."""
    sizes = np.linspace(0.1, 1.0, 10)
    oil = Mixture(
        tuple(Mie(float(d), 1.47, 1.3317, 633.0) for d in sizes),
        tuple(np.exp(-sizes / 0.2) / np.exp(-sizes / 0.2).sum()),
    )
    angles = np.arange(2.0, 179.0, 4.0)
    cosines = np.cos(np.radians(angles))
    from scipy.optimize import least_squares

    wanted, family = np.log(oil.at(cosines)), free()
    end = least_squares(
        lambda at: np.concatenate([30.0 * (np.log(family.phase(at).at(cosines)) - wanted), at[1:]]),
        family.like(oil.mean_cosine),
    )
    assert np.abs(np.log(family.phase(end.x).at(cosines)) - wanted).max() < 0.03
    assert np.abs(end.x[1:]).max() < 3.0


@pytest.mark.parametrize(
    ("asked", "truth"),
    [
        ("two-term", TwoTerm(0.85, -0.3, 0.93)),
        ("reynolds-mccormick", ReynoldsMcCormick(0.6, 1.2)),
        (LABEL, Mie(0.52, 1.5834, 1.3317, 633.0, spread=0.02)),
    ],
    ids=["two-term", "reynolds-mccormick", "bead that its label is 4 % off"],
)
def test_the_truths_family_finds_the_truth(asked: str | PhaseFunction, truth: PhaseFunction) -> None:
    """Coefficients, mean cosine and curve, each within its errors: a wrong derivative or chain would show in one."""
    found = fit(truth, asked)
    assert np.abs(off_in_sd(found, truth)).max() < 4.0
    assert found.medium.sigma_s == pytest.approx(0.02, rel=0.03)
    curve = found.scattering.curve
    seen = (ANGLES_DEG > 20.0) & (ANGLES_DEG < 160.0)
    off = np.log(curve.value / truth.at(np.cos(np.radians(ANGLES_DEG)))) / np.maximum(curve.sd, 0.01)
    assert np.abs(off[seen]).max() < 4.5
    assert "noise, as expected" in found.verdict


def test_a_given_phase_function_stays_what_it_is() -> None:
    truth = TwoTerm(0.85, -0.3, 0.93)
    found = fit(truth, truth)
    assert found.phase == truth
    off = np.array([found.medium.sigma_a - 0.001, found.medium.sigma_s - 0.02])
    assert (np.abs(off) < 4.0 * np.sqrt(np.diag(found.covariance)[:2])).all()
    assert found.covariance[2, 2] == pytest.approx(0.0, abs=1e-12)


def test_families_are_weighed_by_what_they_explain() -> None:
    """A simple liquid keeps narrow intervals, and what no family describes gets the free one's."""
    simple = fit(HenyeyGreenstein(0.8), "any")
    assert simple.scattering.families["hg"] > 0.5
    assert sum(simple.scattering.families.values()) == pytest.approx(1.0)
    assert np.abs(off_in_sd(simple, HenyeyGreenstein(0.8))).max() < 4.0
    freed = fit(HenyeyGreenstein(0.8), "free")
    assert simple.covariance[1, 1] < freed.covariance[1, 1]
    assert simple.covariance[2, 2] < 0.5 * freed.covariance[2, 2]
    lumpy = FreePhase(0.8, (1.0, -1.5, 1.0, -1.0, 1.0, -1.0))
    strange = fit(lumpy, "any")
    assert strange.covariance[2, 2] > 0.5 * freed.covariance[2, 2]
    assert np.abs(off_in_sd(strange, lumpy)).max() < 4.0


def test_families_are_weighed_about_exact_images_of_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Derivatives lead a family astray where its members are far from where the free fit ended."""
    truth, kept = TwoTerm(0.88, -0.3, 0.94), []

    def seen(best: Evaluation, spread: Array, family: Family, _: object) -> Scattering:
        kept.append((best, spread, family))
        return averaged(best, spread, family)

    monkeypatch.setattr(phase_answer, "averaged", seen)
    monkeypatch.setattr(phase_average, "unseen_peak", lambda answer: answer)  # only what is seen is compared
    fit(truth, "any")
    ((best, spread, family),) = kept
    beside = best.coordinates + 0.1 * (np.eye(best.coordinates.size)[0] - np.eye(best.coordinates.size)[2])
    far, off = best.problem.at(beside), []
    for exact in (None, lambda liquid, _: many_turns(liquid)):
        found = averaged(far, spread, family, exact)
        off.append(abs(found.liquid.sigma_s - 0.02) / math.sqrt(found.covariance[1, 1]))
    assert off[0] > 5.0
    assert off[1] < 2.0


def test_no_liquid_is_taken_to_be_a_member_of_a_family() -> None:
    """Beads of .2 µm are two-term to 3 % of what may be, and sigma_s came out 6.5 stated standard deviations off."""
    nearest = as_free(ReynoldsMcCormick(0.6, 1.2))
    nearest[1:] += 0.1 * np.cos(2.0 * np.arange(SHAPES))
    truth = free().phase(nearest)
    value, within = truth.at(np.cos(np.radians(ANGLES_DEG))), {}
    for phase in ("reynolds-mccormick", "any"):
        found = fit(truth, phase)
        low, high = found.scattering.curve.band(0.95)
        within[phase] = np.mean((value > low) & (value < high))
    assert within["reynolds-mccormick"] < 0.5
    assert within["any"] > 0.9
    stiff = [found.scattering.families[name] for name in ("reynolds-mccormick", "polydisperse")]
    assert min(stiff) > 0.1
    assert sum(stiff) > 0.9
    assert np.abs(off_in_sd(found, truth)).max() < 4.0


def test_intervals_of_the_average_cover() -> None:
    """Over liquids drawn from what is expected; a narrow average would leave them out again and again."""
    rng = np.random.default_rng(3)
    off = []
    for seed in range(5):
        truth = FreePhase(float(rng.uniform(0.5, 0.9)), tuple(0.7 * rng.normal(size=SHAPES)))
        off.append(off_in_sd(fit(truth, "any", seed), truth))
    assert np.sqrt(np.mean(np.square(off))) < 1.8
    assert np.abs(off).max() < 4.5


def test_errors_of_what_follows_are_those_of_repeated_draws() -> None:
    """σs p(90°), σs(1−g) and σs beyond a cone are read off more often than σs itself."""
    family, rng = free(), np.random.default_rng(1)
    at = np.array([math.atanh(0.8), *[0.3] * SHAPES])
    root = 0.02 * rng.normal(size=(at.size + 2, at.size + 2)) * np.array([1e-3, 1e-2, *[1.0] * at.size])[:, None]
    stated = scattering_of(np.array([0.001, 0.02]), at, root @ root.T, family)
    draws = []
    for _ in range(300):
        move = root @ rng.normal(size=at.size + 2)
        phase, sigma_s = family.phase(at + move[2:]), 0.02 + move[1]
        beyond = sigma_s * (1.0 - float(phase.share_within(np.cos(np.radians([CONE_DEG])))[0]))
        draws.append((sigma_s * float(phase.at(0.0)), sigma_s * (1.0 - phase.mean_cosine), beyond))
    read_off = stated.at_right_angle, stated.reduced, stated.outside_cone
    assert np.mean(draws, axis=0) == pytest.approx([value for value, _ in read_off], rel=0.02)
    assert np.std(draws, axis=0) == pytest.approx([sd for _, sd in read_off], rel=0.15)


@pytest.mark.long
def test_a_given_phase_function_is_taken_as_it_is() -> None:
    """Nothing of it is fitted, so that an image tells σa and σs only; by light paths."""
    scene = replace(TANK, camera=Camera("orthographic", (20, 30), 8.0))
    truth = Medium(3e-4, 0.01, phase=TwoTerm(0.88, -0.3, 0.94))
    image = tankrig.predict(replace(scene, medium=truth), tolerance=0.005).image
    found = tankrig.estimate(image, scene, noise=0.003 * float(image.max()), phase=truth.phase)
    assert found.medium.phase == truth.phase
    assert abs(found.medium.sigma_s - 0.01) < 4.0 * math.sqrt(found.covariance[1, 1]) + 1e-4


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("asked", ["any", None])
def test_an_emulsions_phase_function_is_a_result(asked: str | None) -> None:
    """Left alone, a fit looked for it by derivatives of Henyey–Greenstein's models: σs 5 % off, ten stated sd."""
    image, noise = photographed("emulsion")
    found = tankrig.estimate(image, TANK, noise=noise, phase=asked)
    assert abs(found.medium.sigma_s - 0.010) < 3.0 * math.sqrt(found.covariance[1, 1])
    assert found.medium.sigma_s == pytest.approx(0.010, rel=0.03)
    assert found.medium.g == pytest.approx(0.76328, abs=0.015)
    assert found.scattering.at_right_angle[0] == pytest.approx(1.1642e-4, rel=0.06)
    assert found.identifiable["sigma_s"]


def known_of(truth: PhaseFunction, cone_deg: float = 0.0) -> tuple[Score, Array]:
    """What a good image says of a liquid of σs .02/mm, and the covariance of that."""
    base = math.atanh(min(truth.mean_cosine, 0.9))
    at = np.array([1e-3, 0.02, base, *amplitudes_of(truth.at(PLACES), base, cone_deg)])
    known = np.array([1e-4, 5e-4, 0.05, *[0.1] * SHAPES])
    return Score(at, np.zeros(at.size), np.diag(1.0 / known), np.zeros((at.size, 1))), np.diag(known**2)


@pytest.mark.parametrize(
    ("truth", "may"),
    [
        (FournierForand(1.1, 3.58), True),
        (FournierForand(1.05, 3.8), True),
        (TwoTerm(0.88, -0.3, 0.94), False),
        (ReynoldsMcCormick(0.7, 0.8), False),
        (HenyeyGreenstein(0.93), False),
        (exponential(0.097, 1.47), False),
    ],
    ids=lambda one: getattr(one, "kind", ""),
)
def test_a_peak_that_no_image_shows_is_told_by_what_turns_by_more(truth: PhaseFunction, may: bool) -> None:
    """Natural waters turn half of their light by less than 5°, and their σs was 23 % off, "determined"."""
    score, spread = known_of(truth, CONE_DEG if may else 0.0)
    freely = by_free(score, spread, free())
    assert may_peak(score, [freely, *families(score, freely)]) == may


def test_an_answer_that_may_peak_unseen_holds_what_the_peak_may_add() -> None:
    """σs and the mean cosine of natural waters were 3 to 12 standard deviations off, and σs (1 − g) was right."""
    score, spread = known_of(HenyeyGreenstein(0.9))
    answer = by_free(score, spread, free()).answer()
    peaked = unseen_peak(answer)
    share, liquid = 0.3, answer.liquid
    for k, more in ((1, share / (1.0 - share) * liquid.sigma_s), (2, share * (1.0 - liquid.g))):
        assert more < 2.0 * math.sqrt(peaked.covariance[k, k])
    reduced = np.array([0.0, 1.0 - liquid.g, -liquid.sigma_s])  # gradient of σs (1 − g)
    assert reduced @ peaked.covariance @ reduced == pytest.approx(reduced @ answer.covariance @ reduced)
    assert peaked.covariance[0, 0] == answer.covariance[0, 0]
    assert (peaked.may_peak, peaked.outside_cone) == (True, answer.outside_cone)
