"""Estimates: right coefficients, errors that mean what they say, and no confident wrong number."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tankrig
from tankrig.errors import ImageError
from tankrig.estimation.estimate import Estimate, fit_models
from tankrig.estimation.observation import observe
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.versions import Models
from tankrig.figures.paper import collimated_cases, fitted, observed
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.phase_functions import phase_function

SCENE = Scene(
    Tank(),
    Medium(0.01, 0.01, 0.0),
    Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),)),
    Camera("orthographic", (40, 60), 4.0),
)
THIN, MEDIUM, THICK = Medium(0.0004, 0.004, 0.8), Medium(0.001, 0.02, 0.8), Medium(0.001, 0.1, 0.8)
BACKWARD = Medium(0.002, 0.02, -0.2)
KNOWN, FREE = Scaling(1.0, 0.0), Scaling(None, None)


def tank_like(medium: Medium) -> Prediction:
    """A beam, a glow about it that widens, and a diffuse halo: what a tank does to light, in closed form."""
    x = np.arange(60) * 4.0 + 2.0
    y = (np.arange(40) * 4.0 - 78.0)[:, None]
    transport = medium.sigma_s * (1.0 - medium.g)
    beam = medium.sigma_s * phase_function(np.array(0.0), medium.g) * np.exp(-medium.sigma_t * (x + 60.0))
    width = 4.0 + 8.0 * transport * x
    glow = np.exp(-(medium.sigma_a + 0.5 * transport) * (x + 60.0) - 0.5 * (y / width) ** 2)
    reach = np.sqrt(3.0 * medium.sigma_a * (medium.sigma_a + transport))
    halo = np.exp(-60.0 * reach - np.hypot(x, y) * (reach + 1.0 / (60.0 + 1.0 / transport)))
    image = beam * (np.abs(y) < 3.0) + 10.0 * (medium.g * medium.sigma_s) ** 2 * glow / width + 0.3 * transport * halo
    return Prediction(image, "tank-like")


def noisy(medium: Medium, share: float = 0.002, seed: int = 0) -> tuple[NDArray[np.float64], float]:
    image = tank_like(medium).image
    noise = share * float(image.max())
    return image + np.random.default_rng(seed).normal(0.0, noise, image.shape), noise


def fit(
    image: NDArray[np.float64], scaling: Scaling, noise: float | None = None, model=tank_like, mask=None
) -> Estimate:
    return fit_models(
        observe(image, (40, 60), noise, mask), SCENE, scaling, Models(model, lambda _: (model, model)), lambda _: None
    )


def off_in_sd(estimate: Estimate, truth: Medium) -> NDArray[np.float64]:
    found, true = (np.array([one.sigma_a, one.sigma_s, one.g]) for one in (estimate.medium, truth))
    return (found - true) / np.sqrt(np.diag(estimate.covariance))


@pytest.mark.parametrize("scaling", [KNOWN, FREE], ids=["gain known", "gain free"])
@pytest.mark.parametrize("truth", [THIN, MEDIUM, THICK, BACKWARD], ids=["thin", "medium", "thick", "backward"])
def test_finds_the_coefficients_of_any_density(truth: Medium, scaling: Scaling) -> None:
    """A wrong basin, a search that stops early or a wrong Jacobian would give wrong coefficients somewhere."""
    image, noise = noisy(truth)
    factor, dark = (1.0, 0.0) if scaling is KNOWN else (3.0e4, 7.0)
    found = fit(factor * image + dark, scaling, factor * noise)
    assert np.abs(off_in_sd(found, truth)).max() < 4.0
    assert found.medium.sigma_s == pytest.approx(truth.sigma_s, rel=0.05)
    assert found.medium.g == pytest.approx(truth.g, abs=0.05)
    assert found.gain == pytest.approx(factor, rel=0.1)
    assert found.rmse == pytest.approx(factor * noise, rel=0.05)


@pytest.mark.parametrize("scaling", [KNOWN, FREE], ids=["gain known", "gain free"])
def test_errors_are_the_scatter_of_repeated_measurements(scaling: Scaling) -> None:
    """Intervals that are too narrow promise what a repeated measurement would not keep; too wide ones waste ink."""
    draws = [fit(*_swapped(noisy(MEDIUM, seed=seed), scaling)) for seed in range(40)]
    off = np.array([off_in_sd(one, MEDIUM) for one in draws])
    assert (np.abs(off.std(axis=0) - 1.0) < 0.3).all()
    assert (np.abs(off.mean(axis=0)) < 0.45).all()
    inside = [low <= MEDIUM.sigma_s <= high for low, high in (one.interval(0.95)["sigma_s"] for one in draws)]
    assert np.mean(inside) >= 0.85


def _swapped(
    measured: tuple[NDArray[np.float64], float], scaling: Scaling
) -> tuple[NDArray[np.float64], Scaling, float]:
    return measured[0], scaling, measured[1]


def test_free_gain_costs_knowledge_of_absorption() -> None:
    """A covariance that forgot that gain was fitted too would promise σa as if it were known."""
    image, noise = noisy(THICK)
    known, free = (np.sqrt(fit(image, scaling, noise).covariance[0, 0]) for scaling in (KNOWN, FREE))
    assert free > 2.0 * known


def test_model_error_widens_the_intervals() -> None:
    """With little camera noise the model's own error is what limits an estimate; leaving it out is fiction."""
    image, noise = noisy(MEDIUM, 0.0005)

    def unsure(medium: Medium) -> Prediction:
        return replace(tank_like(medium), skipped=(Skipped("fine print", 0.01),))

    exact, honest = fit(image, KNOWN, noise), fit(image, KNOWN, noise, unsure)
    assert honest.model_error == pytest.approx(0.01)
    assert (np.diag(honest.covariance) > 9.0 * np.diag(exact.covariance)).all()


def test_structure_in_the_residual_is_said_and_counted() -> None:
    """Uneven ink fits no model: an estimate that ignored the pattern it leaves would be confidently wrong."""
    image, noise = noisy(MEDIUM)
    uneven = image * (1.0 + 0.05 * np.sin(np.arange(60) / 5.0))
    clean, dirty = fit(image, KNOWN, noise), fit(uneven, KNOWN, noise)
    assert "structure" in dirty.verdict
    assert "structure" not in clean.verdict
    assert np.sqrt(dirty.covariance[1, 1]) > 3.0 * np.sqrt(clean.covariance[1, 1])
    assert np.abs(off_in_sd(dirty, MEDIUM)).max() < 4.0


def test_noise_is_found_where_it_is_not_given() -> None:
    """Without it nobody could fit a photograph whose noise they don't know and get error bars."""
    image, noise = noisy(MEDIUM)
    assert fit(image, KNOWN).noise == pytest.approx(noise, rel=0.1)


def test_noise_free_images_fit_to_the_last_digits() -> None:
    """A prediction given back to the fit must return its own medium."""
    found = fit(tank_like(MEDIUM).image, KNOWN)
    assert found.medium.sigma_s == pytest.approx(MEDIUM.sigma_s, rel=1e-3)
    assert found.medium.g == pytest.approx(MEDIUM.g, abs=1e-3)


def test_masked_pixels_do_not_count() -> None:
    """A bubble or a dead pixel that was masked must not move the answer, NaN or not."""
    image, noise = noisy(MEDIUM)
    mask = np.zeros(image.shape, bool)
    mask[10:16, 20:30] = True
    broken = np.where(mask, np.nan, image)
    shining = np.where(mask, 50.0 * image.max(), image)
    first, second = (fit(one, KNOWN, noise, mask=mask) for one in (broken, shining))
    assert first.medium == second.medium
    assert np.abs(off_in_sd(first, MEDIUM)).max() < 4.0
    assert np.isnan(first.residual[mask]).all()


def test_saturated_pixels_are_left_out_and_said() -> None:
    """Clipped pixels look like weaker light: fitted as they stand they bias σs."""
    image, noise = noisy(THICK)
    clipped = np.minimum(image, 0.5 * image.max())
    found = fit(clipped, KNOWN, noise)
    assert "saturated" in found.verdict
    assert np.abs(off_in_sd(found, THICK)).max() < 4.0


def test_intervals_stay_in_the_allowed_range() -> None:
    """A lower limit below zero, or g beyond one, is no interval of a coefficient."""
    image, noise = noisy(Medium(1e-5, 0.02, 0.8), 0.2)
    for low, high in fit(image, FREE, noise).interval(0.9999).values():
        assert low < high
    interval = fit(image, FREE, noise).interval(0.9999)
    assert interval["sigma_a"][0] == 0.0
    assert -1.0 <= interval["g"][0] <= interval["g"][1] <= 1.0


@pytest.mark.parametrize("seed", range(4))
def test_images_of_nothing_never_give_a_confident_number(seed: int) -> None:
    """Noise, one hot pixel, a gradient the wrong way: an error in words or a verdict of not determined, never NaN."""
    random = np.random.default_rng(seed)
    hot = np.zeros((40, 60))
    hot[20, 30] = 1.0
    image = [
        random.random((40, 60)),
        hot,
        np.tile(np.linspace(0.0, 1.0, 60), (40, 1)),
        random.normal(5.0, 1.0, (40, 60)),
    ]
    try:
        found = fit(image[seed], FREE)
    except ImageError:
        return
    assert np.isfinite(found.covariance).all()
    assert not all(found.identifiable.values()) or "don't trust" in found.verdict or "structure" in found.verdict


GOOD = np.ones((40, 60)) + np.eye(40, 60)


@pytest.mark.parametrize(
    ("image", "options", "words"),
    [
        (np.ones((60, 40)), {}, "shape"),
        (np.zeros((40, 60)), {}, "dark"),
        (-GOOD, {}, "dark"),
        (np.ones((40, 60)), {}, "every pixel"),
        (np.where(GOOD > 1.0, np.nan, GOOD), {}, "NaN"),
        (np.where(GOOD > 1.0, np.inf, GOOD), {}, "infinite"),
        (GOOD - 1.5, {}, "below zero"),
        (GOOD * 1j, {}, "real numbers"),
        (np.array([["a"]]), {}, "real numbers"),
        (GOOD, {"noise": -1.0}, "positive"),
        (GOOD, {"noise": np.ones((3, 3))}, "noise has shape"),
        (GOOD, {"noise": np.nan}, "positive"),
        (GOOD, {"mask": np.ones((3, 3), bool)}, "mask"),
        (GOOD, {"mask": np.ones((40, 60), bool)}, "masked"),
        (GOOD, {"gain": "fre"}, "gain"),
        (GOOD, {"gain": 0.0}, "gain"),
        (GOOD, {"offset": np.inf}, "offset"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(image: NDArray[np.float64], options: dict, words: str) -> None:
    """Anything else would be a traceback, or a number fitted to nonsense."""
    with pytest.raises(ImageError, match=words) as caught:
        tankrig.estimate(image, SCENE, **options)
    assert "\n" not in str(caught.value)


def test_search_is_economical() -> None:
    """A forward model costs up to a second: a fit of hundreds of evaluations would take minutes."""
    asked = []

    def counted(medium: Medium) -> Prediction:
        asked.append(medium)
        return tank_like(medium)

    image, noise = noisy(MEDIUM)
    fit(image, FREE, noise, counted)
    assert len(asked) < 160


REFERENCE = Path(__file__).parent / "data" / "reference"


def check_reference(name: str, sigma_s: float, g: float) -> Estimate:
    """Fit a reference image with 0.2 % of its peak of noise, gain known, and compare with the medium it was made of."""
    one = observed(REFERENCE / f"{name}.npz")
    found, truth = fitted(one), one.scene.medium
    assert found.medium.sigma_s == pytest.approx(truth.sigma_s, rel=sigma_s)
    assert found.medium.g == pytest.approx(truth.g, abs=g)
    return found


def test_a_tank_of_an_independent_program_gives_its_coefficients() -> None:
    """The whole chain on an image that tankrig did not make: three beams, thin, known to 0.3 %."""
    found = check_reference("pub08", 0.01, 0.01)
    assert found.medium.sigma_a == pytest.approx(0.004, rel=0.01)
    assert all(found.identifiable.values())


@pytest.mark.long
@pytest.mark.parametrize("name", [case.stem for case in collimated_cases(REFERENCE)])
def test_every_collimated_reference_image_gives_its_coefficients(name: str) -> None:
    """What the project promises: σs within 3 %, g within 0.03, on every case with a matched surface."""
    check_reference(name, 0.03, 0.03)


def test_the_scene_s_medium_does_not_matter() -> None:
    """An answer that depends on the guess is not an answer."""
    one = observed(REFERENCE / "pub02.npz")
    first, second = (
        tankrig.estimate(one.image, replace(one.scene, medium=medium), noise=one.noise, model="single")
        for medium in (THIN, Medium(0.0, 0.3, -0.5))
    )
    assert first.medium == second.medium
    assert "leaves out" in first.verdict


def spoilt(image: NDArray[np.float64], share: float, seed: int = 5) -> NDArray[np.float64]:
    """With bubbles and dust: so many pixels of any brightness."""
    random = np.random.default_rng(seed)
    changed = image.copy()
    where = random.choice(image.size, round(share * image.size), replace=False)
    changed.flat[where] = random.uniform(0.0, 1.5 * image.max(), where.size)
    return changed


@pytest.mark.parametrize("truth", [THIN, MEDIUM, THICK], ids=["thin", "medium", "thick"])
def test_bubbles_and_dust_do_not_move_the_answer(truth: Medium) -> None:
    """Two pixels in a hundred that show something else would otherwise pull σs off by many standard deviations."""
    image, noise = noisy(truth)
    clean, dusty = fit(image, FREE, noise), fit(spoilt(image, 0.02), FREE, noise)
    assert np.abs(off_in_sd(dusty, truth)).max() < 4.0
    assert dusty.medium.sigma_s == pytest.approx(clean.medium.sigma_s, rel=0.01)
    assert "unlike their neighbours" in dusty.verdict


def test_a_clean_image_keeps_all_its_pixels() -> None:
    """A robust fit that throws good pixels away would be biased and promise too little."""
    for seed in range(3):
        image, noise = noisy(MEDIUM, seed=seed)
        assert not np.isnan(fit(image, KNOWN, noise).residual).any()


def test_noise_that_grows_with_brightness_is_found_so() -> None:
    """A photograph's shot noise: taken as even, its bright pixels would look like outliers."""
    image = tank_like(MEDIUM).image
    noise = 0.03 * np.sqrt(image * image.max())
    found = fit(image + np.random.default_rng(2).normal(0.0, 1.0, image.shape) * noise, KNOWN)
    assert np.isnan(found.residual).mean() < 0.01
    assert found.noise == pytest.approx(float(np.sqrt(np.mean(noise**2))), rel=0.25)
    assert np.abs(off_in_sd(found, MEDIUM)).max() < 4.0


def test_a_prior_on_the_gain_is_worth_what_it_says() -> None:
    """Between free and known: a calibration to 1 % must help by as much, not be ignored nor be taken for exact."""
    image, noise = noisy(THICK)
    sds = [
        np.sqrt(fit(image, scaling, noise).covariance[0, 0])
        for scaling in (Scaling(1.0, 0.0), Scaling(1.0, 0.0, 1e-6), Scaling(1.0, 0.0, 0.01), Scaling(1.0, 0.0, 1e3))
    ]
    free = np.sqrt(fit(image, Scaling(None, 0.0), noise).covariance[0, 0])
    assert sds[1] == pytest.approx(sds[0], rel=1e-3)
    assert sds[0] < sds[2] < free
    assert sds[3] == pytest.approx(free, rel=1e-2)


def test_intervals_follow_the_likelihood_where_the_image_bends() -> None:
    """Where a normal interval is wrong by its shape, the truth must still be inside as often as promised."""

    def bent(medium: Medium) -> Prediction:
        # Absorption that acts as its square root: twice the coefficient, 1.4 times the effect.
        return tank_like(Medium(0.001 * np.sqrt(medium.sigma_a / 0.001), medium.sigma_s, medium.g))

    image = bent(MEDIUM).image
    noise = 0.5 * float(image.max())
    found = fit(image + np.random.default_rng(4).normal(0.0, noise, image.shape), KNOWN, noise, bent)
    low, high = found.interval()["sigma_a"]
    straight_low, straight_high = found.interval(profile=False)["sigma_a"]
    assert high - found.medium.sigma_a > 1.1 * (straight_high - found.medium.sigma_a)
    assert low >= straight_low


def test_a_prepared_model_fits_in_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The way to fit many images: its box is respected, and another scene's model is refused."""
    from tankrig.light.prepared.box import Box

    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    small = Scene(
        Tank((60.0, 40.0, 40.0)), MEDIUM, Projector("collimated", (Beam((-6.0, 6.0), (16.0, 24.0)),)),
        Camera("orthographic", (10, 15), 4.0),
    )  # fmt: skip
    prepared = tankrig.prepare(small, 0.05, box=Box((0.01, 0.03), (0.8, 0.95), (0.2, 0.6)))
    truth = Medium(0.002, 0.018, 0.4)
    image = tankrig.predict(replace(small, medium=truth)).image
    noise = 0.002 * float(image.max())
    found = tankrig.estimate(
        image + np.random.default_rng(1).normal(0.0, noise, image.shape), small, 1.0, 0.0, noise, model=prepared
    )
    assert found.model == "prepared"
    assert np.abs(off_in_sd(found, truth)).max() < 4.0
    outside = tankrig.predict(replace(small, medium=Medium(0.002, 0.036, 0.4))).image
    rough = 0.1 * float(outside.max())  # with less, it looks for another phase function that would explain it
    assert "don't trust" in tankrig.estimate(outside, small, 1.0, 0.0, rough, model=prepared).verdict
    with pytest.raises(tankrig.SceneError, match="another"):
        tankrig.estimate(image, replace(small, tank=Tank((60.0, 40.0, 41.0))), model=prepared)
    with pytest.raises(tankrig.SceneError, match="max_order"):
        tankrig.estimate(image, small, model=prepared, max_order=3)


def test_a_picture_that_is_mostly_saturated_is_refused() -> None:
    """What is left at its edges fits anything: it must be taken again."""
    image, noise = noisy(THICK)
    with pytest.raises(ImageError, match="saturated"):
        fit(np.minimum(image, np.quantile(image, 0.4)), FREE, noise)


@pytest.mark.parametrize("value", [(1.0, -0.1), (1.0, np.nan), (0.0, 0.1), (1.0, 0.1, 2.0)])
def test_a_calibration_that_is_none_is_refused(value: tuple) -> None:
    """A prior that is nonsense must not be read as a free gain."""
    with pytest.raises(ImageError, match="gain"):
        tankrig.estimate(GOOD, SCENE, gain=value)


@pytest.mark.long
def test_a_free_gain_is_not_drawn_down_by_the_noise_of_light_paths() -> None:
    """In thin liquids little else tells it from σs: noise in the image itself moved σs by 2.5 deviations."""
    beams = tuple(Beam((y - 4.0, y + 4.0), (60.0, 64.0)) for y in (-50.0, 0.0, 50.0))
    light = Projector("pinhole", beams, (-400.0, 0.0, 60.0))
    camera = Camera("pinhole", (40, 60), 4.0, (120.0, 0.0, 620.0))
    scene = Scene(Tank(), Medium(0.0015, 0.0032, -0.2), light, camera)
    truth = np.asarray(tankrig.predict(scene, tolerance=0.0005).image)
    noise = 0.0004 * float(truth.max())
    observed = truth + np.random.default_rng(1).normal(0.0, noise, truth.shape)
    found = tankrig.estimate(observed, scene, "free", "free", noise=noise, phase="hg")
    off = np.subtract(found.medium.coefficients, scene.medium.coefficients)
    assert (np.abs(off) < 1.6 * np.sqrt(np.diag(found.covariance))).all()
