"""The seam of the inference engine: blocks of parameters, covariances of errors, gain and offsets, typed results."""

import json
import os
import pickle
import subprocess
import sys
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tankrig.estimation.astray_patterns import gamma
from tankrig.estimation.astray_shown import met_by_noise
from tankrig.estimation.coordinates import Range, to_coordinates
from tankrig.estimation.differences import Forward, slopes_of
from tankrig.estimation.fitting import fitted
from tankrig.estimation.left_over import left_over, stated_errors
from tankrig.estimation.misfit import faults_of, shown
from tankrig.estimation.observation import observe
from tankrig.estimation.optimiser import solve, without_noise
from tankrig.estimation.parameters import Block, MediumBlock, Values
from tankrig.estimation.problem import Evaluation, Problem, View
from tankrig.estimation.result import Linearity
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.shots import Fit, Shot
from tankrig.estimation.uncertainty import SmoothError, Whitening
from tankrig.estimation.versions import Models, image_of
from tankrig.live.results import DoseFit, FailedFit, SeriesFit, SingleScattering, fits_in, from_fields, to_fields
from tankrig.prediction import Prediction
from tankrig.scene import Medium
from tests.test_bent_scenes import SAME
from tests.test_estimation import MEDIUM, SCENE, noisy, tank_like

Array = NDArray[np.float64]
RANGE = Range.of_tank(240.0)
TRUTH = np.array([MEDIUM.sigma_a, MEDIUM.sigma_s, MEDIUM.g])
ROWS, COLUMNS = np.mgrid[:40, :60]
GLOW = 1e-3 * (1.0 + ROWS / 40.0) * np.exp(-COLUMNS / 50.0)


@dataclass(frozen=True)
class GlowBlock(Block):
    """Light of a known shape that the set-up adds to the image: a block that the engine has never heard of."""

    name: ClassVar[str] = "glow"
    names = ("glow",)

    def added(self, values: Values, liquid: Medium) -> Array:  # noqa: ARG002
        return values[self.name][0] * GLOW

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Array) -> Array:  # noqa: ARG002
        return GLOW[None]


def fit_glow(blocks: tuple[Block, ...]) -> tuple[Fit, Array]:
    image, noise = noisy(MEDIUM)
    models = Models(tank_like, lambda _: (tank_like, tank_like))
    shot = Shot(observe(image + 0.8 * GLOW, (40, 60), noise), SCENE, models)
    fit = fitted([shot], blocks, Scaling(1.0, 0.0), lambda _: None)
    (view,) = fit.optimum.problem.views
    return fit, fit.optimum.sensitivity.covariance([shot.observation.noise], [view.error])


def test_a_block_is_fitted_along_without_a_change_to_the_engine() -> None:
    """Phase functions and optics come as blocks: search, steps and uncertainty must take one that they do not know."""
    medium = MediumBlock(RANGE)
    without, spread = fit_glow((medium,))
    off = (without.optimum.values["medium"] - TRUTH) / np.sqrt(np.diag(spread))
    assert np.abs(off).max() > 10.0
    fit, spread = fit_glow((medium, GlowBlock()))
    values = fit.optimum.values
    off = (np.append(values["medium"], values["glow"]) - [*TRUTH, 0.8]) / np.sqrt(np.diag(spread))
    assert np.abs(off).max() < 4.0
    assert np.sqrt(spread[3, 3]) < 0.1


@dataclass(frozen=True)
class PatternWhitening:
    """W = (1 + V Vᵀ)^−½ D⁻¹ for errors of covariance D² + P Pᵀ, V = D⁻¹ P; from V's thin decomposition."""

    sd: Array
    basis: Array
    shrink: Array

    def whiten(self, rows: Array) -> Array:
        scaled = rows / self.sd
        return scaled - ((scaled @ self.basis) * self.shrink) @ self.basis.T

    def transposed(self, rows: Array) -> Array:
        return (rows - ((rows @ self.basis) * self.shrink) @ self.basis.T) / self.sd


@dataclass(frozen=True)
class PatternError:
    """An error that is a sum of known patterns of unknown size: low rank beside the noise's diagonal."""

    patterns: Array

    def whitening(self, noise: Array, used: NDArray[np.bool_]) -> Whitening:
        basis, sizes, _ = np.linalg.svd((self.patterns[:, used] / noise[used]).T, full_matrices=False)
        return PatternWhitening(noise[used], basis, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2))

    def between(self, responses: Array, used: NDArray[np.bool_]) -> Array:
        seen = responses @ self.patterns[:, used].T
        return seen @ seen.T


def test_a_correlated_error_is_weighed_and_counted_as_what_it_is() -> None:
    """A smooth error that passes for white moves coefficients by many stated standard deviations; told, it must not."""
    clean = tank_like(MEDIUM).image
    noise = np.full(clean.shape, 0.002 * float(clean.max()))
    patterns = 0.02 * np.stack([clean * np.cos(COLUMNS / 20.0), clean * np.sin(ROWS / 9.0)])
    random, forward = np.random.default_rng(4), image_of(tank_like)
    off: dict[str, list[Array]] = {"told": [], "white": []}
    for _ in range(40):
        image = clean + random.normal(0.0, noise) + np.tensordot(random.normal(size=2), patterns, 1)
        for name, error in (("told", PatternError(patterns)), ("white", SmoothError(np.zeros_like(clean), 60.0))):
            view = View(observe(image, clean.shape, noise), forward, slopes_of(forward, 240.0), error)
            problem = Problem((view,), (MediumBlock(RANGE),), Scaling(1.0, 0.0))
            best = solve(problem, to_coordinates(MEDIUM), 0.01)
            spread = best.sensitivity.covariance([noise], [error])
            off[name].append((best.values["medium"] - TRUTH) / np.sqrt(np.diag(spread)))
            assert np.allclose(spread, best.sensitivity.assumed, rtol=1e-6)  # errors are as the fit weighs them
    told, white = (np.sqrt(np.mean(np.square(off[name]), axis=0)) for name in ("told", "white"))
    assert (np.abs(told - 1.0) < 0.35).all()
    assert white.max() > 5.0


def test_noise_of_derivatives_is_no_knowledge_and_holds_no_step_back() -> None:
    """Where noise is as large as what tells σs and g apart, steps went half of the way and errors were too small."""
    forward, size, random = image_of(tank_like), np.array([4e-5, 4e-4, 0.04]), np.random.default_rng(7)
    clean, exact = forward(MEDIUM), slopes_of(forward, 240.0)(MEDIUM)
    noise = np.full(clean.shape, 0.002 * float(clean.max()))
    told, ways = np.linalg.eigh(np.tensordot(exact, exact, ((1, 2), (1, 2))) * np.outer(size, size))
    flattest = ways[:, 0] * size
    away = Medium(*(TRUTH + 0.01 * flattest))
    apart = 2.5 * np.sqrt(told[0] / clean.size) / size  # of each of eight, pixel by pixel
    found: dict[str, list[tuple[float, float]]] = {"known": [], "not known": []}
    wanted = told[0] / noise[0, 0] ** 2
    for _ in range(20):
        groups = exact + random.normal(size=(8, 3, *clean.shape)) * apart[:, None, None]
        slopes = groups.mean(axis=0)
        patterns = (groups - slopes) / np.sqrt(8.0 * 7.0)

        def line(medium: Medium, slopes: Array = slopes) -> Array:
            return np.asarray(
                forward(away) + np.tensordot(np.subtract(medium.coefficients, away.coefficients), slopes, 1)
            )

        for name, known in (("known", patterns), ("not known", patterns[:0])):
            problem = problem_of(clean, noise, line, slopes).with_slopes_noise([lambda _, known=known: known])
            at = problem.at(to_coordinates(away))
            end = solve(problem, at.coordinates, 1e-9, 50, damping=0.0).coordinates + without_noise(at)
            moved = (problem.at(end).values["medium"] - away.coefficients) / size
            fisher = (flattest @ at.sensitivity.fisher @ flattest) / wanted
            found[name].append((-100.0 * float(moved @ ways[:, 0]), float(fisher)))
    (moved, told_by), (short, more) = (np.mean(found[name], axis=0) for name in ("known", "not known"))
    assert short < 0.75
    assert moved == pytest.approx(1.0, abs=0.1)
    assert more > 1.5
    assert told_by == pytest.approx(1.0, abs=0.1)


def test_noise_that_image_and_residual_share_is_no_fault() -> None:
    """Photographs without any showed "counts not in proportion to the light" by 13 deviations."""
    random, scaling = np.random.default_rng(8), Scaling.given("free", "free")
    clean, at = tank_like(MEDIUM).image, to_coordinates(MEDIUM)
    noise = np.full(clean.shape, 0.002 * float(clean.max()))
    sd = 0.02 * np.sqrt(clean * clean.max())
    of_paths = random.normal(0.0, sd)
    seen = observe(clean + random.normal(0.0, noise), clean.shape, noise)

    def by_paths(medium: Medium) -> Array:
        return np.asarray(tank_like(medium).image + of_paths)

    view = View(seen, by_paths, slopes_of(image_of(tank_like), 240.0), SmoothError(sd, 60.0))
    best = Problem((view,), (MediumBlock(RANGE),), scaling).at(at)
    fit = Fit(best, (tank_like,), (of_paths,))

    def deviations(place: Evaluation) -> Array:
        (image,) = place.images
        (own,) = place.problem.views
        faults = place.project_out(own.whitened(np.stack([gamma(SCENE, image), image.mean() - image])))
        both, none = np.hypot(noise, sd), SmoothError(np.zeros_like(clean), 60.0)
        sizes, chances, _ = shown(place.sensitivity, place.left, faults[:, : clean.size], [both], [none])
        return np.abs(sizes / chances)

    assert deviations(best).max() > 5.0
    assert deviations(fit.calm).max() < 3.0
    assert np.sqrt(np.mean((fit.calm.left - best.left) ** 2)) < 0.2


@pytest.mark.parametrize("gain", ["free", 1.0])
def test_what_noise_of_paths_makes_of_a_fault_is_taken_off_where_no_better_image_is_at_hand(gain: str | float) -> None:
    """Bent light of many scatterings showed "blur that the scene does not describe" by three deviations."""
    random, scaling, count = np.random.default_rng(9), Scaling.given(gain, "free"), 16
    clean, exact = tank_like(MEDIUM).image, slopes_of(image_of(tank_like), 240.0)
    noise, sd = np.full(clean.shape, 0.002 * float(clean.max())), 0.01 * np.sqrt(clean * clean.max())
    found = []
    for _ in range(30):
        lattices = random.normal(0.0, sd * np.sqrt(count), (count, *clean.shape))
        of_paths = lattices.mean(axis=0)
        patterns = (lattices - of_paths) / np.sqrt(count * (count - 3.0))

        def by_paths(medium: Medium, noise: Array = of_paths, patterns: Array = patterns) -> Prediction:
            return Prediction(tank_like(medium).image + noise, "tank", patterns=patterns)

        seen = observe(clean + random.normal(0.0, noise), clean.shape, noise)
        view = View(seen, image_of(by_paths), exact, SmoothError(sd, 60.0))
        best = solve(Problem((view,), (MediumBlock(RANGE),), scaling), to_coordinates(MEDIUM), 1e-6)
        _, _, (left,) = left_over(Fit(best, (by_paths,)))
        changes = view.whitened(faults_of(left.smooth))
        faults, errors = best.project_out(changes)[:, : clean.size], stated_errors(best, [left])
        met = met_by_noise(best, left, changes, lambda _, noise: faults_of(noise))
        for more in (0.0, met):
            sizes, chances, _ = shown(best.sensitivity, best.left, faults, [left.noise], errors, more)
            found.append(sizes / chances)
    as_it_is, taken_off = np.mean(found[::2], axis=0), np.mean(found[1::2], axis=0)
    assert np.abs(as_it_is).max() > 5.0
    assert np.abs(taken_off).max() < 0.25 * np.abs(as_it_is).max()


def problem_of(image: Array, noise: Array, forward: Forward, slopes: Array) -> Problem:
    """Of one image of known gain, with a model that has no error."""
    view = View(observe(image, image.shape, noise), forward, lambda _: slopes, SmoothError(np.zeros_like(image), 60.0))
    return Problem((view,), (MediumBlock(RANGE),), Scaling(1.0, 0.0))


def truth_found(fit: Fit, models: Models, image: Array, noise: float) -> Array:
    """How far a fit is from where its problem is solved with the exact model throughout, in standard deviations."""
    exact = models.exact
    forward = image_of(models.coarse if exact is None else lambda medium: exact(medium, 1))
    (view,) = fit.optimum.problem.views
    whole = replace(view, forward=forward, slopes=slopes_of(forward, 240.0, step=1e-3))
    best = solve(replace(fit.optimum.problem, views=(whole,), quick=True), fit.optimum.coordinates, 1e-7, 99, 0.0)
    spread = best.sensitivity.covariance([np.full(image.shape, noise)], [None])
    return (fit.optimum.values["medium"] - best.values["medium"]) / np.sqrt(np.diag(spread))


@pytest.mark.parametrize("share", [1.0, 1.1, 0.9])
def test_a_live_fit_asks_a_quick_model_for_few_images(share: float) -> None:
    """Each frame is fitted anew while it is watched: a fit that solves twice, or creeps, halves the frames fitted."""
    image, noise = noisy(MEDIUM)
    asked: list[Medium] = []

    def counted(medium: Medium) -> Prediction:
        asked.append(medium)
        return tank_like(medium)

    own = slopes_of(image_of(tank_like), 240.0)
    models = Models(counted, lambda _: (counted, counted), own, RANGE)
    shot = Shot(observe(image, (40, 60), noise), SCENE, models)
    start = to_coordinates(Medium(share * MEDIUM.sigma_a, share * MEDIUM.sigma_s, MEDIUM.g))
    fit = fitted([shot], (MediumBlock(RANGE),), Scaling(None, 0.0), lambda _: None, start)
    assert len(set(asked)) <= 4
    assert np.abs(truth_found(fit, models, image, noise)).max() < 0.3


def test_one_exact_image_takes_a_cheap_model_to_the_optimum_of_the_exact_one() -> None:
    """Exact images cost most of a dose's fit: stopping short biases it, and asking for another doubles its time."""
    image, noise = noisy(MEDIUM)
    tilt, asked = 1.0 + 0.003 * np.cos(COLUMNS / 15.0), []

    def cheap(medium: Medium) -> Prediction:
        return replace(tank_like(medium), image=tank_like(medium).image * tilt)

    def exact(medium: Medium, _: int) -> Prediction:
        asked.append(medium)
        return tank_like(medium)

    models = Models(cheap, None, exact=exact)
    shot = Shot(observe(image, (40, 60), noise), SCENE, models)
    start = to_coordinates(Medium(0.93 * MEDIUM.sigma_a, 1.05 * MEDIUM.sigma_s, 0.98 * MEDIUM.g))
    fit = fitted([shot], (MediumBlock(RANGE),), Scaling(None, 0.0), lambda _: None, start)
    assert len(asked) == 1
    assert np.abs(truth_found(fit, models, image, noise)).max() < 0.3


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(5, 40), min_size=1, max_size=4), st.floats(0.1, 1e4), st.floats(-5.0, 5.0), st.integers(0, 999)
)
def test_gain_and_offsets_are_found_and_projected_out_of_any_images(
    sizes: list[int], gain: float, offset: float, seed: int
) -> None:
    """Every fit stands on this elimination: what a gain and offsets can do must be told exactly, and leave nothing."""
    random = np.random.default_rng(seed)
    weights = [random.uniform(0.5, 2.0, size) for size in sizes]
    models = [random.uniform(0.1, 1.0, size) * weight for size, weight in zip(sizes, weights, strict=True)]
    offsets = [offset + k for k in range(len(sizes))]
    observed = [gain * model + by * one for model, by, one in zip(models, offsets, weights, strict=True)]
    free = Scaling(None, None)
    found, each = free.solve(models, weights, observed)
    assert found == pytest.approx(gain, rel=1e-7)
    assert each == pytest.approx(offsets, rel=1e-6, abs=1e-6 * gain)
    stacked = np.concatenate(observed)[None]
    assert np.abs(free.project_out(stacked, models, weights)).max() < 1e-9 * np.abs(stacked).max()
    pulled = Scaling(gain, offset, 1e-9 * gain, 1e-9)
    assert pulled.solve(models, weights, observed)[0] == pytest.approx(gain, rel=1e-6)
    assert Scaling(2.0, 0.5).project_out(stacked, models, weights) is stacked


NUMBER = st.floats(1e-6, 1e6)
MEDIA = st.builds(Medium, st.floats(0.0, 1.0), st.floats(1e-6, 1.0), st.floats(-0.9, 0.9))
KNOWN = st.fixed_dictionaries({name: st.booleans() for name in ("sigma_a", "sigma_s", "g")})
NAMES = st.lists(st.text(max_size=5), max_size=3).map(tuple)
DOSES = st.builds(
    DoseFit, NUMBER, MEDIA, st.tuples(NUMBER, NUMBER, NUMBER), KNOWN, NUMBER, NUMBER, st.integers(1, 99), NAMES,
    st.sampled_from(["tank", "prepared"]), NUMBER, NUMBER, st.none() | NUMBER,
    st.none() | st.builds(SingleScattering, NUMBER, NUMBER), st.integers(0, 9), st.none() | st.integers(-1, 99),
    st.booleans(),
)  # fmt: skip
SERIES = st.builds(
    SeriesFit, st.tuples(NUMBER, NUMBER), MEDIA, NUMBER.map(lambda sigma_a: Medium(sigma_a, 0.0, 0.0)),
    st.tuples(NUMBER, NUMBER, NUMBER, NUMBER), NUMBER, st.tuples(NUMBER, NUMBER),
    st.none() | st.builds(Linearity, NUMBER, NUMBER), st.text(max_size=9), NUMBER, KNOWN,
    st.tuples(st.tuples(NUMBER, NUMBER), st.tuples(NUMBER, NUMBER)), NAMES,
)  # fmt: skip
FAILED = st.builds(FailedFit, st.none() | NUMBER, st.text(min_size=1, max_size=9), st.none() | st.integers(-1, 99))


@given(DOSES | SERIES | FAILED)
def test_a_fit_comes_back_from_the_journal_as_it_was(fit: DoseFit | SeriesFit | FailedFit) -> None:
    """A key that one direction forgets would be a number that report, window and the resumed run never see."""
    assert from_fields(json.loads(json.dumps(to_fields(fit)))) == fit


def test_lines_of_earlier_versions_and_of_later_ones_are_read() -> None:
    """A run of last year must still be reported; what a newer program adds must not be in the way."""
    old = {
        "fit": "dose",
        "dose_ml": 0.1,
        "frames": 2,
        "sigma_a": 1e-4,
        "sigma_s": 0.01,
        "g": 0.6,
        "sd": [1.0, 2.0, 3.0],
    }
    series = {
        "fit": "series",
        "doses_ml": [0.1],
        "ink": {"sigma_a": 1e-3, "sigma_s": 0.1, "g": 0.6},
        "water_sigma_a": 1e-4,
        "sd": [1.0, 2.0, 3.0, 4.0],
        "linearity": None,
        "rmse": [1.0],
        "news": 1,
    }
    doses, found = fits_in([old, {**old, "frames": 4, "news": 1}, series, {"fit": "series", "error": "too dark"}])
    assert [(one.frames, one.medium) for one in doses] == [(4, Medium(1e-4, 0.01, 0.6))]
    assert found is not None
    assert found.at(2.0) == Medium(1e-4 + 2e-3, 0.2, 0.6)
    assert to_fields(found)["water_sigma_a"] == 1e-4


CODE = """
import json, pickle, sys
from tankrig.light.double import double_scattering
from tankrig.light.moments.propagation import propagation
from tankrig.light.moments.cells import Cells
from tankrig.light.single import single_scattering
from tankrig.threads import THREADS
scene = pickle.loads(bytes.fromhex(sys.argv[1]))
direct = propagation(1, Cells.of(scene.tank, 30.0), 0.05, 0.0).direct
images = single_scattering(scene), double_scattering(scene), direct
print(json.dumps([THREADS, *(float(one.sum()) for one in images)]))
"""


def test_one_setting_says_how_many_threads_work_and_no_image_depends_on_it(monkeypatch, capsys) -> None:
    """Rows that two threads add, or none, would show as stripes only on the machines that were told otherwise."""
    words = ["-c", pickle.dumps(SAME).hex()]
    monkeypatch.setattr(sys, "argv", words)
    exec(CODE, {})
    here = json.loads(capsys.readouterr().out)

    def told(threads: str, code: str) -> Any:
        environment = os.environ | {"TANKRIG_THREADS": threads, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, "-c", code, *words[1:]]
        return json.loads(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)

    assert told("", "from tankrig.threads import THREADS; print(THREADS)") == 2
    for threads in (1, 3):
        found = told(str(threads), CODE)
        assert found[0] == threads
        assert found[1:] == pytest.approx(here[1:], rel=1e-9)
