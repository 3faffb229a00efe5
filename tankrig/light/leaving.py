"""What the camera's lens makes of the light that leaves the water: blur, halo and veil, on its picture.

A projector's blur that is narrower than the picture's pixels is drawn there, too: it moves light along y, by as much
more the farther rays have spread, and a picture that is blurred along y costs a tenth of one with a dozen beams each.

    seen = (1 − halo − veil) B I + halo H I + veil ⟨I⟩

with B and H Gaussians and ⟨I⟩ the mean over the picture. Light is lost where they spread it out of the picture, and
comes in from what the picture does not show: models look at a wider and, where beams' edges are seen, finer picture.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tankrig.geometry.pose import directions_to_world
from tankrig.scene import Camera, Projector, Scene
from tankrig.scene.optics import NO_HALO, SHARP

Array = NDArray[np.float64]
Columns = tuple[int, int]
"""First column, and the one after the last."""

REACH = 4.0
"""Standard deviations to which light is spread."""
PER_SIGMA, PER_SIGMA_ACROSS = 1.3, 0.35
"""Fine pixels per standard deviation of the blur, down and across. Down, half as wide ones change beams' edges by .2 %
of their light; across, where only walls are edges, half as wide ones change all of order 1 by .03 to .09 %."""
UPRIGHT = 0.95
"""Cosine between rows and light, from which on edges of beams are taken to run along rows: blurred across as well, they
are as much wider as if the blur were 5 % wider."""
NARROW = 0.5
"""Of a pixel's side down: a projector's blur that is no wider is drawn on the picture."""
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
        per_sigma = PER_SIGMA, PER_SIGMA_ACROSS if _along_rows(camera) else PER_SIGMA
        wanted = [
            1 if finest == 0.0 else math.ceil(parts * side / finest)
            for side, finest, parts in zip(camera.sides_mm, (math.hypot(own, across), own), per_sigma, strict=True)
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
    def seen_mm(self) -> float:
        """Twice the standard deviation, down a picture, by which pixels and the narrowest blur spread a point."""
        camera = self.scene.camera
        return 2.0 * math.hypot(camera.sides_mm[0] / math.sqrt(12.0), camera.blur.narrowest_mm)

    @property
    def fine(self) -> Scene:
        """The same with fine pixels."""
        return self._fine(self.parts)

    def _fine(self, parts: tuple[int, int], columns: Columns | None = None) -> Scene:
        """The wider picture, or some of its columns, with so many parts of each pixel."""
        wide = self.wide
        if _narrow_mm(self.scene) > 0.0:
            wide = replace(wide, projector=without_narrow_blur(wide.projector, wide.tank.size_mm[2]))
        camera = wide.camera if columns is None else _cropped(wide.camera, columns)
        return replace(wide, camera=_finer(camera, parts) if parts != (1, 1) else camera)

    def order_one(self, once: Callable[[Scene], Array]) -> tuple[Array, Array]:
        """Order 1 in the ideal wide picture, and as the camera sees it.

        Light is smooth along its way but where it enters the tank and where it meets the far wall. Where a calibrated
        camera sees it run along rows, pixels are parted across there only; all are parted down, along which patterns
        have their edges.

        Parameters
        ----------
        once
            The (n, rows, columns) pictures of order 1 of n liquids by an ideal camera in a scene.

        Returns
        -------
        ideal
            (n, rows, columns) of the wide picture.
        seen
            (n, rows, columns) of the camera.
        """
        if not _along_rows(self.scene.camera):
            images = once(self.fine)
            return self.means(images), np.array([self.of_fine(one) for one in images])
        rows = self.scene.camera.shape[0] + sum(self.beyond[0])
        parts_seen = [self._of_stretch(once, *stretch) for stretch in self._stretches]
        sharp, blurred = np.zeros((2, parts_seen[0][0].shape[0], rows, self._columns))
        for ((first, last), _), (ideal, soft) in zip(self._stretches, parts_seen, strict=True):
            sharp[..., first:last], blurred[..., first:last] = ideal, soft
        return sharp, np.array([self._picture(*both) for both in zip(blurred, sharp, strict=True)])

    def _of_stretch(self, once: Callable[[Scene], Array], columns: Columns, across: int) -> tuple[Array, Array]:
        """Order 1 in some columns of the wide picture, ideal and blurred; pixels are parted in so many across."""
        (first, last), margin, parts = columns, self.beyond[1][0], (self.parts[0], across)
        seen = max(first - margin, 0), min(last + margin, self._columns)
        scene, lens = self._fine(parts, seen), replace(self, parts=parts)
        images, here = once(scene), slice(first - seen[0], last - seen[0])
        soft = [lens._blurred(lens._soft(one, scene), parts, seen) for one in images]  # noqa: SLF001 - of this class
        return lens.means(images)[..., here], lens.means(np.array(soft))[..., here]

    @property
    def _stretches(self) -> list[tuple[Columns, int]]:
        """Columns of a calibrated camera's wide picture that see the tank, and the parts across that each has."""
        length, near_mm = self.scene.tank.size_mm[0], REACH * self.scene.camera.blur.widest_mm
        (first, last), (low, high) = _columns_along(self.wide)
        inside = (last >= -near_mm) & (first <= length + near_mm)
        at_wall = (low <= near_mm) | (high >= length - near_mm)
        across = np.where(inside, np.where(at_wall, self.parts[1], 1), 0)
        ends = [0, *(np.flatnonzero(np.diff(across)) + 1).tolist(), across.size]
        return [((first, last), int(across[first])) for first, last in pairwise(ends) if across[first]]

    @property
    def _columns(self) -> int:
        """Of the wide picture."""
        return self.scene.camera.shape[1] + sum(self.beyond[1])

    def means(self, fine: Array) -> Array:
        """(…, rows, columns) wide pictures of fine ones."""
        down, across = self.parts
        if self.parts == (1, 1):
            return fine
        rows, columns = fine.shape[-2] // down, fine.shape[-1] // across
        return np.asarray(fine.reshape(*fine.shape[:-2], rows, down, columns, across).mean(axis=(-3, -1)))

    def of_fine(self, image: Array) -> Array:
        """(rows, columns) of the camera: its picture of an ideal fine one."""
        soft = self._soft(image, self.fine)
        return self._picture(self.means(self._blurred(soft, self.parts)), self.means(image))

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

    def _soft(self, image: Array, scene: Scene) -> Array:
        """A scene's fine picture with the projector's narrow blur, along y: between three widths, even steps of
        variance."""
        across = _narrow_mm(self.scene)
        if across == 0.0:
            return image
        variance = (across * _grown(scene)) ** 2
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

    def _blurred(self, image: Array, parts: tuple[int, int], columns: Columns | None = None) -> Array:
        """A wide picture, or some of its columns, whose pixels have so many parts, with the blur."""
        blur = self.scene.camera.blur
        sides = [side / many for side, many in zip(self.scene.camera.sides_mm, parts, strict=True)]
        if blur.widest_mm == 0.0:
            return image
        if blur.corner_mm is None:
            return _gaussian(image, [blur.sigma_mm / side for side in sides])
        # Pictures blurred by three widths, even steps of the variance apart, and between them by each pixel's own.
        first, last = columns or (0, image.shape[1] // parts[1])
        y, x = np.linspace(-1.0, 1.0, image.shape[0])[:, None], np.linspace(-1.0, 1.0, self._columns * parts[1])
        x = x[first * parts[1] : last * parts[1]]
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
    sigma_mm, camera = scene.projector.blur.sigma_mm, scene.camera
    turned = camera.kind == "calibrated" and not _along_rows(camera)
    return sigma_mm if sigma_mm <= NARROW * camera.sides_mm[0] and not turned else 0.0


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


def _along_rows(camera: Camera) -> bool:
    """Whether a calibrated camera sees the x axis, along which light runs, about along its rows."""
    if camera.kind != "calibrated":
        return False
    across = directions_to_world(camera.pose, (1.0, 0.0, 0.0))
    return bool(abs(across[0]) > UPRIGHT)


def _columns_along(scene: Scene) -> Array:
    """(2, 2, columns) lowest and highest x that a calibrated camera's columns see: on the surface, and in level beams.

    NaN where they look elsewhere.
    """
    from tankrig.scene.footprint import footprints

    height, viewpoint = scene.tank.size_mm[2], scene.camera.position_mm
    assert viewpoint is not None
    corners = footprints(scene.camera, scene.tank).corners_mm
    aside, above = corners - viewpoint[:2], viewpoint[2] - height
    aside2 = np.sum(aside**2, axis=-1)
    leaning = aside[..., 0] / np.sqrt(scene.tank.surface_index**2 * (aside2 + above**2) - aside2)  # Snell's law
    lit = [z_mm for beam in scene.projector.beams for z_mm in beam.z_mm]
    seen = []
    for heights in ((height,), (min(lit, default=height), max(lit, default=height))):
        x_mm = np.concatenate([corners[..., 0] + (height - z_mm) * leaning for z_mm in heights])
        edges = np.fmin.reduce(x_mm), np.fmax.reduce(x_mm)
        seen.append([np.fmin(edges[0][1:], edges[0][:-1]), np.fmax(edges[1][1:], edges[1][:-1])])
    return np.array(seen)


def _cropped(camera: Camera, columns: Columns) -> Camera:
    """A calibrated camera that sees some of the columns."""
    assert camera.matrix is not None
    (fx, _, cx), second, last = camera.matrix
    matrix = ((fx, 0.0, cx - columns[0]), second, last)
    return replace(camera, shape=(camera.shape[0], columns[1] - columns[0]), matrix=matrix)


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

    for axis, width in enumerate(widths):
        if width <= 0.0:
            continue
        weights = _weights(round(width, 9))
        if weights.size < 64:
            image = correlate1d(image, weights, axis=axis, mode="constant")
        else:
            from scipy.signal import oaconvolve  # half a second, for few pictures

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
