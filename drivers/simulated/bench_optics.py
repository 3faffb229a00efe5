"""How light goes on a simulated bench: lenses by OpenCV, water and glass by Snell's law.

Rays are followed with formulae of this module's own, not with those that calibration uses: so they check each other.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.pattern import Pattern

from .bench_truth import TANK_MM, Array, TrueBench, TrueOptics, TrueStray

FINER = 2
"""Points of `thrown` along the side of a projector pixel."""
_STEP_MM = 0.05
DEPTHS_MM: Array = np.linspace(0.0, TANK_MM[0], 17)
BACK_MM: Array = 2.0 * TANK_MM[0] - DEPTHS_MM
"""Depths at which pictures of a wide lens are drawn, between which they are interpolated; and how deep light is there
that the far wall has sent back."""


def camera_rays(bench: TrueBench, pixels: Array, filled: bool) -> tuple[Array, Array]:
    """A point of each pixel's ray and its direction, (…, 3) each in the tank's frame; in the water if `filled`."""
    start = bench.camera.centre_mm
    way = _rays(bench.camera, pixels) @ bench.camera.rotation
    point = np.broadcast_to(start, way.shape)
    if not filled:
        return point, way
    at = np.array([TANK_MM[0] / 2, 0.0, bench.level_mm])
    point = point + (((at - point) @ bench.surface) / (way @ bench.surface))[..., None] * way
    return point, _bent(way, bench.surface, 1.0 / bench.water_index)


def projector_pixels(bench: TrueBench, points: Array, filled: bool) -> tuple[Array, Array]:
    """Projector pixels that light points of the tank, (…, 2), and the direction (…, 3) in which light gets there."""
    start, index = bench.projector.centre_mm, bench.water_index if filled else 1.0
    across = points[..., 1:] - start[1:]
    offset = np.linalg.norm(across, axis=-1)
    depths = (-start[0] - bench.pane_mm, bench.pane_mm, points[..., 0])
    sine = _through_layers(offset, depths, (1.0, bench.pane_index, index))[..., None]
    aside = across / np.maximum(offset, 1e-12)[..., None]
    in_air, inside = (np.concatenate([np.sqrt(1.0 - one**2), one * aside], axis=-1) for one in (sine, sine / index))
    return _pixels(bench.projector, in_air @ bench.projector.rotation.T), inside


def illumination(bench: TrueBench, points: Array, across: Array, filled: bool) -> tuple[Array, Array]:
    """Projector pixels (…, 2) that light a surface, and its irradiance by white (…), 1 on the wall before the lens.

    Each pixel has its own power, less towards the corners; the irradiance is the pixels' density on the surface.

    Parameters
    ----------
    bench, filled
        See `projector_pixels`.
    points
        (…, 3) of the surface.
    across
        (2, 3) unit vectors that span it; their cross product points to where light goes on.
    """
    pixels, way = projector_pixels(bench, points, filled)
    along = [
        projector_pixels(bench, points + _STEP_MM * one, filled)[0]
        - projector_pixels(bench, points - _STEP_MM * one, filled)[0]
        for one in across
    ]
    density = np.abs(along[0][..., 0] * along[1][..., 1] - along[0][..., 1] * along[1][..., 0]) / (2.0 * _STEP_MM) ** 2
    matrix, distance = bench.projector.matrix, bench.projector.centre_mm[0]
    lit = way @ np.cross(across[0], across[1]) > 0.0
    power = vignetting(bench.projector, pixels[..., 0], pixels[..., 1])
    return pixels, lit * power * density * distance**2 / (matrix[0, 0] * matrix[1, 1])


def thrown(bench: TrueBench, pattern: Pattern) -> Array:
    """The light of a pattern's pixels, blurred by the projector's lens, of that of a white one.

    Returns
    -------
    array (FINER · rows, FINER · columns)
        To be read linearly between its points; what that blurs is taken off the lens's blur.
    """
    import cv2

    light = (pattern.pixels / 255.0) ** bench.gamma + bench.leak
    fine = np.repeat(np.repeat(light, FINER, axis=0), FINER, axis=1).astype(np.float32)
    # A pixel is a square, with variance 1/12; FINER points and straight lines between them have 1/12 + 1/12 FINER².
    blur_px = np.sqrt(max(bench.projector.blur_px**2 - 1.0 / (12.0 * FINER**2), 0.01))
    sharp = np.asarray(cv2.GaussianBlur(fine, (0, 0), FINER * blur_px))
    stray = bench.stray
    if stray.projector_halo == 0.0:
        return sharp
    halo_px = stray.projector_halo_mm * bench.projector.matrix[0, 0] / -bench.projector.centre_mm[0]
    wide = _widely(sharp, FINER * halo_px)
    return np.asarray((1.0 - stray.projector_halo) * sharp + stray.projector_halo * wide)


def thrown_in_depth(bench: TrueBench, pattern: Pattern, filled: bool = True, depths_mm: Array = DEPTHS_MM) -> Array:
    """A pattern's light as it is at depths, behind each other: what a wide lens throws is sharp at its focus only.

    Returns
    -------
    array (depths, FINER · rows, FINER · columns)
        See `thrown`; of a lens that is a pinhole one picture for all depths.
    """
    light = thrown(bench, pattern)
    if bench.stray.projector_lens_mm == 0.0:
        return light[None]
    return np.stack([_over_disc(light, FINER * float(radius)) for radius in defocus_px(bench, depths_mm, filled)])


def defocus_px(bench: TrueBench, depths_mm: Array, filled: bool) -> Array:
    """Radius, in projector pixels, of the disc that the projector's lens makes of a pixel at depths behind the wall.

    A ray from the lens's rim is followed to a point of the tank and on to where pictures are sharp: what it brings is
    the light of the pixel that is thrown there. In the empty tank the focus is nearer, by what the water has of it.
    """
    stray, depths = bench.stray, np.asarray(depths_mm, float)
    focus = stray.projector_focus_mm if filled else stray.projector_focus_mm / bench.water_index
    points = np.stack([depths, np.zeros(depths.size), np.full(depths.size, bench.level_mm / 2)], axis=-1)
    _, way = projector_pixels(_from_rim(bench, 0.5 * stray.projector_lens_mm, 0.0), points, filled)
    sharp = points + ((focus - points[:, 0]) / way[:, 0])[:, None] * way
    apart = projector_pixels(bench, sharp, filled)[0] - projector_pixels(bench, points, filled)[0]
    return np.asarray(np.linalg.norm(apart, axis=-1))


def pinholes(bench: TrueBench) -> list[tuple[Array, Array]]:
    """Places of four pinholes that spread light as the projector's lens does, and how far their light moves (y, z) on
    the wall of the filled tank so that all meet at the focus; of a lens that is a pinhole that one."""
    radius, focus = 0.5 * bench.stray.projector_lens_mm, bench.stray.projector_focus_mm
    if radius == 0.0:
        return [(bench.projector.centre_mm, np.zeros(2))]
    sharp, found = np.array([[focus, 0.0, bench.level_mm / 2]]), []
    for y, z in ((-1, -1), (-1, 1), (1, -1), (1, 1)):  # half a radius along each axis, as an even disc's variance is
        moved = _from_rim(bench, 0.5 * y * radius, 0.5 * z * radius)
        ways = [projector_pixels(one, sharp, True)[1][0] for one in (moved, bench)]
        on_wall = [-focus * way[1:] / way[0] for way in ways]
        found.append((moved.projector.centre_mm, on_wall[0] - on_wall[1]))
    return found


def _from_rim(bench: TrueBench, y_mm: float, z_mm: float) -> TrueBench:
    """The bench with a pinhole at a point of the projector's lens."""
    light = bench.projector
    place = light.centre_mm + np.array([0.0, y_mm, z_mm])
    return replace(bench, projector=replace(light, translation_mm=-light.rotation @ place))


def _over_disc(image: Array, radius_px: float) -> Array:
    """Spread evenly over a disc whose rim may go through pixels.

    Shares of whole pixels have the disc's variance, a quarter of its radius², and a pixel's, 1/12: the disc that is
    drawn is as much smaller.
    """
    import cv2

    radius_px = float(np.sqrt(max(radius_px**2 - 1.0 / 3.0, 0.0)))
    reach, parts = int(radius_px + 1.0), 8
    if radius_px < 0.25:
        return image
    fine = (np.arange((2 * reach + 1) * parts) + 0.5) / parts - reach - 0.5
    inside = (np.hypot(fine[:, None], fine) < radius_px).astype(float)
    disc = inside.reshape(2 * reach + 1, parts, 2 * reach + 1, parts).mean(axis=(1, 3))
    spread = cv2.filter2D(image, -1, (disc / disc.sum()).astype(np.float32), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(np.maximum(spread, 0.0))


def through_camera_lens(bench: TrueBench, image: NDArray[np.floating], blur_px: float) -> Array:
    """A picture before the camera's lens as it is behind it: blurred, with halo and veil.

    Parameters
    ----------
    bench
        Whose lens.
    image
        (rows, columns).
    blur_px
        Standard deviation of the blur.
    """
    rows, columns = image.shape
    blurred = blurred_part(bench, image, blur_px, (np.linspace(-1.0, 1.0, rows), np.linspace(-1.0, 1.0, columns)))
    return np.asarray(behind_camera_lens(bench, image, blurred), np.float64)


def behind_camera_lens(
    bench: TrueBench, image: NDArray[np.floating], blurred: NDArray[np.floating]
) -> NDArray[np.floating]:
    """A picture before the camera's lens, and as its blur leaves it, with its halo and veil."""
    above = bench.camera.centre_mm[2] - bench.level_mm
    return astray(bench.stray, image, blurred, float(bench.camera.matrix[0, 0] / above))


def blurred_part(bench: TrueBench, fine: NDArray[np.floating], blur_px: float, window: tuple[Array, Array]) -> Array:
    """A part of a picture, blurred as the camera's lens blurs it there.

    Parameters
    ----------
    bench
        Whose lens: its blur grows to the corners by `TrueStray.camera_blur_corner`.
    fine
        (n, m), its pixels as large as they may be.
    blur_px
        Standard deviation in the middle of the picture, in those pixels.
    window
        Where they are in the picture, (n,) down and (m,) across, from −1 to 1.
    """
    import cv2

    corner = bench.stray.camera_blur_corner
    if corner == 1.0:
        return np.asarray(cv2.GaussianBlur(fine, (0, 0), blur_px))
    down, across = window
    wanted = 1.0 + (corner - 1.0) * 0.5 * (down[:, None] ** 2 + across**2)
    place = np.clip((wanted**2 - 1.0) / (corner**2 - 1.0) * (_WIDTHS - 1), 0.0, _WIDTHS - 1.0)
    found = np.zeros(fine.shape)
    for number in range(_WIDTHS):
        width = float(np.sqrt(1.0 + number / (_WIDTHS - 1) * (corner**2 - 1.0)))
        found += np.maximum(0.0, 1.0 - np.abs(place - number)) * cv2.GaussianBlur(fine, (0, 0), blur_px * width)
    return found


_WIDTHS = 6
"""How many evenly blurred pictures a blur that changes over the picture is interpolated between."""


def astray(
    stray: TrueStray, sharp: NDArray[np.floating], blurred: NDArray[np.floating], px_per_mm: float
) -> NDArray[np.floating]:
    """What a camera's halo and veil make of its picture: (rows, columns) before and behind its lens's blur."""
    if stray.camera_halo == 0.0 and stray.veil == 0.0:
        return blurred
    seen = (1.0 - stray.camera_halo - stray.veil) * blurred + stray.veil * sharp.mean()
    if stray.camera_halo > 0.0:
        seen = seen + stray.camera_halo * _widely(sharp, stray.camera_halo_mm * px_per_mm)
    return np.asarray(seen)


_COARSE_PX = 4.0
"""Standard deviation, in pixels of the picture that is blurred, from which on a halo is drawn on coarser pixels."""


def _widely(image: NDArray[np.floating], sd_px: float) -> Array:
    """Blurred by a wide Gaussian, dark beyond the picture."""
    import cv2

    by = max(1, int(sd_px / _COARSE_PX))
    rows, columns = image.shape
    reach = int(3.5 * sd_px / by) + 1
    padded = np.pad(image, ((0, -rows % by), (0, -columns % by)))
    coarse = padded.reshape(padded.shape[0] // by, by, padded.shape[1] // by, by).mean(axis=(1, 3))
    wide = cv2.GaussianBlur(np.pad(coarse, reach), (0, 0), np.sqrt((sd_px / by) ** 2 - 1.0 / 12.0))
    inner = wide[reach:-reach, reach:-reach]
    fine = cv2.resize(inner, padded.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine[:rows, :columns])


def vignetting(optics: TrueOptics, x: Array, y: Array) -> Array:
    """Light at pixels, of that in the middle of the picture."""
    rows, columns = optics.shape
    squared = (x - (columns - 1) / 2) ** 2 + (y - (rows - 1) / 2) ** 2
    return np.asarray(np.maximum(1.0 - optics.vignetting * squared * 4.0 / (rows**2 + columns**2), 0.0))


def _rays(optics: TrueOptics, pixels: Array) -> Array:
    """Unit vectors in the device's frame."""
    import cv2

    exact = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    flat = pixels.reshape(-1, 1, 2)
    plane = cv2.undistortPoints(flat, optics.matrix, optics.distortion, criteria=exact).reshape(pixels.shape)
    rays = np.concatenate([plane, np.ones((*plane.shape[:-1], 1))], axis=-1)
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _pixels(optics: TrueOptics, ways: Array) -> Array:
    """Pixels of directions in the device's frame."""
    import cv2

    still = np.zeros(3)
    found, _ = cv2.projectPoints(ways.reshape(-1, 1, 3), still, still, optics.matrix, optics.distortion)
    return np.asarray(found, float).reshape(*ways.shape[:-1], 2)


def _bent(way: Array, normal: Array, ratio: float) -> Array:
    """Directions behind a surface, by Snell's law in its vector form; `normal` points to where light comes from."""
    cosine = -(way @ normal)[..., None]
    return np.asarray(ratio * way + (ratio * cosine - np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))) * normal)


def _through_layers(offset: Array, depths: tuple[Array | float, ...], indices: tuple[float, ...]) -> Array:
    """Sine, in air, of the angle at which light crosses flat layers so that it gets `offset` aside: by bisection."""
    low, high = np.zeros_like(offset), np.full_like(offset, 0.999)
    for _ in range(48):
        sine = 0.5 * (low + high)
        reached = sum(
            depth * (sine / index) / np.sqrt(1.0 - (sine / index) ** 2)
            for depth, index in zip(depths, indices, strict=True)
        )
        short = reached < offset
        low, high = np.where(short, sine, low), np.where(short, high, sine)
    return np.asarray(0.5 * (low + high))
