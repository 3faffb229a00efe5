"""Order 1 has no noise: what a pixel shows is the mean over its area, wherever light and sight begin and end in it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tankrig.light.single import single_scattering
from tankrig.scene import Beam, Medium, Scene
from tests.bent_scenes import bench, sheet, small
from tests.stress_scenes import scene_of, with_beams, with_camera

Array = NDArray[np.float64]

FINER = 9
"""Odd, so that the edges of finer pixels lie elsewhere than nodes of the coarse ones."""


def slanted(y_mm: float, width_mm: float, light_y_mm: float, camera: tuple[float, float], surface: str) -> Scene:
    """One flat beam of a pinhole's light, which may run into either side wall."""
    scene = with_beams(scene_of(Medium(0.001, 0.02, 0.4), "pinhole", surface=surface),
                       Beam((y_mm, y_mm + width_mm), (17.2, 18.9)))  # fmt: skip
    light = replace(scene.projector, position_mm=(-60.0, light_y_mm, 16.0))
    seen_from = replace(scene.camera, position_mm=(36.0, camera[0], 36.0 + camera[1]))
    entry = "glass" if surface == "fresnel" else "matched"
    return replace(scene, projector=light, camera=seen_from, tank=replace(scene.tank, entry=entry))


def both(scene: Scene, rows: int, columns: int, pixel_mm: float) -> tuple[Array, Array]:
    """Order 1 on such pixels, and the mean of it on finer ones."""
    coarse = single_scattering(with_camera(scene, (rows, columns), pixel_mm))
    fine = single_scattering(with_camera(scene, (FINER * rows, FINER * columns), pixel_mm / FINER))
    return coarse, fine.reshape(rows, FINER, columns, FINER).mean(axis=(1, 3))


@pytest.mark.parametrize("surface", ["matched", "fresnel"])
def test_light_that_runs_into_a_side_wall_ends_there(surface: str) -> None:
    """Lines of sight through one row of pixels met the wall above, in and below the beam: it was 15 % too bright."""
    coarse, mean = both(slanted(9.0, 8.0, -10.0, (2.0, 200.0), surface), 24, 36, 2.0)
    beside = mean.max(axis=1).nonzero()[0][-1]  # the last row that is lit
    assert beside >= 21  # of 24
    for row in (beside - 1, beside):
        assert np.abs(coarse[row] - mean[row]).max() < 0.02 * mean[row].max()


@settings(max_examples=12, deadline=None)
@given(
    st.floats(-20.0, 15.0), st.floats(2.0, 8.0), st.floats(-15.0, 15.0), st.floats(-10.0, 10.0), st.floats(60.0, 300.0),
    st.sampled_from(["matched", "fresnel"]),
)  # fmt: skip
def test_a_pixel_shows_the_mean_of_finer_ones(
    y_mm: float, width_mm: float, light_y_mm: float, camera_y_mm: float, above_mm: float, surface: str
) -> None:
    """Whatever wall light runs into: images of forty such scenes were up to 3 % off, and one beyond 0.4 % is left."""
    coarse, mean = both(slanted(y_mm, width_mm, light_y_mm, (camera_y_mm, above_mm), surface), 12, 18, 4.0)
    assert np.linalg.norm(coarse - mean) < 0.0125 * np.linalg.norm(mean)


def finer(scene: Scene, many: int) -> Scene:
    """The scene with so many parts, down and across, of each of a calibrated camera's pixels."""
    (fx, _, cx), (_, fy, cy), last = scene.camera.matrix
    matrix = (
        (fx * many, 0.0, (cx + 0.5) * many - 0.5),
        (0.0, fy * many, (cy + 0.5) * many - 0.5),
        last,
    )
    shape = (scene.camera.shape[0] * many, scene.camera.shape[1] * many)
    return replace(scene, camera=replace(scene.camera, shape=shape, matrix=matrix))


@pytest.mark.parametrize("described", [small, bench, sheet])
def test_a_calibrated_pixel_shows_the_mean_of_finer_ones(described: Callable[[Medium], Scene]) -> None:
    """Rows where light ends are found once for all pixels, and slivers of turned pixels by one line of sight.

    A lens bends the edges of pixels, which are taken to be straight: by less in finer ones.
    """
    scene, many = described(Medium(0.001, 0.02, 0.7)), 3
    rows, columns = scene.camera.shape
    parts = single_scattering(finer(scene, many)).reshape(rows, many, columns, many)
    mean, lit = parts.mean(axis=(1, 3)), parts.min(axis=(1, 3)) > 0.0
    coarse = single_scattering(scene)
    assert np.linalg.norm((coarse - mean)[lit]) < 2.5e-3 * np.linalg.norm(mean[lit])
    assert coarse[lit].sum() == pytest.approx(mean[lit].sum(), rel=2e-4)
