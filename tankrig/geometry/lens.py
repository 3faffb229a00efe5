"""A lens with distortion: from pixels to rays and back, as OpenCV's camera model has it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

STEPS = 50
CLOSE = 1e-13
"""Change of a normalised coordinate, in units of the focal length, at which the inverse has converged."""


@dataclass(frozen=True)
class Lens:
    """Focal lengths, principal point and Brown–Conrady distortion; the centre of the first pixel is (0, 0).

    A point X, Y, Z in front of the lens (Z > 0) has x = X/Z, y = Y/Z, r² = x² + y², and is seen at
    u = fx (x R + 2 p1 x y + p2 (r² + 2 x²)) + cx, v = fy (y R + p1 (r² + 2 y²) + 2 p2 x y) + cy with
    R = 1 + k1 r² + k2 r⁴ + k3 r⁶ (OpenCV, `projectPoints`).

    Parameters
    ----------
    fx, fy
        Focal lengths in pixels.
    cx, cy
        Principal point in pixels, u along columns and v along rows.
    k1, k2, p1, p2, k3
        Distortion, in OpenCV's order.

    Examples
    --------
    >>> Lens(800.0, 800.0, 319.5, 239.5, k1=-0.1).distortion.tolist()
    [-0.1, 0.0, 0.0, 0.0, 0.0]
    """

    fx: float
    fy: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    @property
    def matrix(self) -> Array:
        """(3, 3) camera matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distortion(self) -> Array:
        """(5,) k1, k2, p1, p2, k3."""
        return np.array([self.k1, self.k2, self.p1, self.p2, self.k3])

    @classmethod
    def of(cls, matrix: ArrayLike, distortion: ArrayLike = ()) -> "Lens":
        """From OpenCV's matrix and its first five distortion coefficients, or fewer.

        Raises
        ------
        ValueError
            When the matrix has a skew, or there are more coefficients.
        """
        k = np.asarray(matrix, np.float64)
        if k.shape != (3, 3) or k[0, 1] != 0.0 or not np.array_equal(k[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1]):
            raise ValueError(f"matrix = {k.tolist()} is no camera matrix; give [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
        coefficients = np.ravel(np.asarray(distortion, np.float64))
        if coefficients.size > 5:
            raise ValueError(f"distortion has {coefficients.size} coefficients; give k1, k2, p1, p2, k3 at most")
        return cls(*(float(value) for value in (k[0, 0], k[1, 1], k[0, 2], k[1, 2], *coefficients)))


def to_pixels(lens: Lens, points: ArrayLike) -> Array:
    """Pixels at which points are seen.

    Parameters
    ----------
    lens
        Of the device.
    points
        (…, 3) in the device's frame, mm, or directions.

    Returns
    -------
    (…, 2) array
        u and v; NaN for what is not in front of the lens.

    Examples
    --------
    >>> to_pixels(Lens(800.0, 800.0, 319.5, 239.5), [10.0, 0.0, 100.0])
    array([399.5, 239.5])
    """
    x, y, z = np.moveaxis(np.asarray(points, np.float64), -1, 0)
    z = np.where(z > 0.0, z, np.nan)
    u, v = _distorted(lens, x / z, y / z)
    return np.stack([lens.fx * u + lens.cx, lens.fy * v + lens.cy], axis=-1)


def to_rays(lens: Lens, pixels: ArrayLike) -> Array:
    """Unit vectors, in the device's frame, along which pixels look.

    Parameters
    ----------
    lens
        Of the device.
    pixels
        (…, 2) u and v, anywhere within a pixel.

    Returns
    -------
    (…, 3) array
        NaN where the distortion folds over, so that no ray belongs to the pixel.

    Examples
    --------
    >>> lens = Lens(800.0, 800.0, 319.5, 239.5, k1=-0.2, p1=0.001)
    >>> bool(np.allclose(to_pixels(lens, to_rays(lens, [10.0, 20.0])), [10.0, 20.0], atol=1e-9))
    True
    """
    u, v = np.moveaxis(np.asarray(pixels, np.float64), -1, 0)
    aim_x, aim_y = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy
    x, y = aim_x, aim_y
    with np.errstate(all="ignore"):  # what does not converge ends as NaN
        for _ in range(STEPS):  # Newton on both coordinates at once
            at_x, at_y = _distorted(lens, x, y)
            miss_x, miss_y = at_x - aim_x, at_y - aim_y
            xx, xy, yx, yy = _slopes(lens, x, y)
            determinant = xx * yy - xy * yx
            step_x = (yy * miss_x - xy * miss_y) / determinant
            step_y = (xx * miss_y - yx * miss_x) / determinant
            x, y = x - step_x, y - step_y
            if not np.any(np.hypot(step_x, step_y) > CLOSE * (1.0 + np.hypot(x, y))):
                break
        at_x, at_y = _distorted(lens, x, y)
        xx, xy, yx, yy = _slopes(lens, x, y)
        # A lens keeps the sense of rotation; where the polynomial turns it over, the root is not the ray's.
        good = (np.hypot(at_x - aim_x, at_y - aim_y) < 1e-9) & (xx * yy - xy * yx > 0.0) & (xx + yy > 0.0)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) / np.sqrt(1.0 + x * x + y * y)[..., None]
    return np.where(good[..., None], rays, np.nan)


def _distorted(lens: Lens, x: Array, y: Array) -> tuple[Array, Array]:
    squared = x * x + y * y
    radial = 1.0 + squared * (lens.k1 + squared * (lens.k2 + squared * lens.k3))
    return (
        x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (squared + 2.0 * x * x),
        y * radial + lens.p1 * (squared + 2.0 * y * y) + 2.0 * lens.p2 * x * y,
    )


def _slopes(lens: Lens, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
    """∂u/∂x, ∂u/∂y, ∂v/∂x, ∂v/∂y of `_distorted`."""
    squared = x * x + y * y
    radial = 1.0 + squared * (lens.k1 + squared * (lens.k2 + squared * lens.k3))
    change = 2.0 * (lens.k1 + squared * (2.0 * lens.k2 + squared * 3.0 * lens.k3))
    mixed = x * y * change + 2.0 * (lens.p1 * x + lens.p2 * y)
    return (
        radial + x * x * change + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x,
        mixed,
        mixed,
        radial + y * y * change + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x,
    )
