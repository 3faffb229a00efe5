"""A camera or a projector in the world: which pixel a point belongs to, along which ray a pixel looks or shines."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tankrig.geometry.lens import Lens, to_pixels, to_rays
from tankrig.geometry.pose import Pose, directions_to_device, directions_to_world, to_device
from tankrig.geometry.refraction import Window, enter_water, look_into_water

Array = NDArray[np.float64]


def pixels_of(lens: Lens, pose: Pose, points: ArrayLike, window: Window | None = None) -> Array:
    """Pixels of points of the world.

    Parameters
    ----------
    lens, pose
        Of the device.
    points
        (…, 3) mm: in air, or with a `window` in the water behind it.
    window
        What bends the light.

    Returns
    -------
    (…, 2) array
        u and v; NaN for points behind the lens, and for those in air where there is a window.

    Examples
    --------
    >>> from tankrig.geometry.refraction import water_surface
    >>> lens, pose = Lens(800.0, 800.0, 319.5, 239.5), Pose.at((120.0, 0.0, 620.0), (np.pi, 0.0, 0.0))
    >>> pixels_of(lens, pose, [170.0, 0.0, 20.0]).round(3).tolist()
    [386.167, 239.5]
    >>> pixels_of(lens, pose, [170.0, 0.0, 20.0], water_surface(120.0, 1.33)).round(3).tolist()
    [389.057, 239.5]
    """
    if window is None:
        return to_pixels(lens, to_device(pose, points))
    sight = look_into_water(window, pose.centre_mm, points)
    return to_pixels(lens, directions_to_device(pose, sight.in_air))


def rays_of(lens: Lens, pose: Pose, pixels: ArrayLike, window: Window | None = None) -> tuple[Array, Array]:
    """Rays of pixels in the world.

    Parameters
    ----------
    lens, pose
        Of the device.
    pixels
        (…, 2) u and v.
    window
        What bends the light.

    Returns
    -------
    origins, directions
        (…, 3) a point of each ray, mm, and its unit direction away from the device. With a `window` the ray in the
        water, from where it enters; NaN for pixels that don't look through it.
    """
    directions = directions_to_world(pose, to_rays(lens, pixels))
    origins = np.broadcast_to(pose.centre_mm, directions.shape)
    return enter_water(window, origins, directions) if window is not None else (origins, directions)
