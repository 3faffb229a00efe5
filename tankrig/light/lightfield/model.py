"""The paper's model behind one function: images by order of scattering from the convolution of the light field."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.light.double import double_scattering
from tankrig.light.infinite import require_absorption
from tankrig.light.lightfield.convolution import convolve, resample
from tankrig.light.lightfield.kernel import scattering_kernel
from tankrig.light.lightfield.spectrum import Orders
from tankrig.light.single import single_scattering
from tankrig.scene import Medium, Scene

Image = NDArray[np.float64]

_MOST_CELLS = 320
"""Along the longer side of the tank's plan."""
_HIGHEST_DEGREE = 48
"""Of the light field's harmonics; enough for 1 % to |g| = .95."""


def lightfield_orders(scene: Scene, max_order: int | None = None, tolerance: float = 0.01) -> dict[int | str, Image]:
    """Images by order of scattering in the paper's model (Eq. 8–15 corrected), adding up to the camera's image.

    The emission Q₁ = σs p(ω_in·ω) E of the light on its first scattering is iterated, Qₙ₊₁ = S K Qₙ, in a medium that
    fills all space, while the lit volume and the camera's rays end at the tank's walls; the image of order n is K Qₙ
    along the camera's ray. The paper's one kernel k = g ∗ p does not exist, as K and S do not commute; but light that
    enters in one direction and a camera that looks in one leave a scalar kernel per order, found per wave vector by the
    tridiagonal system and summed over all orders without a series. Orders 1 and 2 never leave the tank between
    scatterings and are computed exactly.

    Parameters
    ----------
    scene
        Collimated projector, orthographic camera, matched surface.
    max_order
        Highest order; None for all.
    tolerance
        Relative L2 error of the image, against this model without discretisation.

    Returns
    -------
    dict
        Images (rows, columns) in W/mm²/sr by class of orders: 1, 2, 3, "4-20", ">20", as far as `max_order` goes.

    Raises
    ------
    SceneError
        For a pinhole projector or camera, a Fresnel surface, or σa = 0.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-20.0, 20.0), (50.0, 70.0)),))
    >>> scene = Scene(Tank(), Medium(0.001, 0.01, 0.0), light, Camera("orthographic", (16, 24), 10.0))
    >>> images = lightfield_orders(scene, max_order=3, tolerance=0.1)
    >>> [round(float(images[n].sum() / images[1].sum()), 1) for n in images]
    [1.0, 0.5, 0.3]
    """
    _require_one_direction(scene)
    images: dict[int | str, Image] = {1: single_scattering(scene)}
    if max_order == 1:
        return images
    images[2] = double_scattering(scene)
    for name, first, last in ((3, 3, 3), ("4-20", 4, 20), (">20", 21, None)):
        if max_order is None or first <= max_order:
            end = last if max_order is None else max_order if last is None else min(last, max_order)
            images[name] = _from_kernel(scene, (first, end), tolerance)
    return images


def _require_one_direction(scene: Scene) -> None:
    found = {
        f'projector.kind = "{scene.projector.kind}"': scene.projector.kind != "collimated",
        f'camera.kind = "{scene.camera.kind}"': scene.camera.kind != "orthographic",
        f'tank.surface = "{scene.tank.surface}"': scene.tank.surface == "fresnel",
    }
    for setting, refused in found.items():
        if refused:
            raise SceneError(
                f"{setting} is more than the light-field convolution can treat, which knows one direction of light, "
                'one of sight and no surface; use model = "tank"'
            )
    if scene.medium.sigma_s > 0.0:
        require_absorption(scene.medium)


def _from_kernel(scene: Scene, orders: Orders, tolerance: float) -> Image:
    if scene.medium.sigma_s == 0.0:
        return np.zeros(scene.camera.shape)
    length, width, _ = scene.tank.size_mm
    step = max(_step(scene, tolerance), max(length, width) / _MOST_CELLS)
    columns, rows = math.ceil(length / step - 1e-9), math.ceil(width / step - 1e-9)
    # A cell's light seen from a cell: two box averages of variance step²/12 each, for which the Gaussian stands.
    blur = math.sqrt(length / columns * width / rows / 6.0)
    degree = _degree(_decay(scene.medium), orders, tolerance)
    detail = min(2 * degree, degree + 8)
    reach = math.hypot(*scene.tank.size_mm)
    kernel = scattering_kernel(scene.medium, orders, blur, reach, degree, detail)
    cells = convolve(scene, kernel, (columns, rows))
    return np.maximum(resample(cells, (width, length), scene.camera.shape, scene.camera.pixel_mm), 0.0)


def left_out(scene: Scene, tolerance: float = 0.01) -> list[tuple[str, float]]:
    """What `lightfield_orders` leaves out, each with a bound on its effect (relative L2 of the image).

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-20.0, 20.0), (50.0, 70.0)),))
    >>> scene = Scene(Tank(), Medium(0.001, 0.01, 0.99), light, Camera("orthographic", (16, 24), 10.0))
    >>> [(what, round(bound, 2)) for what, bound in left_out(scene)]
    [('walls between scatterings, from order 3 on', inf), ('harmonics above degree 48', 0.38)]
    """
    items = [("walls between scatterings, from order 3 on", math.inf)]
    bound = _decay(scene.medium) ** (2 * _HIGHEST_DEGREE)
    if bound > 0.5 * tolerance:
        items.append((f"harmonics above degree {_HIGHEST_DEGREE}", bound))
    return items


def _decay(medium: Medium) -> float:
    """Factor from degree to degree by which the phase function's moments fall: |g| for Henyey–Greenstein."""
    if medium.phase is None:
        return abs(medium.g)
    return float(abs(medium.phase.moments(_HIGHEST_DEGREE)[-1]) ** (1.0 / _HIGHEST_DEGREE))


def _degree(g: float, orders: Orders, tolerance: float) -> int:
    """Degree L of harmonics: their cut was measured to change the image by less than g^{2L}, later orders' by less."""
    if g == 0.0:
        return 0
    needed = math.log(max(2.0 / tolerance, 2.0)) / (-2.0 * math.log(abs(g))) * max(0.5, 3.0 / orders[0])
    return min(_HIGHEST_DEGREE, 2 + math.ceil(needed))


def _step(scene: Scene, tolerance: float) -> float:
    """Side of a cell in mm: the tank's mean side over 80 at 1 %, finer where light attenuates within it."""
    length, width, height = scene.tank.size_mm
    usual: float = np.cbrt(length * width * height) / 80.0 * min(2.0, max(0.5, math.sqrt(tolerance / 0.01)))
    return min(usual, 0.5 / scene.medium.sigma_t)
