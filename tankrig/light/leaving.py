"""What the camera's lens makes of the light that leaves the water: blur, halo and veil, on its picture.

    seen = (1 − halo − veil) B I + halo H I + veil ⟨I⟩

with B and H Gaussians and ⟨I⟩ the mean over the picture. Light is lost where they spread it out of the picture, and
comes in from what the picture does not show: models look at a wider and, where beams' edges are seen, finer picture.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Camera, Scene
from tankrig.scene.optics import NO_HALO, SHARP

Array = NDArray[np.float64]

REACH = 4.0
"""Standard deviations to which light is spread."""
PER_SIGMA = 1.3
"""Fine pixels per standard deviation of the blur; half as wide ones change beams' edges by .2 % of their light."""
LONG = 1.5
"""Times as long as wide that pixels are not parted along any more: bins are long where light is smooth."""
FINEST = 8
"""Fine pixels along a pixel's side, at most."""
MOST_FINE = 2_000_000
"""Fine pixels of a picture, at most."""


@dataclass(frozen=True)
class CameraLens:
    """A camera's lens, and the pictures that are to be computed for it.

    Parameters
    ----------
    scene
        As described.
    parts
        Fine pixels along a pixel's sides, down and across.
    beyond
        Pixels that the wider picture has before the first row and column, and after the last.
    """

    scene: Scene
    parts: tuple[int, int]
    beyond: tuple[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, scene: Scene) -> "CameraLens | None":
        """The lens of a scene's camera; None where it is ideal.

        Examples
        --------
        >>> from tankrig.scene import Beam, Medium, Projector, Tank
        >>> from tankrig.scene.optics import Blur
        >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
        >>> camera = Camera("orthographic", (80, 120), 2.0, blur=Blur(1.0))
        >>> CameraLens.of(Scene(Tank(), Medium(0.0, 0.01, 0.0), light, camera)).parts
        (3, 3)
        """
        camera = scene.camera
        if camera.blur.widest_mm == 0.0 and camera.halo.share == 0.0 and camera.veil == 0.0:
            return None
        sigma = camera.blur.widest_mm
        finest = max(camera.blur.narrowest_mm, 0.3 * sigma)
        shortest = min(camera.sides_mm)
        wanted = [
            1 if sigma == 0.0 or side > LONG * shortest else math.ceil(PER_SIGMA * side / finest)
            for side in camera.sides_mm
        ]
        reach = max(sigma, camera.halo.sigma_mm if camera.halo.share > 0.0 else 0.0) * REACH
        if camera.kind == "calibrated":  # whose picture is taken to show all that its halo has light from
            beyond = [math.ceil(sigma * REACH / side) for side in camera.sides_mm]
            wider = ((beyond[0], beyond[0]), (beyond[1], beyond[1]))
        else:
            length, width, _ = scene.tank.size_mm
            unseen = [
                max(0, math.ceil(min(reach, size - count * camera.pixel_mm) / camera.pixel_mm - 1e-9))
                for size, count in zip((width, length), camera.shape, strict=True)
            ]
            wider = ((0, unseen[0]), (0, unseen[1]))
        pixels = math.prod(n + sum(more) for n, more in zip(camera.shape, wider, strict=True))
        parted = sum(one > 1 for one in wanted)
        most = min(FINEST, int((MOST_FINE / pixels) ** (1.0 / max(parted, 1))))
        down, across = (int(np.clip(one, 1, max(most, 1))) for one in wanted)
        return cls(scene, (down, across), wider)

    @property
    def wide(self) -> Scene:
        """The scene with an ideal camera that sees as far as light comes from."""
        camera = self.scene.camera
        (above, below), (before, after) = self.beyond
        shape = (camera.shape[0] + above + below, camera.shape[1] + before + after)
        matrix = camera.matrix
        if matrix is not None and camera.kind == "calibrated":
            (fx, _, cx), (_, fy, cy), last = matrix
            matrix = ((fx, 0.0, cx + before), (0.0, fy, cy + above), last)
        ideal = replace(camera, shape=shape, matrix=matrix, blur=SHARP, halo=NO_HALO, veil=0.0)
        return replace(self.scene, camera=ideal)

    @property
    def fine(self) -> Scene:
        """The same with fine pixels."""
        wide = self.wide
        return replace(wide, camera=_finer(wide.camera, self.parts)) if self.parts != (1, 1) else wide

    def means(self, fine: Array) -> Array:
        """(…, rows, columns) wide pictures of fine ones."""
        down, across = self.parts
        if self.parts == (1, 1):
            return fine
        rows, columns = fine.shape[-2] // down, fine.shape[-1] // across
        return np.asarray(fine.reshape(*fine.shape[:-2], rows, down, columns, across).mean(axis=(-3, -1)))

    def of_fine(self, image: Array) -> Array:
        """(rows, columns) of the camera: its picture of an ideal fine one."""
        return self._picture(self.means(self._blurred(image, self.parts)), self.means(image))

    def of_wide(self, image: Array) -> Array:
        """(rows, columns) of the camera: its picture of an ideal wide one."""
        return self._picture(self._blurred(image, (1, 1)), image)

    def variance_of_wide(self, variance: Array) -> Array:
        """What noise of an ideal wide picture is at most: as if that of neighbours were alike."""
        return np.maximum(self.of_wide(variance), 0.0)

    def _picture(self, blurred: Array, sharp: Array) -> Array:
        camera, (above, _), (before, _) = self.scene.camera, *self.beyond
        rows, columns = camera.shape
        inside = slice(above, above + rows), slice(before, before + columns)
        halo, veil = camera.halo.share, camera.veil
        seen: Array = blurred if halo == 0.0 and veil == 0.0 else (1.0 - halo - veil) * blurred
        if halo > 0.0:
            seen = seen + halo * _gaussian(sharp, [camera.halo.sigma_mm / side for side in camera.sides_mm])
        if veil > 0.0:
            seen = seen + veil * float(sharp[inside].mean())
        return np.ascontiguousarray(seen[inside])

    def _blurred(self, image: Array, parts: tuple[int, int]) -> Array:
        blur = self.scene.camera.blur
        sides = [side / many for side, many in zip(self.scene.camera.sides_mm, parts, strict=True)]
        if blur.widest_mm == 0.0:
            return image
        if blur.corner_mm is None:
            return _gaussian(image, [blur.sigma_mm / side for side in sides])
        # Pictures blurred by three widths, even steps of the variance apart, and between them by each pixel's own.
        rows, columns = image.shape
        y, x = np.linspace(-1.0, 1.0, rows)[:, None], np.linspace(-1.0, 1.0, columns)
        sigma = blur.sigma_mm + (blur.corner_mm - blur.sigma_mm) * 0.5 * (x * x + y * y)
        widths = np.linspace(blur.narrowest_mm**2, blur.widest_mm**2, 3)
        place = np.clip((sigma**2 - widths[0]) / max(widths[1] - widths[0], 1e-300), 0.0, 2.0)
        return np.asarray(
            sum(
                np.maximum(0.0, 1.0 - np.abs(place - k))
                * _gaussian(image, [math.sqrt(variance) / side for side in sides])
                for k, variance in enumerate(widths)
            )
        )


def _finer(camera: Camera, parts: tuple[int, int]) -> Camera:
    """The camera whose pixels are parts of this one's."""
    matrix, (down, across) = camera.matrix, parts
    if matrix is not None and camera.kind == "calibrated":
        (fx, _, cx), (_, fy, cy), last = matrix
        matrix = ((fx * across, 0.0, (cx + 0.5) * across - 0.5), (0.0, fy * down, (cy + 0.5) * down - 0.5), last)
    shape = (camera.shape[0] * down, camera.shape[1] * across)
    return replace(camera, shape=shape, pixel_mm=camera.pixel_mm / math.sqrt(down * across), matrix=matrix, bin=0)


def _gaussian(image: Array, widths: list[float]) -> Array:
    """Blurred along rows' and columns' numbers, by standard deviations in pixels; dark beyond the picture."""
    from scipy.ndimage import correlate1d
    from scipy.signal import oaconvolve

    for axis, width in enumerate(widths):
        if width <= 0.0:
            continue
        weights = _weights(round(width, 9))
        if weights.size < 64:
            image = correlate1d(image, weights, axis=axis, mode="constant")
        else:
            shape = [1, 1]
            shape[axis] = weights.size
            image = oaconvolve(image, weights.reshape(shape), mode="same", axes=axis)
    return image


@lru_cache(maxsize=32)
def _weights(width: float) -> Array:
    """Weights at whole numbers with exactly the variance t of a width: e^{−t} Iₙ(t) (Lindeberg 1990)."""
    from scipy.special import ive

    half = math.ceil(REACH * width + 1.0)
    weights = ive(np.abs(np.arange(-half, half + 1)), width * width)
    return np.asarray(weights / weights.sum())
