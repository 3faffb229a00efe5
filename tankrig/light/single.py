"""Order 1: light scattered exactly once, without noise (the paper's Eq. 7, corrected).

    I₁ = T ∫ ds σs p(cos θ) exp(−σt (d₁ + d₂)) E₀(y₀, z₀) (a/(x + a))²/c

along the line of sight, averaged over the pixel; d₁ is the path from the wall x = 0, d₂ the path to the surface, a the
distance of a pinhole projector from the wall and c the x-component of its ray (the factor is 1 for collimated light),
T = (1 − F)/n² at a Fresnel surface. The paper's equation has no integral along the line of sight.

The integrand is smooth between the lines where a line of sight crosses an edge of a beam, so each pixel is cut along
those lines and every piece is integrated by Gauss–Legendre: the error is that of smooth functions, whatever the edges.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.quadrangles import single_scattering_in_quadrangles
from tankrig.light.rays import Geometry, light_sources, sighting_row
from tankrig.light.sights import KINKED_PARTS, SLANTED_PARTS, Rule, across_sights, kinked
from tankrig.scene import Scene


def single_scattering(scene: Scene) -> NDArray[np.float64]:
    """Image of the light scattered exactly once, W/mm²/sr.

    Parameters
    ----------
    scene
        Any scene.

    Returns
    -------
    (rows, columns) array

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0, 0.01, 0.0), light, Camera("orthographic", (80, 120), 2.0))
    >>> image = single_scattering(scene)
    >>> expected = 0.01 / (4 * np.pi) * 4 * np.exp(-0.01 * (1 + 60))  # first pixel of the beam, to leading order
    >>> bool(abs(image[40, 0] / expected - 1) < 1e-4)
    True
    """
    medium, camera = scene.medium, scene.camera
    image = np.zeros(camera.shape)
    if medium.sigma_s == 0.0:
        return image
    if camera.kind == "calibrated":
        return single_scattering_in_quadrangles(scene)
    rules = [np.polynomial.legendre.leggauss(count) for count in (2, 3, 4)]  # along x, along y, along the line of sight
    for geometry, beams in light_sources(scene):
        for beam in beams:
            _add_beam(
                image, geometry, camera.pixel_mm, medium.sigma_t, medium.sigma_s * beam.irradiance, medium.g,
                (*beam.y_mm, *beam.z_mm), *rules,
            )  # fmt: skip
    return image


@kernel
def _add_beam(
    image: NDArray[np.float64],
    geometry: Geometry,
    pixel_mm: float,
    sigma_t: float,
    strength: float,
    g: float,
    edges: tuple[float, float, float, float],
    x_rule: Rule,
    y_rule: Rule,
    depth_rule: Rule,
) -> None:
    """Add one beam's order-1 image; `edges` are (y low, y high, z low, z high) on the plane x = 0."""
    x_nodes, x_weights = x_rule
    rows, columns = image.shape
    y_first = -geometry.half_width
    corners = np.empty(4)
    for column in range(columns):
        x_left = column * pixel_mm
        if x_left >= geometry.length:
            break
        parts = _parts_along_x(geometry, x_left, pixel_mm, edges, sigma_t)
        for part in range(parts):
            for i in range(x_nodes.size):
                x = x_left + pixel_mm * (part + 0.5 + 0.5 * x_nodes[i]) / parts
                if x >= geometry.length:
                    continue
                for k in range(4):
                    corners[k] = sighting_row(geometry, x, edges[k // 2], edges[2 + k % 2])
                corners.sort()
                top = max(0, math.floor((corners[0] - y_first) / pixel_mm))
                bottom = min(rows - 1, math.floor((corners[3] - y_first) / pixel_mm))
                for row in range(top, bottom + 1):
                    low = y_first + row * pixel_mm
                    high = min(low + pixel_mm, geometry.half_width)
                    total = across_sights(geometry, x, low, high, corners, sigma_t, g, edges, y_rule, depth_rule)
                    image[row, column] += strength * total / pixel_mm * 0.5 * x_weights[i] / parts


@kernel
def _parts_along_x(
    geometry: Geometry, x_left: float, pixel_mm: float, edges: tuple[float, float, float, float], sigma_t: float
) -> int:
    """How many parts of a column of pixels to integrate separately along x: more where there are kinks, or dense."""
    parts = 1 + int(sigma_t * pixel_mm)
    for k in range(4):
        left = sighting_row(geometry, x_left, edges[k // 2], edges[2 + k % 2])
        right = sighting_row(geometry, x_left + pixel_mm, edges[k // 2], edges[2 + k % 2])
        shift = geometry.half_width / pixel_mm
        if math.floor(left / pixel_mm + shift) != math.floor(right / pixel_mm + shift):
            parts = max(parts, SLANTED_PARTS)
    return max(parts, KINKED_PARTS) if kinked(geometry, x_left, pixel_mm, edges) else parts
