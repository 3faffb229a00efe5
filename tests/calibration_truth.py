"""What is true of a simulated bench, by the names that calibrations state their uncertainties under."""

import cv2
import numpy as np

from drivers.simulated.bench_optics import FINER, vignetting
from drivers.simulated.bench_truth import TrueBench, TrueOptics
from tankrig.calibration.edge_blur import PIXEL_VARIANCE
from tankrig.calibration.uncertainty import Named
from tankrig.geometry.pose import rotation_vector
from tankrig.geometry.shading import shading_terms


def true_numbers(bench: TrueBench) -> dict[str, float]:
    """Camera, water, wall and board as the tank's covariance names them; the projector's numbers by its own."""
    return {
        **_optics(bench.camera, "camera."),
        **_optics(bench.projector, ""),
        "level_mm": bench.level_mm,
        "water_index": bench.water_index,
        "wall_mm": bench.pane_mm,
        "wall_index": bench.pane_index,
        "board_scale": bench.board_scale - 1.0,
    }


def off(known: Named, bench: TrueBench, names: tuple[str, ...], prefix: str = "") -> tuple[np.ndarray, np.ndarray]:
    """(n,) found less true, and (n, n) the covariance stated; rotation vectors of like rotations are taken as near."""
    found, true = known.only(names), true_numbers(bench)
    errors = found.values - [true[prefix + name] for name in names]
    for index, name in enumerate(names):
        if name.endswith("rotation_x"):
            turned = slice(index, index + 3)
            vector = found.values[turned] - errors[turned]
            other = vector * (1.0 - 2.0 * np.pi / np.linalg.norm(vector))
            nearer = min((vector, other), key=lambda one: float(np.linalg.norm(found.values[turned] - one)))
            errors[turned] = found.values[turned] - nearer
    return errors, found.covariance


def true_shading(bench: TrueBench, seen_px: np.ndarray) -> np.ndarray:
    """(6,) the coefficients that come nearest to how the projector's light falls off, where boards have shown it.

    Parameters
    ----------
    bench
        Its truth.
    seen_px
        (n, 2) corners of boards in the projector's picture.
    """
    rows, columns = bench.projector.shape
    x, y = (one.ravel() for one in np.meshgrid(np.arange(0.0, columns, 4.0), np.arange(0.0, rows, 4.0)))
    hull = cv2.convexHull(seen_px.astype(np.float32))
    inside = np.array([cv2.pointPolygonTest(hull, point, False) >= 0 for point in zip(x, y, strict=True)])
    terms = shading_terms(np.stack([x, y], axis=-1)[inside], bench.projector.shape)
    design = np.column_stack([terms, np.ones(len(terms))])
    return np.linalg.lstsq(design, np.log(vignetting(bench.projector, x, y)[inside]), rcond=None)[0][:-1]


def true_blurs(bench: TrueBench) -> dict[str, float]:
    """Standard deviations, px, of what "camera" and "projector" spread: of the kernels that the twin really applies.

    The twin's projector has `FINER` points along a pixel, blurred and then read linearly. Pixels are squares, whose
    edges the linear reading spreads by the area of a point. Its camera blurs between pixels, by what it says.
    """
    point_variance = PIXEL_VARIANCE / FINER**2
    lens = FINER * np.sqrt(bench.projector.blur_px**2 - point_variance)
    return {
        "camera": bench.camera.blur_px,
        "projector": float(np.sqrt(_kernel_variance(lens) / FINER**2 + point_variance)),
    }


def _kernel_variance(sigma: float) -> float:
    """Of OpenCV's Gaussian kernel of single precision, which is cut off and sampled at whole pixels."""
    kernel = cv2.getGaussianKernel(round(8.0 * sigma + 1.0) | 1, sigma).ravel()
    return float(np.sum(kernel * (np.arange(kernel.size) - kernel.size // 2) ** 2))


def _optics(optics: TrueOptics, prefix: str) -> dict[str, float]:
    (fx, _, cx), (_, fy, cy), _ = optics.matrix.tolist()
    k1, k2, p1, p2, _ = optics.distortion.tolist()
    lens = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2}
    turned = dict(zip(("rotation_x", "rotation_y", "rotation_z"), rotation_vector(optics.rotation), strict=True))
    place = dict(zip(("x_mm", "y_mm", "z_mm"), optics.centre_mm.tolist(), strict=True))
    return {prefix + name: float(value) for name, value in (lens | turned | place).items()}
