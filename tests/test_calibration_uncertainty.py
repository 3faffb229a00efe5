"""The arithmetic under the calibrations' stated uncertainties, and of blurred edges."""

import os

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from tankrig.calibration.board import Board, BoardView
from tankrig.calibration.edge_blur import OF_SQUARES, Blur, spreads
from tankrig.calibration.uncertainty import corner_pairs, found_covariance, noise_covariance

BOARD = Board()


def view(random: np.random.Generator) -> BoardView:
    ids = np.sort(random.choice(24, 20, replace=False))
    return BoardView(ids, random.uniform(0.0, 300.0, (20, 2)), (360, 480), 0.6, 0.7, 0.0)


@given(st.integers(0, 10**6), st.floats(-0.2, 0.2))
@settings(max_examples=4, deadline=None)
def test_noise_of_neighbours_is_found_behind_what_the_fit_explains(seed: int, correlation: float) -> None:
    """Taken for independent, corners that err against each other make a lens look less certain than it is."""
    random = np.random.default_rng(seed)
    views = [view(random) for _ in range(8)]
    same, near = corner_pairs(views, BOARD)
    true = 0.04 * (same + correlation * near)
    slope = random.normal(size=(len(same), 30))
    keep = np.eye(len(same)) - slope @ np.linalg.pinv(slope)
    left_of = keep @ np.linalg.cholesky(true + 1e-12 * same)
    found = [noise_covariance(left_of @ random.normal(size=len(same)), slope, [(same, near)]) for _ in range(60)]
    assert np.mean([one[0, 0] for one in found]) == pytest.approx(0.04, rel=0.06)
    row, column = np.argwhere(near)[0]
    assert np.mean([one[row, column] for one in found]) == pytest.approx(0.04 * correlation, abs=0.04 * 0.06)


@given(st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_what_is_held_at_a_wrong_value_is_in_the_covariance(seed: int) -> None:
    random = np.random.default_rng(seed)
    slope, held_slope = random.normal(size=(40, 3)), random.normal(size=(40, 2))
    square = random.normal(size=(2, 2))
    held, noise = square @ square.T + 0.1 * np.eye(2), 0.3 * np.eye(40)
    stated, across = found_covariance(slope, noise, held_slope, held)
    off = random.multivariate_normal(np.zeros(2), held, 4000)
    seen = random.normal(size=(4000, 40)) * np.sqrt(0.3)
    # misses J x + Jθ θ + noise, with θ off by `off` and held at 0
    found = np.linalg.lstsq(slope, -(off @ held_slope.T + seen).T, rcond=None)[0].T
    np.testing.assert_allclose(np.cov(found.T), stated, atol=0.15 * np.abs(stated).max())
    np.testing.assert_allclose(found.T @ off / 4000, across, atol=0.15 * max(np.abs(across).max(), 0.3))


@given(st.integers(0, 10**6), st.floats(0.45, 1.6), st.floats(3.0, 8.0))
@settings(max_examples=30, deadline=None)
def test_blur_of_edges_and_stripes_is_found_through_noise(seed: int, width: float, stripe: float) -> None:
    """A marker's rim beside a square's edge must not look like a sharper lens."""
    random = np.random.default_rng(seed)
    away = random.uniform(-2.0 * stripe, 1.8 * stripe, (12, 300))
    middle = random.uniform(-0.2, 0.2, (12, 1))
    light = ndtr((away - middle) / width) - ndtr((away - middle - stripe) / width)
    value = 80.0 + 900.0 * light + random.normal(0.0, 9.0, away.shape)
    found = spreads(away, value, np.ones_like(away), 0.8, np.full(12, 1.05 * stripe))
    assert np.isfinite(found).sum() >= 10
    assert np.nanmedian(found) == pytest.approx(width, rel=0.06)


def test_too_few_edges_tell_no_blur() -> None:
    assert Blur.of([0.3, float("nan"), 0.3]) is None
    found = Blur.of([0.36, 0.36, 0.36, 0.36])
    assert found is not None
    assert found.px == pytest.approx(0.6)
    assert found.sd_px >= OF_SQUARES * 0.6


@pytest.mark.usefixtures("qapp")
def test_the_windows_picture_lies_where_the_camera_sees_it() -> None:
    """A calibrated camera sees more than the tank, turned, and its first row at +y."""
    from tankrig.geometry.pose import Pose
    from tankrig.scene import Camera, Tank
    from tankrig.scene.footprint import footprints
    from ui.window.tank_plot import TankPlot

    pose = Pose.looking([118.0, 4.0, 620.0], [121.0, -2.0, 0.0], [0.05, -1.0, 0.0])
    calibrated = Camera(
        "calibrated", (90, 160), position_mm=tuple(pose.centre_mm.tolist()), rotation=pose.rotation,
        matrix=((260.0, 0.0, 79.5), (0.0, 260.0, 44.5), (0.0, 0.0, 1.0)),
    )  # fmt: skip
    for camera in (calibrated, Camera("orthographic", (80, 120), 2.0)):
        plot = TankPlot()
        plot.show_indices(np.zeros(camera.shape, np.uint8), np.zeros((256, 3), np.uint8))
        plot.place(Tank(), camera)
        centres = footprints(camera, Tank()).centres_mm
        for row, column in ((10, 20), (40, 80), (70, 110)):
            np.testing.assert_allclose(plot.pixel_at(*centres[row, column]), (row + 0.5, column + 0.5), atol=0.02)
            from PySide6.QtCore import QPointF

            at = plot.image.mapToParent(QPointF(column + 0.5, row + 0.5))
            np.testing.assert_allclose((at.x(), at.y()), centres[row, column], atol=0.05)
