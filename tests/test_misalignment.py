"""What is off in the set-up is found along with the medium; what the model lacks is no bubble, and bubbles are."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import tankrig
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

STRIPE = Scene(
    Tank(),
    Medium(0.01, 0.01, 0.0),
    Projector("collimated", (Beam((-6.0, 6.0), (56.0, 64.0)), Beam((30.0, 37.0), (50.0, 60.0)))),
    Camera("orthographic", (40, 60), 4.0),
)
THICK = Medium(0.001, 0.1, 0.8)


def single_of(scene: Scene, medium: Medium, seed: int = 0) -> tuple[NDArray[np.float64], float]:
    image = tankrig.predict(replace(scene, medium=medium), "single").image
    noise = 0.002 * float(image.max())
    return image + np.random.default_rng(seed).normal(0.0, noise, image.shape), noise


@pytest.mark.parametrize(("term", "off"), [("y_mm", 0.7), ("tilt_mrad", 6.0), ("scale", -0.006)])
def test_a_misaligned_set_up_is_found_and_corrected(term: str, off: float) -> None:
    """A beam half a millimetre aside spoils thousands of pixels; its own term must take that, with an honest error."""
    from tankrig.estimation.set_up import USUAL, moved

    truth = Medium(0.004, 0.006, 0.3)
    image, noise = single_of(moved(STRIPE, {term: off}), truth)
    asked = {"gain": 1.0, "offset": 0.0, "noise": noise, "model": "single"}
    found = tankrig.estimate(image, STRIPE, **asked, nuisance={term: USUAL[term]})
    value, sd = found.nuisance[term]
    assert value == pytest.approx(off, abs=max(4.0 * sd, 0.05 * abs(off)))
    assert found.medium.sigma_t == pytest.approx(truth.sigma_t, rel=0.01)
    assert found.rmse == pytest.approx(noise, rel=0.1)
    assert "not as described" in found.verdict
    assert tankrig.estimate(image, STRIPE, **asked).rmse > 1.1 * found.rmse


def test_what_may_be_off_costs_knowledge() -> None:
    """A sheet of light whose edges are not seen shows no size: with pixels known to 2 %, so is σt, and no better."""
    light, camera = Projector("collimated", (Beam((-80.0, 80.0), (56.0, 64.0)),)), Camera("orthographic", (30, 50), 4.0)
    sheet = replace(STRIPE, projector=light, camera=camera)
    truth, wall = Medium(0.004, 0.006, 0.3), np.zeros((30, 50), bool)
    wall[:3] = True
    image, noise = single_of(sheet, truth)
    asked = {"gain": 1.0, "offset": 0.0, "noise": noise, "mask": wall, "model": "single"}
    exact, unsure = (
        np.sqrt(tankrig.estimate(image, sheet, **asked, nuisance={"scale": sd}).covariance[:2, :2].sum())
        for sd in (1e-6, 0.02)
    )
    assert exact < 0.003 * truth.sigma_t
    assert unsure == pytest.approx(0.02 * truth.sigma_t, rel=0.3)


@pytest.mark.parametrize("nuisance", [{"x_mm": 1.0}, {"z_mm": 0.0}, {"z_mm": np.nan}, {"z_mm": "1"}])
def test_a_nuisance_that_is_none_is_refused(nuisance: dict) -> None:
    """A typo would silently leave the set-up as it is."""
    with pytest.raises(tankrig.SceneError, match="nuisance"):
        tankrig.estimate(np.ones(STRIPE.camera.shape), STRIPE, nuisance=nuisance)


def test_a_beam_that_is_missing_is_never_a_confident_number() -> None:
    """A blocked beam, or the wrong scene file, fits nothing: no coefficient may then count as determined."""
    image, noise = single_of(
        replace(STRIPE, projector=replace(STRIPE.projector, beams=STRIPE.projector.beams[:1])), THICK
    )
    found = tankrig.estimate(image, STRIPE, noise=noise, model="single")
    assert not any(found.identifiable.values())
    assert "structure" in found.verdict


@pytest.mark.parametrize("size", [(1, 1), (2, 4), (5, 2)])
def test_bubbles_of_several_pixels_are_left_out_wherever_they_are(size: tuple[int, int]) -> None:
    """A bubble is a patch, and one at a row's end has neighbours on one side only."""
    truth = Medium(0.004, 0.006, 0.3)
    image, noise = single_of(STRIPE, truth)
    rows, columns = size
    bubbles = np.zeros(image.shape, bool)
    for top, left in ((3, 12), (15, 30), (30, 45), (8, 58), (24, 0)):
        bubbles[top : top + rows, left : left + min(columns, 2 if left in (0, 58) else columns)] = True
    found = tankrig.estimate(image + 0.4 * image.max() * bubbles, STRIPE, 1.0, 0.0, noise, model="single")
    assert np.isnan(found.residual[bubbles]).all()
    assert np.isnan(found.residual).sum() <= bubbles.sum() + 5
    assert found.medium.sigma_t == pytest.approx(truth.sigma_t, rel=0.01)


@pytest.mark.parametrize("noise_known", [True, False])
def test_what_a_wrong_model_leaves_is_no_bubble(noise_known: bool) -> None:
    """Cleaned away, a misfit would look like bubbles, and the coefficients of a wrong model like good ones."""
    image, noise = single_of(STRIPE, Medium(0.004, 0.006, 0.3))
    y, x = np.mgrid[:40, :60]
    glow = 0.3 * image.max() * (x + 4.0) / 12.0 * np.exp(-x / 12.0 - ((y - 20.0) / 9.0) ** 2)
    found = tankrig.estimate(image + glow, STRIPE, noise=noise if noise_known else None, model="single")
    assert not np.isnan(found.residual).any()
    assert "holds structure" in found.verdict
    assert 'The "single" model leaves out' in found.verdict
    assert "--phase free" not in found.verdict, "no phase function makes up for light that the model has not"
    assert not any(found.identifiable.values())


def test_pixels_left_out_at_beams_edges_are_told_from_bubbles() -> None:
    """A camera that was bumped shows at the ends and sides of beams; who reads “7 bubbles” would believe the answer."""
    from tankrig.estimation.observation import observe
    from tankrig.estimation.residual import misalignment_left_out, misalignments
    from tankrig.estimation.set_up import moved

    medium = Medium(0.001, 0.004, 0.6)
    fitted, noise = single_of(STRIPE, medium)
    bumped, _ = single_of(moved(STRIPE, {"y_mm": 0.3, "scale": 0.01}), medium, seed=1)
    random = np.random.default_rng(4)
    dusty = fitted.copy()
    dusty.flat[random.choice(dusty.size, 20, replace=False)] += 0.5 * fitted.max()
    for image, misaligned in ((bumped, True), (dusty, False)):
        seen = observe(image, STRIPE.camera.shape, noise)
        specks = seen.specks | (np.abs(image - fitted) > 8.0 * noise)
        assert specks.sum() > 10
        told = misalignment_left_out(
            replace(seen, used=seen.used & ~specks, specks=specks), fitted, 1.0, lambda: misalignments(STRIPE, medium)
        )
        assert told is misaligned


def test_a_belief_weighs_more_where_the_models_error_looks_like_what_may_be_off() -> None:
    """White weights make thousands of pixels tell what a smooth error of the model says; ± 0.5 mm must still count."""
    from tankrig.estimation.uncertainty import Response, Sensitivity, SmoothError, Weights, overconfidence

    random = np.random.default_rng(3)
    rows, columns = np.mgrid[:40, :60]
    medium = np.stack([np.exp(-columns / 20), np.exp(-columns / 30) * rows, rows**2 / 100.0])
    smooth, rough = np.cos(columns / 25.0) * rows / 10.0, random.standard_normal((40, 60))
    everywhere, noise = np.ones((40, 60), bool), np.full((40, 60), 0.1)
    changes = np.stack([*medium, smooth, rough]).reshape(5, -1)

    def told(error: float) -> NDArray[np.float64]:
        weight = np.full(2400, 1.0 / np.hypot(0.1, error))
        responses = (Response(changes * weight, Weights(weight), everywhere),)
        seen = Sensitivity(responses, np.zeros((5, 0)), np.array([1.0, 1.0, 1.0, 1.0, 1.0]), np.ones(5))
        off = np.arange(5) > 2
        return overconfidence(seen, off, [noise], [SmoothError(np.full((40, 60), error), 60.0)])

    assert told(0.0) == pytest.approx([1.0, 1.0])
    by_smooth, by_rough = told(0.2)
    assert by_smooth > 50.0
    assert by_rough < 5.0
