"""The cells over the tank's surface that light paths are recorded on, and from there to the camera's pixels."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.light.rays import mirror_symmetric, shift_invariant
from tankrig.light.surface import many_to_camera, noise_to_camera, to_camera
from tankrig.scene import Scene

Array = NDArray[np.float64]

FINEST_CELL_MM = 1.5
"""Orders ≥ 3 are smooth on this scale; finer pixels are interpolated."""


@dataclass(frozen=True)
class CellGrid:
    """Cells over the tank's surface: the camera's pixels where they are not finer than the image needs."""

    rows: int
    columns: int
    cell_mm: tuple[float, float]
    scene: Scene
    symmetric: bool
    shiftable: bool
    split: int
    """Cells along a pixel's side; 0 where cells have nothing to do with pixels."""

    @classmethod
    def of(cls, scene: Scene) -> "CellGrid":
        """Cells for a scene's camera."""
        length, width, _ = scene.tank.size_mm
        pixel = scene.camera.pixel_mm
        finest = min(FINEST_CELL_MM, length / 100, width / 60)
        calibrated = scene.camera.kind == "calibrated"
        split = 0
        if pixel >= finest and not calibrated:
            # Paths that are shared out between the nearest cells want small ones.
            split = 1 if shift_invariant(scene) else math.ceil(0.75 * pixel / finest - 1e-9)
            rows, columns = split * math.ceil(width / pixel - 1e-9), split * math.ceil(length / pixel - 1e-9)
            cell = (pixel / split, pixel / split)
        else:
            finest = min(max(finest, pixel), finest / 0.75) if calibrated else finest
            rows, columns = math.ceil(width / finest), math.ceil(length / finest)
            cell = (length / columns, width / rows)
        whole = abs(rows * cell[1] - width) < 1e-9 * width
        return cls(rows, columns, cell, scene, whole and mirror_symmetric(scene), shift_invariant(scene), split)

    def folded(self, images: Array) -> Array:
        """(…, rows, columns) images, of a scene that is its own mirror image the mean of both halves."""
        if not self.symmetric:
            return images
        half = (self.rows + 1) // 2
        upper: Array = 0.5 * (images + images[..., ::-1, :])[..., :half, :]
        return upper

    def unfolded(self, images: Array) -> Array:
        """(…, rows, columns) images from folded ones."""
        if not self.symmetric:
            return images
        return np.concatenate([images, images[..., : self.rows // 2, :][..., ::-1, :]], axis=-2)

    def seen(self, images: Array) -> Array:
        """(n, rows, columns) folded images as squares no finer than the camera's pixels: noise is less in larger ones.

        They are the pixels that cells are parts of, or the cells.
        """
        whole = self.unfolded(images)
        if self.split < 2:
            return whole
        split = self.split
        squares: Array = whole.reshape(-1, self.rows // split, split, self.columns // split, split).mean(axis=(2, 4))
        return squares

    @property
    def seen_mm2(self) -> float:
        """Area of one of those squares."""
        return self.cell_mm[0] * self.cell_mm[1] * max(self.split, 1) ** 2

    def variance_to_pixels(self, variance: Array) -> Array:
        """(rows, columns) of the camera, of a variance on the squares that `seen` makes."""
        per_cell = np.repeat(np.repeat(variance, max(self.split, 1), axis=0), max(self.split, 1), axis=1)
        return np.maximum(self.to_pixels(per_cell), 0.0)

    def to_pixels(self, image: Array) -> Array:
        """Cells as the camera's pixels: cut or filled up with zeros, or interpolated."""
        rows, columns = self.scene.camera.shape
        pixel = self.scene.camera.pixel_mm
        if self.scene.camera.kind == "calibrated":
            return to_camera(self.scene, image, self.cell_mm)
        if self.split > 0:
            result = np.zeros((rows, columns))
            part = image.reshape(self.rows // self.split, self.split, -1, self.split).mean(axis=(1, 3))[:rows, :columns]
            result[: part.shape[0], : part.shape[1]] = part
            return result
        from scipy.interpolate import RectBivariateSpline

        length, width, _ = self.scene.tank.size_mm
        at_y = (np.arange(self.rows) + 0.5) * self.cell_mm[1]
        at_x = (np.arange(self.columns) + 0.5) * self.cell_mm[0]
        y, x = (np.arange(rows) + 0.5) * pixel, (np.arange(columns) + 0.5) * pixel
        result = np.asarray(RectBivariateSpline(at_y, at_x, image)(y, x))
        # What a pixel has beyond the tank is dark.
        result *= np.clip((width - y) / pixel + 0.5, 0.0, 1.0)[:, None] * np.clip((length - x) / pixel + 0.5, 0.0, 1.0)
        return result

    def many_to_pixels(self, images: Array) -> Array:
        """(n, rows, columns) of the camera: many images at once."""
        if self.scene.camera.kind == "calibrated":
            return many_to_camera(self.scene, images, self.cell_mm)
        return np.array([self.to_pixels(image) for image in images])

    def noise_to_pixels(self, images: Array) -> Array:
        """(n, rows, columns) of the camera: images of noise, which need not be as sharp."""
        if self.scene.camera.kind == "calibrated":
            return noise_to_camera(self.scene, images, self.cell_mm)
        return np.array([self.to_pixels(image) for image in images])
