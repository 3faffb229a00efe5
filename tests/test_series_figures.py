"""A five-dose series whose pictures the independent Monte Carlo made: how right it is, and whether it knows that.

Long; `pytest -m long -s tests/test_series_figures.py` prints the figures.
"""

from dataclasses import replace

import numpy as np
import pytest

from tankrig.estimation.series import SeriesEstimate, estimate_series
from tankrig.estimation.series_forward import prepared_model
from tankrig.image.prepare import prepare
from tankrig.light.prepared.about import box_for
from tankrig.montecarlo import simulate_to
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800), pytest.mark.filterwarnings("ignore::UserWarning")]

INK, WATER = Medium(4.0e-4, 0.012, 0.71), 1e-4
DOSES_ML = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
STRIPES = tuple(Beam((low, low + 8.0), (58.0, 62.0)) for low in np.arange(-60.0, 60.0, 16.0))
SCENE = Scene(Tank(), Medium(0.0, 0.01, 0.0), Projector("collimated", STRIPES), Camera("orthographic", (40, 60), 4.0))
GAIN, NOISE, MONTE_CARLO = 3e4, 0.002, 0.0015
DRAWS = 120
TRUTH = np.array([INK.sigma_a, INK.sigma_s, INK.g])


def liquid(dose_ml: float) -> Medium:
    return Medium(WATER + INK.sigma_a * dose_ml, INK.sigma_s * dose_ml, INK.g)


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return [
        GAIN * simulate_to(replace(SCENE, medium=liquid(dose)), MONTE_CARLO, seed=k).image
        for k, dose in enumerate(DOSES_ML)
    ]


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> list:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.mktemp("cache")))
        return [prepare(SCENE, 0.02, box=box_for(liquid(dose))) for dose in DOSES_ML]


def noisy(pictures: list[np.ndarray], rng: np.random.Generator) -> tuple[list[np.ndarray], list[float]]:
    noise = [NOISE * float(picture.max()) for picture in pictures]
    return [one + rng.normal(0.0, sd, one.shape) for one, sd in zip(pictures, noise, strict=True)], noise


def found_of(found: SeriesEstimate) -> tuple[np.ndarray, np.ndarray]:
    return np.array([found.ink.sigma_a, found.ink.sigma_s, found.ink.g]), np.sqrt(np.diag(found.covariance))[:3]


def test_five_doses_and_an_unknown_gain_give_the_ink(pictures: list[np.ndarray]) -> None:
    """The figures of a user's series, from no start value and with the tank model as it ships."""
    images, noise = noisy(pictures, np.random.default_rng(1))
    found = estimate_series(images, SCENE, DOSES_ML, offset=0.0, noise=noise)
    values, sd = found_of(found)
    share, error = (values - TRUTH) / np.array([*TRUTH[:2], 1.0]), sd / np.array([*TRUTH[:2], 1.0])
    print(f"\ntank model: σa {share[0]:+.2%} (± {error[0]:.2%}), σs {share[1]:+.3%} (± {error[1]:.3%}), ", end="")
    print(f"g {share[2]:+.4f} (± {error[2]:.4f}); {found.linearity}")
    assert values[1] == pytest.approx(INK.sigma_s, rel=0.01)
    assert values[2] == pytest.approx(INK.g, abs=0.01)
    assert values[0] == pytest.approx(INK.sigma_a, rel=0.05)
    assert found.linearity is not None
    assert found.linearity.holds


def test_doses_wrong_by_two_per_cent_that_are_said_to_be_so_are_covered(
    pictures: list[np.ndarray], models: list
) -> None:
    """Intervals that left the pump's errors out would be fiction."""
    rng = np.random.default_rng(2)
    inside, off, exact, lines = [], [], [], []
    for draw in range(DRAWS):
        images, noise = noisy(pictures, rng)
        said = DOSES_ML * (1.0 + 0.02 * rng.normal(size=DOSES_ML.size))
        if (np.diff(said) <= 0.0).any():
            continue
        given = {"offset": 0.0, "noise": noise, "start": INK, "model_of": prepared_model(models)}
        found = estimate_series(images, SCENE, said, 0.02 * said, **given)
        values, sd = found_of(found)
        off.append((values - TRUTH) / sd)
        inside.append(np.abs(off[-1]) <= 1.96)
        assert found.linearity is not None
        lines.append(found.linearity.holds)
        if draw < 40:
            values, _ = found_of(estimate_series(images, SCENE, DOSES_ML, **given))
            exact.append(values / TRUTH - 1.0)
    cover, mean, scatter = np.mean(inside, axis=0), np.mean(off, axis=0), np.std(off, axis=0)
    errors = np.mean(exact, axis=0)
    print(
        f"\n{len(off)} draws, doses wrong by 2 %: linear {np.mean(lines):.1%}; in 95 % intervals, off by, error unsaid"
    )
    for name, *row in zip(("σa", "σs", "g"), cover, mean, scatter, errors, strict=True):
        print("{}: {:.1%}, {:+.2f} ± {:.2f} standard deviations, {:+.2%}".format(name, *row))
    assert cover.min() >= 0.93
    assert np.abs(errors)[1:].max() < 0.01
    assert np.mean(lines) > 0.97


def test_ink_that_clumps_is_noticed(models: list) -> None:
    """A bend of 8 % at the highest dose must not pass for another coefficient."""
    clumped = DOSES_ML * (1.0 - 0.08 * DOSES_ML / DOSES_ML.max())
    pictures = [
        GAIN * simulate_to(replace(SCENE, medium=liquid(dose)), MONTE_CARLO, seed=50 + k).image
        for k, dose in enumerate(clumped)
    ]
    images, noise = noisy(pictures, np.random.default_rng(3))
    model = prepared_model(models)
    found = estimate_series(images, SCENE, DOSES_ML, offset=0.0, noise=noise, start=INK, model_of=model)
    print(f"\nclumping by 8 %: {found.linearity}")
    assert found.linearity is not None
    assert not found.linearity.holds
    assert found.linearity.bend == pytest.approx(-0.08, abs=0.03)
