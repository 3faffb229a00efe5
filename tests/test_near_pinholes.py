"""Near pinholes: order 1 beside cells of the light, order 2 beside the integral that its tables stand for."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tankrig.geometry.pose import Vector
from tankrig.light.double import double_scattering, table_error
from tankrig.light.double.ray_and_sight import Pair, pair_radiance
from tankrig.light.quadrature import gauss_legendre
from tankrig.light.rays import light_sources
from tankrig.light.single import single_scattering
from tankrig.light.water import water_of
from tankrig.montecarlo import first_order
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

Array = NDArray[np.float64]

BEAMS = (Beam((-50.0, -45.0), (60.0, 85.0)), Beam((20.0, 30.0), (5.0, 15.0)))


def near_bench(light: Vector, **tank: object) -> Scene:
    """A projector beside the wall, and a camera low above the water."""
    return Scene(
        replace(Tank((120.0, 120.0, 90.0), "fresnel", 1.36), **tank),  # type: ignore[arg-type]
        Medium(0.002, 0.008, 0.6),
        Projector("pinhole", BEAMS, light),
        Camera("pinhole", (15, 15), 8.0, (130.0, -70.0, 130.0)),
    )


def summed(scene: Scene, pixels: Array, points: int) -> Array:
    """Order 2 of some (row, column) by so many pairs of a ray of light and a line of sight each."""
    nodes, weights = gauss_legendre(6)
    chance, water, side = np.random.default_rng(7), water_of(scene.medium), scene.camera.pixel_mm
    found = np.zeros(len(pixels))
    for k, (row, column) in enumerate(pixels):
        for geometry, beams in light_sources(scene):
            for beam in beams:
                power = beam.irradiance * (beam.y_mm[1] - beam.y_mm[0]) * (beam.z_mm[1] - beam.z_mm[0])
                for mirrored in (False, True):
                    for i in range(points):
                        x, z0 = (column + chance.random()) * side, np.interp((i + 0.5) / points, (0, 1), beam.z_mm)
                        y = (row + chance.random()) * side - geometry.half_width
                        pair = Pair(x, y, chance.uniform(*beam.y_mm), float(z0), mirrored)
                        light = pair_radiance(geometry, water.sigma_t, water.phase, pair, nodes, weights)
                        found[k] += power / points * light
    return np.asarray(found * scene.medium.sigma_s**2)


@pytest.mark.parametrize("light", [(-25.0, 30.0, 20.0), (-5.0, 3000.0, 25.0)])
def test_order_1_of_light_that_would_rise_past_the_camera(light: Vector) -> None:
    """Its corners would be seen there on the other side, and rows were left dark: 13 and 8 % of the light."""
    scene = near_bench(light)
    image, cells = single_scattering(scene), first_order(scene)
    assert np.linalg.norm(image - cells) < 0.06 * np.linalg.norm(cells)
    assert np.isclose(image.sum(), cells.sum(), rtol=0.015)


@pytest.mark.parametrize(
    "scene",
    [
        near_bench((-25.0, 30.0, 20.0), entry="glass", wall_mm=8.0, wall_index=1.5),
        near_bench((-25.0, 30.0, 20.0)),
        near_bench((-0.001, 0.0, 25.0)),
    ],
)
def test_order_2_of_near_pinholes_is_the_integral(scene: Scene) -> None:
    """Tables had all nodes where lines of sight would have met rays, were those not gone: up to 10⁴¹ too bright.

    Beams whose lower rays have left the tank had as few rays as level ones, and what is seen from beyond where their
    side faces seem to meet was dark.
    """
    pixels = np.array([(3, 8), (8, 8), (12, 12), (9, 3)])
    found = double_scattering(scene, 0.01)[tuple(pixels.T)]
    assert np.allclose(found, summed(scene, pixels, 400), rtol=0.1)


def test_light_that_grazes_the_wall_has_an_image() -> None:
    """From 3 m aside and 5 mm before it: numbers were none, and a prediction ended there."""
    image = double_scattering(near_bench((-5.0, 3000.0, 25.0)), 0.01)
    assert np.isfinite(image).all()
    assert 0.0 < image.sum() < 0.01


def test_the_stated_error_of_tables_grows_with_slant() -> None:
    """Beside an independent program, near pinholes' images err by .2 % of orders 1 and 2, grazing light's by 4."""
    far = near_bench((-400.0, 0.0, 45.0))
    light = replace(far.projector, beams=(Beam((-2.0, 2.0), (40.0, 44.0)),))
    far = replace(far, projector=light, camera=replace(far.camera, position_mm=(60.0, 0.0, 900.0)))
    errors = [
        table_error(one, 0.01) for one in (far, near_bench((-25.0, 30.0, 20.0)), near_bench((-5.0, 3000.0, 25.0)))
    ]
    assert errors[0] <= 0.001
    assert errors[1] >= 0.002
    assert errors[2] >= 0.03
