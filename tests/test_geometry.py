"""Lenses, poses and refraction: what is projected comes back, and agrees with OpenCV and with Snell's law."""

import cv2
import numpy as np
import pytest

from tankrig.geometry.lens import Lens, to_pixels, to_rays
from tankrig.geometry.pose import Pose, rotation_matrix, rotation_vector, to_device, to_world
from tankrig.geometry.refraction import Window, enter_water, entry_wall, look_into_water, transmitted, water_surface
from tankrig.geometry.view import pixels_of, rays_of

LENS = Lens(1180.0, 1175.0, 968.0, 531.0, k1=-0.21, k2=0.08, p1=8e-4, p2=-5e-4, k3=-0.012)
POSE = Pose.looking((131.0, -22.0, 640.0), (110.0, 8.0, 60.0), (0.1, -1.0, 0.0))
WINDOWS = [water_surface(118.0, 1.333), entry_wall(1.333, 8.0, 1.52), entry_wall(1.33), water_surface(118.0, 1.0)]


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(1).uniform((0.0, -80.0, 0.0), (240.0, 80.0, 118.0), (300, 3))


def test_points_are_projected_as_opencv_does(points: np.ndarray) -> None:
    expected, _ = cv2.projectPoints(
        points, np.array(POSE.rotation), np.array(POSE.translation_mm), LENS.matrix, LENS.distortion
    )
    assert np.abs(pixels_of(LENS, POSE, points) - expected[:, 0]).max() < 1e-9


def test_every_pixel_of_a_distorted_picture_finds_its_ray() -> None:
    u, v = np.meshgrid(np.linspace(-0.5, 1919.5, 61), np.linspace(-0.5, 1079.5, 41))
    pixels = np.stack([u, v], axis=-1)
    rays = to_rays(LENS, pixels)
    assert np.abs(np.linalg.norm(rays, axis=-1) - 1.0).max() < 1e-14
    assert np.abs(to_pixels(LENS, rays) - pixels).max() < 1e-9


def test_a_pixel_beyond_the_fold_of_the_distortion_has_no_ray() -> None:
    barrel = Lens(500.0, 500.0, 0.0, 0.0, k1=-0.3)  # no ray is seen farther out than 351 pixels
    rays = to_rays(barrel, [[300.0, 0.0], [400.0, 0.0]])
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1]).all()
    assert np.isnan(to_pixels(barrel, [0.0, 0.0, -1.0])).all()  # behind the lens


def test_a_matrix_that_is_none_is_refused() -> None:
    assert Lens.of(LENS.matrix, LENS.distortion) == LENS
    with pytest.raises(ValueError, match="no camera matrix"):
        Lens.of([[800.0, 1.0, 0.0], [0.0, 800.0, 0.0], [0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="8 coefficients"):
        Lens.of(LENS.matrix, np.zeros(8))


def test_poses_turn_as_opencv_does_and_back(points: np.ndarray) -> None:
    for rotation in ((0.3, -1.2, 2.0), (1e-9, 0.0, 0.0), (np.pi, 0.0, 0.0)):
        assert np.abs(rotation_matrix(rotation) - cv2.Rodrigues(np.array(rotation))[0]).max() < 1e-12
        assert (
            np.abs(rotation_matrix(rotation_vector(rotation_matrix(rotation))) - rotation_matrix(rotation)).max()
            < 1e-12
        )
    assert np.abs(to_world(POSE, to_device(POSE, points)) - points).max() < 1e-10
    assert np.abs(POSE.centre_mm - [131.0, -22.0, 640.0]).max() < 1e-10


def viewpoint(window: Window) -> np.ndarray:
    return np.array([-420.0, 30.0, 75.0]) if window.axis == 0 else POSE.centre_mm


@pytest.mark.parametrize("window", WINDOWS)
def test_sight_into_water_obeys_snell_and_meets_its_point(window: Window, points: np.ndarray) -> None:
    sight = look_into_water(window, viewpoint(window), points)
    sines = [np.sqrt(1.0 - way[:, window.axis] ** 2) for way in (sight.in_air, sight.in_water)]
    assert np.abs(sines[0] - window.water_index * sines[1]).max() < 1e-12
    entry, way = enter_water(window, viewpoint(window), sight.in_air)
    assert np.abs(entry - sight.entry_mm).max() < 1e-9
    assert np.abs(way - sight.in_water).max() < 1e-12
    assert np.linalg.norm(np.cross(points - entry, way), axis=1).max() < 1e-9


@pytest.mark.parametrize("window", WINDOWS)
def test_a_point_in_water_is_on_the_ray_of_its_pixel(window: Window, points: np.ndarray) -> None:
    lens, pose = LENS, POSE
    if window.axis == 0:
        lens, pose = (
            Lens(1900.0, 1910.0, 511.0, 760.0, k1=0.03),
            Pose.looking(viewpoint(window), (0, 0, 60), (0, 0, -1)),
        )
    pixels = pixels_of(lens, pose, points, window)
    entry, way = rays_of(lens, pose, pixels, window)
    assert np.linalg.norm(np.cross(points - entry, way), axis=1).max() < 1e-9


def test_what_is_not_in_the_water_is_not_seen_in_it() -> None:
    surface = water_surface(118.0, 1.33)
    sight = look_into_water(surface, POSE.centre_mm, [[10.0, 0.0, 130.0], [10.0, 0.0, 110.0]])
    assert np.isnan(sight.in_air[0]).all()
    assert np.isfinite(sight.in_air[1]).all()
    assert np.isnan(enter_water(surface, POSE.centre_mm, [0.0, 0.6, 0.8])[0]).all()  # looks up
    with pytest.raises(ValueError, match="not in the air"):
        look_into_water(surface, [0.0, 0.0, 100.0], [10.0, 0.0, 110.0])


def test_a_pane_shifts_a_ray_and_takes_its_reflections() -> None:
    _, bare = enter_water(entry_wall(1.33), [-100.0, 0.0, 60.0], [0.8, 0.6, 0.0])
    shifted, paned = enter_water(entry_wall(1.33, 10.0, 1.5), [-100.0, 0.0, 60.0], [0.8, 0.6, 0.0])
    assert np.allclose(bare, paned, atol=1e-14)  # parallel faces don't turn a ray
    assert shifted[1] == pytest.approx(90.0 * 0.75 + 10.0 * 0.4 / np.sqrt(1.0 - 0.16))
    reflected = [((1.5 - 1.0) / 2.5) ** 2, ((1.5 - 1.33) / 2.83) ** 2]
    series = sum((1 - reflected[0]) * (1 - reflected[1]) * (reflected[0] * reflected[1]) ** k for k in range(9))
    assert transmitted(entry_wall(1.33, 10.0, 1.5), [1.0, 0.0, 0.0]) == pytest.approx(series, rel=1e-12)
