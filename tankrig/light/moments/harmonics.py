"""Real orthonormal spherical harmonics: degree l and order m at index l² + l + m; cos mφ for m > 0, sin for m < 0."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part

Array = NDArray[np.float64]


@part
def fill_harmonics(degree: int, x: float, y: float, z: float, values: Array) -> None:
    """All harmonics up to a degree in the direction (x, y, z), a unit vector, into values[(degree + 1)²]."""
    cosine, sine = 1.0, 0.0
    diagonal = math.sqrt(0.25 / math.pi)
    for m in range(degree + 1):
        if m > 0:
            cosine, sine = cosine * x - sine * y, sine * x + cosine * y
            diagonal *= math.sqrt((2.0 * m + 1.0) / (2.0 * m))
        before, now = 0.0, diagonal
        falling = 0.0
        for level in range(m, degree + 1):
            if level > m:
                rising = math.sqrt((4.0 * level * level - 1.0) / (level * level - m * m))
                before, now = now, rising * (z * now - falling * before)
                falling = 1.0 / rising
            centre = level * level + level
            if m == 0:
                values[centre] = now
            else:
                values[centre + m] = math.sqrt(2.0) * now * cosine
                values[centre - m] = math.sqrt(2.0) * now * sine


def harmonics(degree: int, directions: Array) -> Array:
    """Values of all harmonics up to a degree.

    Parameters
    ----------
    degree
        Highest degree.
    directions
        (n, 3) unit vectors.

    Returns
    -------
    (n, (degree + 1)²) array

    Examples
    --------
    >>> directions, weights = sphere(4)
    >>> table = harmonics(2, directions)
    >>> bool(np.allclose(table.T * weights @ table, np.eye(9)))
    True
    """
    table = np.empty((len(directions), (degree + 1) ** 2))
    _fill_table(degree, np.ascontiguousarray(directions, np.float64), table)
    return table


@kernel
def _fill_table(degree: int, directions: Array, table: Array) -> None:
    for n in range(directions.shape[0]):
        fill_harmonics(degree, directions[n, 0], directions[n, 1], directions[n, 2], table[n])


def degrees(degree: int) -> NDArray[np.int64]:
    """Degree l of each index."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)


def parities(degree: int) -> NDArray[np.int64]:
    """(3, indices) signs that the harmonics take on when x, y or z changes its sign."""
    level = degrees(degree)
    m = np.arange(level.size) - level**2 - level
    even_m = 1 - 2 * (m % 2)
    return np.array([np.where(m < 0, -even_m, even_m), np.where(m < 0, -1, 1), 1 - 2 * ((level + m) % 2)])


def sphere(count: int, octant: bool = False) -> tuple[Array, Array]:
    """Directions and weights of a rule on the sphere, exact up to degree 2·count − 1; or the part with x, y, z > 0."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    angles = (np.arange(2 * count) + 0.5) * np.pi / count
    if octant:
        nodes, weights, angles = nodes[nodes > 0.0], weights[nodes > 0.0], angles[angles < 0.5 * np.pi]
    sines = np.sqrt(1.0 - nodes**2)
    along = np.outer(nodes, np.ones(angles.size))
    directions = np.stack([np.outer(sines, np.cos(angles)), np.outer(sines, np.sin(angles)), along], axis=-1)
    return directions.reshape(-1, 3), np.repeat(weights, angles.size) * np.pi / count


def products(degree: int) -> Array:
    """Gaunt coefficients: Y_a Y_b = Σ_c products[a, b, c] Y_c, with c up to twice the degree."""
    directions, weights = sphere(2 * degree + 1)
    few, many = harmonics(degree, directions), harmonics(2 * degree, directions)
    table: Array = np.einsum("na,nb,nc->abc", few, few, weights[:, None] * many, optimize=True)
    return np.where(np.abs(table) > 1e-12, table, 0.0)
