"""Every model over every medium, thin to dense: an image is finite, never negative, and unresolved ones say so."""

import warnings

import numpy as np
import pytest

import tankrig
from tankrig.errors import SceneError
from tankrig.light.diffuse import diffuse_image
from tankrig.light.infinite import point_source_fluence
from tankrig.light.lightfield import lightfield_orders
from tankrig.light.single import single_scattering
from tankrig.light.tank import tank_image
from tankrig.montecarlo import simulate
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_functions import phase_function
from tests.stress_scenes import medium_of, relative, scene_of, with_camera

ABSORBED = (0.5, *(10.0**-power for power in range(1, 10)), 0.0)
ASYMMETRIES = (0.0, 1e-8, -1e-8, 0.5, -0.5, 0.9, -0.9, 0.95, -0.95, 0.99, -0.99)
DEPTHS = (1e-4, 1e-2, 1.0, 10.0, 100.0, 1e3)


def tank(scene: Scene) -> np.ndarray:
    """A few thousand paths: what is looked for here doesn't hide in noise."""
    return np.sum(list(tank_image(scene, tolerance=0.1, batches=1, max_order=12).orders.values()), axis=0)


def diffuse(scene: Scene) -> np.ndarray:
    return diffuse_image(scene, step_mm=3.0)


def convolution(scene: Scene) -> np.ndarray:
    return np.sum(list(lightfield_orders(scene, tolerance=0.5).values()), axis=0)


def montecarlo(scene: Scene) -> np.ndarray:
    return simulate(scene, 640, max_order=12).image


MODELS = {"single": single_scattering, "diffuse": diffuse, "tank": tank, "montecarlo": montecarlo}


def require_light(image: np.ndarray, scene: Scene) -> None:
    """Finite, nowhere negative, and somewhere bright."""
    assert np.isfinite(image).all(), scene.medium
    assert image.min() >= 0.0, scene.medium
    assert image.max() > 0.0, scene.medium


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", ["parallel", "pinhole"])
def test_no_medium_gives_a_negative_or_undefined_image(model: str, kind: str) -> None:
    """A fit that strays into a corner of the box of media would stop there, or believe it."""
    for index, depth in enumerate(DEPTHS[: 5 if model == "tank" else 6]):  # the tank at 1000 is in the whole sweep
        for absorbed in (ABSORBED[1 + index], 0.0):
            scene = scene_of(medium_of(depth, absorbed, ASYMMETRIES[2 * index]), kind)
            require_light(MODELS[model](scene), scene)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["parallel", "pinhole"])
@pytest.mark.parametrize("g", ASYMMETRIES)
@pytest.mark.parametrize("model", MODELS)
def test_the_whole_sweep_of_media(model: str, g: float, kind: str) -> None:
    for index, depth in enumerate(DEPTHS):
        for absorbed in ABSORBED[index % 2 :: 3]:
            for surface in ("matched", "fresnel"):
                scene = scene_of(medium_of(depth, absorbed, g), kind, surface=surface)
                require_light(MODELS[model](scene), scene)


@pytest.mark.long
@pytest.mark.parametrize("g", ASYMMETRIES)
def test_the_convolution_over_the_sweep_of_media(g: float) -> None:
    for depth in DEPTHS:
        for absorbed in ABSORBED[:-1:4]:
            scene = scene_of(medium_of(depth, absorbed, g))
            require_light(convolution(scene), scene)


def test_an_infinite_medium_that_absorbs_nothing_is_refused_in_a_sentence() -> None:
    """Its light never ends: any image of it would be one of what lies far outside the tank."""
    with pytest.raises(SceneError, match=r'sigma_a = 0 .* use model = "tank"'):
        tankrig.predict(scene_of(medium_of(1.0, 0.0, 0.5)), model="convolution")


def test_an_isotropic_medium_is_the_limit_of_nearly_isotropic_ones() -> None:
    """Formulas that divide by g would break down next to g = 0, where nobody looks."""
    for model, computed in MODELS.items():
        if model == "montecarlo":
            continue  # its paths are drawn anew
        isotropic = computed(scene_of(medium_of(1.0, 0.1, 0.0)))
        for g in (1e-8, -1e-8):
            assert relative(computed(scene_of(medium_of(1.0, 0.1, g))), isotropic) < 1e-6, model


def test_vanishing_absorption_has_a_limit() -> None:
    """Cancellation as the albedo goes to 1: each step of 1 − albedo towards 0 must change the image less."""
    for model, computed in MODELS.items():
        clear = computed(scene_of(medium_of(1.0, 0.0, 0.5)))
        for absorbed in (1e-3, 1e-5, 1e-7, 1e-9):
            assert relative(computed(scene_of(medium_of(1.0, absorbed, 0.5))), clear) < 10.0 * absorbed, model


@pytest.mark.parametrize("kind", ["parallel", "pinhole"])
def test_thin_water_scatters_once(kind: str) -> None:
    """At an optical depth of 1e-4 every model that counts orders is order 1, to its share of later ones."""
    scene = scene_of(medium_of(1e-4, 0.1, 0.5), kind)
    once = single_scattering(scene)
    for model in ("tank", "montecarlo"):
        assert relative(MODELS[model](scene), once) < 1e-2, model


def dense_and_deep() -> Scene:
    """The beams lie more than four hundred free paths below the surface."""
    return with_camera(scene_of(medium_of(1e3, 0.1, 0.5)), (12, 18), 4.0)


def test_what_no_budget_can_resolve_ends_in_time_and_says_how_far_it_got() -> None:
    """It would run for hours, or pass noise off as an image to 1 %."""
    with pytest.warns(UserWarning, match=r"may be wrong by .* more than the tolerance of 0.01"):
        prediction = tankrig.predict(dense_and_deep(), tolerance=0.01, max_order=60, budget_s=0.5)
    assert prediction.error > 0.01
    assert "budget_s = 0.5" in prediction.missed
    require_light(prediction.image, dense_and_deep())


def test_what_can_be_resolved_warns_of_nothing() -> None:
    """Warnings that always come are not read."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tankrig.predict(scene_of(medium_of(1.0, 0.1, 0.5)), tolerance=0.05)


@pytest.mark.parametrize("g", ASYMMETRIES)
def test_single_precision_costs_single_precision(g: float) -> None:
    """Peaks of the phase function would lose their digits to cancellation in arrays of floats."""
    cosine = np.concatenate([np.linspace(-1.0, 1.0, 101), 1.0 - 10.0 ** -np.arange(2.0, 7.0)]).astype(np.float32)
    double, single = phase_function(cosine.astype(np.float64), g), phase_function(cosine, g)
    assert single == pytest.approx(double, rel=2e-4)
    radius = np.float32([0.5, 5.0, 50.0])
    medium = Medium(0.01, 0.09, g)
    assert point_source_fluence(radius, medium) == pytest.approx(
        point_source_fluence(radius.astype(np.float64), medium), rel=1e-6
    )
