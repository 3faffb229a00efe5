"""What physics says of any image, asked of every model: scenes whose images are known from those of others."""

from dataclasses import replace

import numpy as np
import pytest

from tankrig.light.diffuse import diffuse_image
from tankrig.light.lightfield import lightfield_orders
from tankrig.light.single import single_scattering
from tankrig.light.tank import tank_image
from tankrig.montecarlo import simulate
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tests.stress_scenes import BEAMS, SIZE_MM, larger, medium_of, mirrored, relative, scene_of, with_beams, with_camera

MEDIUM = medium_of(1.5, 0.1, 0.5)


def tank(scene: Scene) -> np.ndarray:
    """Few paths, as good as 1 %, always the same ones."""
    return np.sum(list(tank_image(scene, batches=4, max_order=15).orders.values()), axis=0)


def diffuse(scene: Scene) -> np.ndarray:
    return diffuse_image(scene, step_mm=scene.tank.size_mm[2] / 18.0)


def convolution(scene: Scene) -> np.ndarray:
    return np.sum(list(lightfield_orders(scene, tolerance=0.3).values()), axis=0)


MODELS = {"single": single_scattering, "tank": tank, "diffuse": diffuse, "convolution": convolution}
SCENES = [
    (model, kind) for model in MODELS for kind in ("parallel", "pinhole") if (model, kind) != ("convolution", "pinhole")
]


@pytest.mark.parametrize(("model", "kind"), SCENES)
def test_a_larger_tank_of_thinner_water_looks_the_same(model: str, kind: str) -> None:
    """A length in mm inside a model would make it hold for one rig only."""
    scene = scene_of(MEDIUM, kind)
    tolerance = {"single": 1e-9, "diffuse": 1e-6}.get(model, 0.01)
    assert relative(MODELS[model](larger(scene, 3.0)), MODELS[model](scene)) < tolerance


@pytest.mark.parametrize(("model", "kind"), SCENES)
def test_a_mirrored_scene_gives_the_mirrored_image(model: str, kind: str) -> None:
    """Rows counted from the wrong side would pass every symmetric test scene."""
    scene = scene_of(MEDIUM, kind)
    tolerance = {"tank": 0.02 if kind == "parallel" else 0.05, "convolution": 1e-4}.get(model, 1e-8)
    assert relative(MODELS[model](mirrored(scene))[::-1], MODELS[model](scene)) < tolerance


@pytest.mark.parametrize(("model", "kind"), SCENES)
def test_light_adds_up(model: str, kind: str) -> None:
    """A pattern would be more or less than its beams."""
    scene = scene_of(MEDIUM, kind)
    parts = sum(MODELS[model](with_beams(scene, replace(beam, irradiance=2.5 * beam.irradiance))) for beam in BEAMS)
    # The diffuse limit has emission cut off at 0 where its flux is too strong.
    tolerance = {"tank": 0.02 if kind == "parallel" else 0.05, "diffuse": 0.01}.get(model, 1e-4)
    assert relative(2.5 * MODELS[model](scene), parts) < tolerance


@pytest.mark.parametrize(("model", "kind"), SCENES)
def test_four_small_pixels_are_one_large_one(model: str, kind: str) -> None:
    """An image would depend on the camera's resolution, most of all where beams' edges lie between pixels."""
    scene = scene_of(MEDIUM, kind)
    fine = MODELS[model](with_camera(scene, (48, 72), 1.0))
    averaged = fine.reshape(24, 2, 36, 2).mean(axis=(1, 3))
    tolerance = {"single": 3e-4, "diffuse": 0.02, "tank": 0.01 if kind == "parallel" else 0.05}.get(model, 0.01)
    assert relative(averaged, MODELS[model](scene)) < tolerance


@pytest.mark.parametrize("size_mm", [(20.0, 96.0, 36.0), (140.0, 16.0, 24.0), (30.0, 30.0, 90.0)])
def test_flat_long_and_tall_tanks_agree_with_the_monte_carlo(size_mm: tuple[float, float, float]) -> None:
    """Sides would be mixed up, or cells made for one shape of tank."""
    middle = 0.7 * size_mm[2]
    beam = Beam((-5.3, 3.1), (middle - 3.0, middle + 2.2))
    shape = (round(size_mm[1] / 2.0), round(size_mm[0] / 2.0))
    camera = Camera("orthographic", shape, 2.0)
    scene = Scene(Tank(size_mm), Medium(0.004, 0.036, 0.5), Projector("collimated", (beam,)), camera)
    tally = simulate(scene, 40_000, max_order=15)
    assert relative(tank(scene), tally.image) < 2.0 * tally.noise + 0.01


def exchanged(pixel: Beam, beam: Beam) -> tuple[float, float]:
    """Light from a beam into one pixel, and from that pixel's place into the beam's.

    A beam of the second scene is the pixel of the first and the other way round: x and z change places, and so do the
    wall where light enters and the surface where the camera looks.
    """
    length, _, height = SIZE_MM

    def seen(
        size_mm: tuple[float, float, float], lit: Beam, x_mm: tuple[float, float], y_mm: tuple[float, float]
    ) -> float:
        step = 1.0
        camera = Camera("orthographic", (48, round(size_mm[0])), step)
        image = tank(Scene(Tank(size_mm), MEDIUM, Projector("collimated", (lit,)), camera))
        rows, columns = slice(int(y_mm[0] + 24), int(y_mm[1] + 24)), slice(int(x_mm[0]), int(x_mm[1]))
        return float(image[rows, columns].sum())

    there = seen(SIZE_MM, beam, (pixel.z_mm[0], pixel.z_mm[1]), pixel.y_mm)
    from_surface = Beam(pixel.y_mm, (length - pixel.z_mm[1], length - pixel.z_mm[0]))
    back = seen((height, 48.0, length), from_surface, (height - beam.z_mm[1], height - beam.z_mm[0]), beam.y_mm)
    return there, back


@pytest.mark.parametrize(("x_mm", "y_mm"), [((10.0, 14.0), (-2.0, 3.0)), ((30.0, 40.0), (9.0, 15.0))])
def test_light_finds_the_way_back(x_mm: tuple[float, float], y_mm: tuple[float, float]) -> None:
    """Reciprocity: what a pixel sees of a beam is what a beam from there would send to where the first came from."""
    there, back = exchanged(Beam(y_mm, x_mm), Beam((-6.0, -1.0), (20.0, 24.0)))
    assert back == pytest.approx(there, rel=0.02)


def test_a_slab_returns_and_passes_what_is_published() -> None:
    """Optical thickness 2, ϖ = .9, g = .75: R + T = .0973946 + .6609577 of the light leaves, the rest is absorbed."""
    slab = Tank((20.0, 4000.0, 4000.0))
    light = Projector("collimated", (Beam((-1.0, 1.0), (1999.0, 2001.0)),))
    scene = Scene(slab, Medium(0.01, 0.09, 0.75), light, Camera("orthographic", (1, 1), 4000.0))
    tally = simulate(scene, 200_000)
    assert tally.absorbed + tally.escaped == pytest.approx(1.0, abs=0.004)
    assert tally.escaped == pytest.approx(0.0973946 + 0.6609577, abs=0.004)


@pytest.mark.parametrize("name", ["sigma_a", "sigma_s", "g"])
def test_a_taylor_step_leaves_a_remainder_that_falls_faster_than_the_step(name: str) -> None:
    """With fixed paths and parallel light and sight an image has derivatives; a fit would follow noise without them."""

    def at(step: float) -> np.ndarray:
        value = getattr(MEDIUM, name) * (1.0 + step)
        return tank(replace(scene_of(MEDIUM), medium=replace(MEDIUM, **{name: value})))

    centre, small = at(0.0), 0.01
    slope = (at(1e-4) - at(-1e-4)) / 2e-4
    coarse, fine = (np.linalg.norm(at(step) - centre - step * slope) for step in (4.0 * small, small))
    assert fine < 4.0**-1.3 * coarse
    assert fine < 0.1 * np.linalg.norm(small * slope)
