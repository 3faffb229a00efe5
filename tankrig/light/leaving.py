"""What the camera's lens makes of the light that leaves the water: blur, halo and veil, on its picture.

A projector's blur that is narrower than the picture's pixels is drawn there, too: it moves light along y, by as much
more the farther rays have spread, and a picture that is blurred along y costs a tenth of one with a dozen beams each.

    seen = (1 − halo − veil) B I + halo H I + veil ⟨I⟩

with B and H Gaussians and ⟨I⟩ the mean over the picture. Light is lost where they spread it out of the picture, and
comes in from what the picture does not show: models look at a wider and, where beams' edges are seen, finer picture.
"""

import math
import warnings
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Camera, Projector, Scene
from tankrig.scene.optics import NO_HALO, SHARP

Array = NDArray[np.float64]

REACH = 4.0
"""Standard deviations to which light is spread."""
PER_SIGMA = 1.3
"""Fine pixels per standard deviation of the blur; half as wide ones change beams' edges by .2 % of their light."""
NARROW = 0.5
"""Of a pixel's side down: a projector's blur that is no wider is drawn on the picture."""
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
        camera, across = scene.camera, _narrow_mm(scene)
        if camera.blur.widest_mm == 0.0 and camera.halo.share == 0.0 and camera.veil == 0.0 and across == 0.0:
            return None
        sigma = math.hypot(camera.blur.widest_mm, across)
        own = max(camera.blur.narrowest_mm, 0.3 * camera.blur.widest_mm)
        shortest = min(camera.sides_mm)
        wanted = [
            1 if finest == 0.0 or side > LONG * shortest else math.ceil(PER_SIGMA * side / finest)
            for side, finest in zip(camera.sides_mm, (math.hypot(own, across), own), strict=True)
        ]
        if camera.kind != "calibrated":  # whose pixels are square
            wanted = [max(wanted)] * 2
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
        if _narrow_mm(self.scene) > 0.0:
            wide = replace(wide, projector=without_narrow_blur(wide.projector, wide.tank.size_mm[2]))
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
        return self._picture(self.means(self._blurred(self._soft(image), self.parts)), self.means(image))

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

    def _soft(self, image: Array) -> Array:
        """A fine picture with the projector's narrow blur, along y: between three widths, even steps of variance."""
        across = _narrow_mm(self.scene)
        if across == 0.0:
            return image
        variance = (across * _grown(self.fine)) ** 2
        levels = np.linspace(float(variance.min()), float(variance.max()), 3)
        if levels[2] < 1.02 * levels[0]:
            levels = levels[:1]
        place = np.clip((variance - levels[0]) / max(levels[-1] - levels[0], 1e-300) * (levels.size - 1), 0.0, 2.0)
        side = self.scene.camera.sides_mm[0] / self.parts[0]
        return np.asarray(
            sum(
                np.maximum(0.0, 1.0 - np.abs(place - k)) * _gaussian(image, [math.sqrt(level) / side, 0.0])
                for k, level in enumerate(levels)
            )
        )

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


def _narrow_mm(scene: Scene) -> float:
    """Standard deviation on the wall of a projector's blur that pictures are blurred by; 0 where beams are."""
    sigma_mm = scene.projector.blur.sigma_mm
    return sigma_mm if sigma_mm <= NARROW * scene.camera.sides_mm[0] else 0.0


def without_narrow_blur(light: Projector, height: float) -> Projector:
    """A projector whose blur pictures have along y: along z its beams are as much higher as keeps their variance."""
    sigma_mm, beams = light.blur.sigma_mm, []
    for beam in light.beams:
        (low, high), middle = beam.z_mm, 0.5 * sum(beam.z_mm)
        tall = math.sqrt((high - low) ** 2 + 12.0 * sigma_mm**2)
        z_mm = max(middle - 0.5 * tall, 0.0), min(middle + 0.5 * tall, height)
        beams.append(replace(beam, z_mm=z_mm, irradiance=beam.irradiance * (high - low) / (z_mm[1] - z_mm[0])))
    return replace(light, beams=tuple(beams), blur=SHARP)


def _grown(scene: Scene) -> Array:
    """(columns,) how many times as far along y, on the plane z = Lz, light is moved as on the wall."""
    from tankrig.scene.footprint import footprints

    light, camera, (length, _, height) = scene.projector, scene.camera, scene.tank.size_mm
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # columns that look beside the tank
        x_mm = np.nanmean(footprints(camera, scene.tank).centres_mm[..., 0], axis=0)
    x_mm = np.clip(np.nan_to_num(x_mm, nan=0.5 * length), 0.0, length)
    grown = np.ones(x_mm.size)
    if light.kind != "collimated" and light.position_mm is not None:
        index, wall_mm, wall_index = scene.tank.entry_bends
        grown += x_mm / index / (-light.position_mm[0] - wall_mm + wall_mm / wall_index)
    if camera.kind != "orthographic" and camera.position_mm is not None:
        power = sum(beam.power for beam in light.beams)
        lit_mm = sum(beam.power * 0.5 * sum(beam.z_mm) for beam in light.beams) / power if power > 0.0 else height
        above = camera.position_mm[2] - height
        grown *= above / (above + (height - lit_mm) / scene.tank.surface_index)
    return grown


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
