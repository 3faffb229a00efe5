"""One picture from a file, made ready for a fit as a run's photographs are: radiometry, edges, bins."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import LEAST_MARKERS, markers_of_any_board
from tankrig.calibration.radiometry import Radiometry
from tankrig.devices import CameraSettings, Pixels
from tankrig.errors import ImageError
from tankrig.estimation.observation import MOST_SATURATED, saturated_pixels
from tankrig.image.bins import HALF, Bins, Seen, beside, bins_for
from tankrig.scene import Camera, Scene
from tankrig.scene.outline import beside_water, blurred_pixels, edges_of_light, lit_pixels

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FAR_TIMES, END, BY_CHANCE = 2.0, 0.25, 5.0
"""Times as bright at the far end as where light enters, from which on an image may be turned about (walls that reflect
make less of a difference); share of the columns that are an end; and standard deviations that noise does not make."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What is given to `tankrig.estimate`.

    Parameters
    ----------
    image, mask
        (rows, columns), and where it is to be left out.
    scene
        What the image shows, in its pixels.
    bins
        That the camera's pixels were put together to; None where they were not.
    blurred
        Share of the pixels that blur matters to, or that look beside the water.
    saturated
        Share of the pixels that are.
    """

    image: Array
    mask: Mask
    scene: Scene
    bins: Bins | None
    blurred: float
    saturated: float = 0.0


def radiance_of(
    pixels: Pixels, settings: CameraSettings, radiometry: Radiometry | None, dark: Pixels | None
) -> tuple[Array, Mask, Mask]:
    """A raw frame as counts per ms, proportional to radiance where the camera's radiometry is known.

    Parameters
    ----------
    pixels
        (rows, columns) counts.
    settings
        That it was taken with.
    radiometry
        Of the camera; None where it was not calibrated.
    dark
        A frame with the same settings and no light, which is subtracted.

    Returns
    -------
    (rows, columns) of the image, which of its pixels are hot, and which are saturated: beyond what is known to be
    linear, or on a plateau at the highest count

    Raises
    ------
    ImageError
        When frame, dark frame and calibration have different shapes.
    StoreError
        When the camera was calibrated, but not at this gain.
    """
    if dark is not None and dark.shape != pixels.shape:
        raise ImageError(
            f"the dark frame has shape {list(dark.shape)} and the frame {list(pixels.shape)}; take it anew"
        )
    full = saturated_pixels(pixels.astype(float))
    if radiometry is None:
        per_ms = settings.exposure_ms * settings.gain
        light = (pixels - (0.0 if dark is None else dark.astype(float))) / per_ms
        return light, np.zeros(pixels.shape, bool), full
    light = radiometry.light(pixels, settings)
    if dark is not None:
        light = light - radiometry.light(dark, settings)
    return light, radiometry.hot, full | radiometry.saturated(pixels, settings)


def require_no_board(pixels: Pixels, camera: Camera) -> None:
    """Refuse a calibrated camera's frame that shows a calibration's board where ink is to be seen.

    Raises
    ------
    ImageError
        When markers of one are seen.
    """
    if camera.kind != "calibrated":
        return
    seen, dictionary = markers_of_any_board(pixels, int(pixels.max()))
    if seen >= LEAST_MARKERS:
        raise ImageError(
            f"it shows a calibration's board, {seen} markers of {dictionary}, where ink is to be seen; give a frame "
            "that was taken without the board"
        )


def brighter_far(picture: Picture) -> float:
    """How many times as bright an image is at its far end as where light enters; 0 where that is no sign of anything.

    Light fades along x, in whatever liquid. Of a calibrated camera's picture no column is at one x.

    Examples
    --------
    >>> from tankrig.scene import Beam, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-60.0, 60.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> fading = np.exp(-np.linspace(0.0, 3.0, 120)) * np.ones((80, 1))
    >>> brighter_far(picture_of(fading, scene)), round(brighter_far(picture_of(fading[:, ::-1], scene)))
    (0.0, 10)
    """
    camera = picture.scene.camera
    if camera.kind == "calibrated" or picture.image.shape != camera.shape:
        return 0.0
    columns = min(camera.shape[1], round(picture.scene.tank.size_mm[0] / camera.pixel_mm))
    some = max(int(END * columns), 1)
    seen = np.where(picture.mask | ~np.isfinite(picture.image), np.nan, picture.image)[:, :columns]
    if np.isnan(seen[:, :some]).all() or np.isnan(seen[:, -some:]).all():
        return 0.0
    near, far = float(np.nanmean(seen[:, :some])), float(np.nanmean(seen[:, -some:]))
    chance = BY_CHANCE * float(np.nanstd(seen)) / math.sqrt(seen[:, :some].size)  # of a picture of nothing but noise
    return far / near if near > 0.0 and far > FAR_TIMES * near and far - near > chance else 0.0


def picture_of(
    image: Array,
    scene: Scene,
    hot: Mask | None = None,
    full: Mask | None = None,
    edges: float | None = None,
    mask: Mask | None = None,
) -> Picture:
    """An image with its scene, binned where its camera is calibrated or says `bin`, and what is to be left out of it.

    Parameters
    ----------
    image
        (rows, columns) as the scene's camera takes it, or in the bins that the camera says.
    scene
        Of the whole camera; see `tankrig.scene.loading.whole_scene`.
    hot
        Pixels that do not count in the mean of their bin; None for none.
    full
        Saturated pixels, which are left out with the bins that they lie in or adjoin; None for those on a plateau at
        the image's highest value.
    edges
        mm to either side of the edges of light that are left out, 0 for none; None for what the scene's blur says.
    mask
        Pixels or bins that a person leaves out; None for none.

    Raises
    ------
    ImageError
        When the mask has another shape, edges leave nothing of the light, or half of what they leave is saturated.
    """
    if scene.camera.bin and image.shape == scene.camera.binned(scene.camera.bin).shape:
        scene = replace(scene, camera=scene.camera.binned(scene.camera.bin))
    if mask is not None and mask.shape != image.shape:
        raise ImageError(
            f"the mask has shape {list(mask.shape)} but the image has {list(image.shape)}; give one of its shape"
        )
    left_out = np.zeros(image.shape, bool) if mask is None else mask
    counts = ~left_out if hot is None else ~hot & ~left_out
    plateau = full is None
    if full is None:
        full = saturated_pixels(image, counts)
    if image.shape != scene.camera.shape:  # the fit says what is wrong with it
        return Picture(image, ~counts, scene, None, 0.0)
    if edges is None:
        blurred = blurred_pixels(scene)
    elif edges > 0.0:
        blurred = edges_of_light(scene, edges) | beside_water(scene, edges)
    else:
        blurred = np.zeros(image.shape, bool)
    seen = Seen(~blurred, lit_pixels(scene))
    if seen.nothing_left:
        raise ImageError(
            "blur matters to all of the light that is seen: its beams are narrower than it reaches; "
            + (
                "make them wider, focus and calibrate anew, or give --edges in mm"
                if edges is None
                else f"--edges {edges:g} mm leaves nothing; give less"
            )
        )
    light = seen.sharp & seen.lit & counts
    if (full & light).sum() > MOST_SATURATED * light.sum():
        raise ImageError(
            f"{100.0 * float(full[light].mean()):.0f} % of the light that could be fitted is saturated, which leaves "
            "too little; shorten the exposure"
        )
    share, saturated = float(blurred.mean()), float(full.mean())
    if scene.camera.kind != "calibrated" and not scene.camera.bin:
        near = beside(full) & ~full if plateau else beside(full)  # the fit finds a plateau, and what is near its height
        return Picture(image, blurred | ~counts | near, scene, None, share, saturated)
    bins = bins_for(scene.camera, [seen])
    used = (bins.shares(seen.sharp) == 1.0) & (bins.shares(counts) > HALF) & bins.clear_of(full)
    binned = replace(scene, camera=bins.camera(scene.camera))
    return Picture(bins.means(image, counts), ~used, binned, bins, share, saturated)
