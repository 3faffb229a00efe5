"""Light from everywhere in the tank to everywhere, as moments over direction: φ = K Q.

φ_a(x) = ∫ Σ_b Y_a(r̂) Y_b(r̂) e^{−σt r}/r² Q_b(x') dx' over the tank, r = x − x' (Eq. 8 integrated over directions): in a
convex tank with black walls every straight way between two points stays inside, so this is a convolution whose result
outside is thrown away. Products of harmonics are sums of harmonics, so one scalar function per harmonic of twice the
degree makes all the kernels.

Cells hold averages, and the kernel is averaged over pairs of cells, so that light is lost at the walls exactly. Taking
the emission as even within each cell would spread it by h²/12 too much along each axis; as much is taken back first
(without that, at σt = .05, h = 8 mm, diffusion is 4 % too fast).
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import reflectance
from tankrig.light.moments.cells import Cells
from tankrig.light.moments.harmonics import degrees, fill_harmonics, harmonics, parities, products, sphere
from tankrig.light.quadrature import Rule
from tankrig.threads import THREADS

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Spectra = NDArray[np.complex64]

NEAR_CELLS = 3.0
"""Radius in cells within which the kernel is integrated in spherical coordinates, where 1/r² is gone."""


@dataclass(frozen=True)
class Propagation:
    """K for one extinction and tank; build it with `propagation`.

    Parameters
    ----------
    degree
        Highest degree of the moments.
    cells
        Of the tank.
    padded
        Shape of the Fourier transforms.
    direct
        (pairs of moments a ≥ b, wave numbers) spectra. What a kernel is at −r it is at r but for (−1)^(la + lb), so
        spectra are real or purely imaginary; i is taken out of them and left to moments of odd degree.
    reflected
        Complex spectra for light that meets the Fresnel surface on its way; empty when the surface is matched.
    """

    degree: int
    cells: Cells
    padded: tuple[int, int, int]
    direct: Single
    reflected: Spectra

    def __call__(self, emission: Single) -> Single:
        """(moments, nx, ny, nz) averages over cells of the radiance's moments from those of the emission."""
        nx, ny, nz = self.cells.counts
        sharp = emission.copy()
        for axis in (1, 2, 3):
            slope = np.moveaxis(np.diff(sharp, axis=axis), axis, 0) / 12.0
            first, last = slope[0] - 0.5 * slope[1], slope[-1] - 0.5 * slope[-2]  # what the walls' side would add
            slope[0] += first
            slope[-1] += last
            rows = np.moveaxis(sharp, axis, 0)
            rows[:-1] -= slope
            rows[1:] += slope
        spectrum = self._straight(self._transformed(sharp))
        if self.reflected.size:
            mirrored = self._transformed((sharp * parities(self.degree)[2][:, None, None, None])[..., ::-1])
            _in_parts(lambda low, high: _multiply(spectrum, self.reflected, mirrored, low, high), mirrored.shape[1])
        field = spectrum.reshape(len(emission), *self.padded[:2], -1)
        # Axis by axis, without the transforms of what is thrown away; so on the way there, without those of nothing.
        field = scipy.fft.ifft(field, axis=1, workers=THREADS, overwrite_x=True)[:, :nx]
        field = scipy.fft.ifft(field, axis=2, workers=THREADS, overwrite_x=True)[:, :, :ny]
        seen: Single = scipy.fft.irfft(field, self.padded[2], axis=3, workers=THREADS)[..., :nz]
        return seen

    def _transformed(self, emission: Single) -> Spectra:
        """(moments, wave numbers) spectra of the emission."""
        transform: Spectra = scipy.fft.rfft(emission, self.padded[2], axis=3, workers=THREADS)
        transform = scipy.fft.fft(transform, self.padded[1], axis=2, workers=THREADS)
        return scipy.fft.fft(transform, self.padded[0], axis=1, workers=THREADS).reshape(len(emission), -1)

    def _straight(self, source: Spectra) -> Spectra:
        """(moments, wave numbers) spectra of the light that comes straight."""
        phase = np.where(degrees(self.degree) % 2 == 1, 1j, 1.0).astype(np.complex64)[:, None]
        source = source * phase
        planes = np.stack([source.real, source.imag])
        result = np.zeros_like(planes)
        _in_parts(lambda low, high: _multiply_real(result, self.direct, planes, low, high), source.shape[1])
        source.real, source.imag = result
        source *= phase
        return source


def _in_parts(work: Callable[[int, int], None], count: int) -> None:
    """Do work on ranges that make up 0 … count, one in each thread."""
    edges = np.linspace(0, count, THREADS + 1).astype(int)
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))


@kernel
def _multiply_real(result: Single, kernels: Single, source: Single, start: int, stop: int) -> None:
    """`_multiply` for real kernels; result and source are (2, moments, wave numbers), real and imaginary parts."""
    block = 512
    for low in range(start, stop, block):
        high = min(low + block, stop)
        pair = 0
        for a in range(source.shape[1]):
            for b in range(a + 1):
                factor = kernels[pair, low:high]
                for plane in range(2):
                    into, come = result[plane, a, low:high], source[plane, b, low:high]
                    for k in range(factor.size):
                        into[k] += factor[k] * come[k]
                    if b < a:
                        into, come = result[plane, b, low:high], source[plane, a, low:high]
                        for k in range(factor.size):
                            into[k] += factor[k] * come[k]
                pair += 1


@kernel
def _multiply(result: Spectra, kernels: Spectra, source: Spectra, start: int, stop: int) -> None:
    """Add the symmetric matrices whose lower triangles are `kernels`, times the source, wave number by wave number."""
    block = 2048
    for low in range(start, stop, block):
        high = min(low + block, stop)
        pair = 0
        for a in range(source.shape[0]):
            for b in range(a + 1):
                for k in range(low, high):
                    result[a, k] += kernels[pair, k] * source[b, k]
                if b < a:
                    for k in range(low, high):
                        result[b, k] += kernels[pair, k] * source[a, k]
                pair += 1


def propagation(degree: int, cells: Cells, sigma_t: float, refractive_index: float) -> Propagation:
    """K of a tank.

    Parameters
    ----------
    degree
        Highest degree of the moments.
    cells
        Of the tank.
    sigma_t
        Extinction, 1/mm.
    refractive_index
        That the surface shows; 1 when matched.

    Examples
    --------
    >>> cells = Cells((6, 6, 6), (10.0, 10.0, 10.0))
    >>> transport = propagation(0, cells, 0.5, 1.0)
    >>> emission = np.zeros((1, 6, 6, 6), np.float32)
    >>> emission[0, 2, 2, 2] = 1.0
    >>> round(float(transport(emission).sum() * 0.5), 1)  # all of it is absorbed nearby: ∫ φ σt = ∫ Q
    1.0
    """
    nx, ny, nz = (scipy.fft.next_fast_len(2 * count, real=True) for count in cells.counts)
    padded = (nx, ny, nz)
    a, b = np.tril_indices((degree + 1) ** 2)
    pairs = products(degree)[a, b].astype(np.float32)
    octant = _octant(degree, cells.counts, cells.size_mm, sigma_t, 0.0)
    straight = _spectra(degree, octant, padded, reflected=False)
    real = np.where((degrees(2 * degree) % 2 == 1)[:, None], straight.imag, straight.real)
    level = degrees(degree) % 2
    direct = (pairs * (1.0 - 2.0 * level[a] * level[b]).astype(np.float32)[:, None]) @ real
    reflected = np.zeros((0, 0), np.complex64)
    if refractive_index > 1.0:
        across, along, up = cells.counts
        octant = _octant(degree, (across, along, 2 * up), cells.size_mm, sigma_t, refractive_index)
        reflected = (pairs @ _spectra(degree, octant, padded, reflected=True).view(np.float32)).view(np.complex64)
    return Propagation(degree, cells, padded, direct, reflected)


def _octant(
    degree: int, counts: tuple[int, int, int], size_mm: tuple[float, float, float], sigma_t: float, index: float
) -> Array:
    """Y_c(r̂) e^{−σt r}/r² times a cell's volume at displacements of 0 … counts − 1 cells.

    It is averaged over pairs of cells at such displacements: near r = 0 by leaving points of spherical coordinates on
    the displacements around, with linear weights; a smooth window parts that from the rest. With `index` > 0 it is
    multiplied by the Fresnel reflectance.
    """
    double = 2 * degree
    radius = NEAR_CELLS * max(size_mm)
    straight = _StraightLight(size_mm, sigma_t, index, radius)
    result = np.zeros(((double + 1) ** 2, *counts))
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(lambda part: _fill_far(result, double, straight, part, THREADS), range(THREADS)))
    directions, weights = sphere(24, octant=True)
    nodes, lengths = np.polynomial.legendre.leggauss(16)
    reach = [math.ceil(radius / side) + 2 for side in size_mm]
    near = np.zeros((len(result), *reach))
    along = 0.5 * radius * (nodes + 1.0), 0.5 * radius * lengths
    _fill_near(near, harmonics(double, directions), (directions, weights), along, straight)
    for axis, signs in enumerate(parities(double), start=1):
        # What the other octants leave on a plane of symmetry.
        np.moveaxis(near, axis, 0)[0] *= 1.0 + signs[:, None, None]
    reached = tuple(slice(0, min(m, n)) for m, n in zip(near.shape[1:], counts, strict=True))
    result[(slice(None), *reached)] += near[(slice(None), *reached)]
    return result


class _StraightLight(NamedTuple):
    """The kernel e^{−σt r}/r² on cells, times what the surface sends back."""

    size_mm: tuple[float, float, float]
    """Sides of the cells."""
    sigma_t: float
    surface_index: float
    """Refractive index that the surface shows; 0 for light that does not meet it."""
    radius: float
    """Within which the kernel is integrated in spherical coordinates, mm."""


@part
def _window(squared: float) -> float:
    """From 1 at r = 0, where it is flat to fourth order, down to 0 at r = R; argument r²/R².

    Where it ends its curvature is continuous: with a kink there the sum over cells exceeds ∫ K by .03 %, 13 scatterings
    deep in thick water.
    """
    left = 1.0 - squared
    return left * left * left * (1.0 + 3.0 * squared) if squared < 1.0 else 0.0


@kernel
def _fill_far(result: Array, degree: int, straight: _StraightLight, part: int, parts: int) -> None:
    """Y_c(r̂) R e^{−σt r}/r² (1 − window) times a cell's volume, for one of so many parts of the places along x."""
    size_mm, sigma_t, index, radius = straight
    values = np.empty(result.shape[0])
    volume = size_mm[0] * size_mm[1] * size_mm[2]
    offset = math.sqrt(1.0 / 6.0)  # in cells: a two-point rule for the displacements between two cells' points
    for i in range(part, result.shape[1], parts):
        for j, k, corner in np.ndindex(result.shape[2], result.shape[3], 8):
            x = (i + (offset if corner & 1 else -offset)) * size_mm[0]
            y = (j + (offset if corner & 2 else -offset)) * size_mm[1]
            z = (k + (offset if corner & 4 else -offset)) * size_mm[2]
            squared = x * x + y * y + z * z
            r = math.sqrt(squared)
            value = 0.125 * volume * math.exp(-sigma_t * r) / squared * (1.0 - _window(squared / (radius * radius)))
            if index > 0.0:
                value *= reflectance(abs(z) / r, index)
            fill_harmonics(degree, x / r, y / r, z / r, values)
            for moment in range(values.size):
                result[moment, i, j, k] += value * values[moment]


@kernel
def _fill_near(near: Array, table: Array, around: Rule, along: Rule, straight: _StraightLight) -> None:
    """∫ dω ∫ dr Y_c(r̂) R e^{−σt r} window over one octant, its points left on the nodes around them.

    Parameters
    ----------
    near
        (harmonics, nx, ny, nz), added to.
    table
        (directions, harmonics) their values.
    around
        (n, 3) directions of the octant, and their weights.
    along
        Radii in mm, and their weights.
    straight
        The kernel.
    """
    (directions, weights), (radii, lengths) = around, along
    size_mm, sigma_t, index, radius = straight
    for n in range(directions.shape[0]):
        for q in range(radii.size):
            r = radii[q]
            value = weights[n] * lengths[q] * math.exp(-sigma_t * r) * _window(r * r / (radius * radius))
            if index > 0.0:
                value *= reflectance(directions[n, 2], index)
            x, y, z = (
                directions[n, 0] * r / size_mm[0],
                directions[n, 1] * r / size_mm[1],
                directions[n, 2] * r / size_mm[2],
            )
            low_x, low_y, low_z = int(x), int(y), int(z)
            for i, j, k in np.ndindex(2, 2, 2):
                share = value * (1.0 - abs(x - low_x - i)) * (1.0 - abs(y - low_y - j)) * (1.0 - abs(z - low_z - k))
                for moment in range(table.shape[1]):
                    near[moment, low_x + i, low_y + j, low_z + k] += share * table[n, moment]


def _spectra(degree: int, octant: Array, padded: tuple[int, int, int], reflected: bool) -> Spectra:
    """Spectra of the scalar kernels from one octant of them.

    Of light that the surface reflects, the way up and down is a displacement below: only those are filled in.
    """
    signs = parities(2 * degree)
    full = np.zeros((len(octant), *padded), np.float32)
    for flips in np.ndindex(2, 2, 2):
        if reflected and not flips[2]:
            continue
        target: list[slice] = [slice(None)]
        origin: list[slice] = [slice(None)]
        for flip, count, size in zip(flips, octant.shape[1:], padded, strict=True):
            far = min(count, size) if flip and count > size // 2 else min(count, (size + 1) // 2)
            target.append(slice(size - far + 1, size) if flip else slice(0, far))
            origin.append(slice(far - 1, 0, -1) if flip else slice(0, far))
        sign = np.prod([signs[axis] for axis in range(3) if flips[axis]], axis=0) * np.ones(len(octant))
        full[tuple(target)] = sign[:, None, None, None] * octant[tuple(origin)]
    if reflected:
        full = np.roll(full, octant.shape[3] // 2, axis=3)  # from the mirror image of cell j to cell n − 1 − j itself
    spectra = scipy.fft.rfftn(full, axes=(1, 2, 3), workers=THREADS).reshape(len(octant), -1)
    return spectra.astype(np.complex64)
