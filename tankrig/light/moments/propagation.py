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

NEAR_CELLS = 5.0
"""Radius in cells within which the kernel is integrated in spherical coordinates, where 1/r² is gone. With 3, moments
to degree 4 made images that were .2 % off."""
POINTS, REFLECTED_POINTS = (40, 32), (80, 64)
"""Of the rule there, by angle and along: finer where the reflectance has its kink at the critical angle (.3 % without).
"""


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
        (pairs of moments a ≥ b, wave numbers along x, along y and z) spectra, those ≥ 0. With an axis turned round a
        kernel is the same but for its sign, so that spectra are real, or purely imaginary where la + lb is odd: i is
        taken out of them and left to moments of odd degree.
    reflected
        (2, pairs, …) real and imaginary parts of the same for light that meets the Fresnel surface on its way; without
        pairs when the surface is matched.
    """

    degree: int
    cells: Cells
    padded: tuple[int, int, int]
    direct: Single
    reflected: Single

    def __call__(self, emission: Single) -> Single:
        """(moments, nx, ny, nz) averages over cells of the radiance's moments from those of the emission."""
        nz = self.cells.counts[2]
        field = self._transformed(_sharpened(emission))
        level, signs = degrees(self.degree), parities(self.degree)
        turned = np.exp(-2j * np.pi * np.arange(field.shape[3]) * (nz - 1) / self.padded[2]).astype(np.complex64)

        def rows(low: int, high: int) -> None:
            _multiply(field, self.direct, self.reflected, level, signs, turned, low, high)

        _in_parts(rows, self.direct.shape[1])
        return self._back(field)

    # Moment by moment, and axis by axis, without the transforms of nothing and of what is thrown away: on the way, all
    # moments of a plane at once would take three times the memory.

    def _transformed(self, emission: Single) -> Spectra:
        """(moments, wave numbers along x, y and z) spectra of the emission."""
        nx, ny, nz = self.padded
        field = np.empty((len(emission), nx, ny, nz // 2 + 1), np.complex64)

        def moments(low: int, high: int) -> None:
            for moment in range(low, high):
                lines = scipy.fft.fft(scipy.fft.rfft(emission[moment], nz, axis=2), ny, axis=1)
                field[moment] = scipy.fft.fft(lines, nx, axis=0)

        _in_parts(moments, len(emission))
        return field

    def _back(self, field: Spectra) -> Single:
        """(moments, nx, ny, nz) of spectra, which are used up."""
        nx, ny, nz = self.cells.counts
        seen = np.empty((len(field), nx, ny, nz), np.float32)

        def moments(low: int, high: int) -> None:
            for moment in range(low, high):
                planes = scipy.fft.ifft(field[moment], axis=0, overwrite_x=True)[:nx]
                lines = scipy.fft.ifft(planes, axis=1, overwrite_x=True)[:, :ny]
                seen[moment] = scipy.fft.irfft(lines, self.padded[2], axis=2)[..., :nz]

        _in_parts(moments, len(field))
        return seen


def _sharpened(emission: Single) -> Single:
    """The emission less h²/12 of its curvature along each axis."""
    sharp = emission.copy()
    for axis in (1, 2, 3):
        slope = np.moveaxis(np.diff(sharp, axis=axis), axis, 0) / 12.0
        first, last = slope[0] - 0.5 * slope[1], slope[-1] - 0.5 * slope[-2]  # what the walls' side would add
        slope[0] += first
        slope[-1] += last
        rows = np.moveaxis(sharp, axis, 0)
        rows[:-1] -= slope
        rows[1:] += slope
    return sharp


def _in_parts(work: Callable[[int, int], None], count: int) -> None:
    """Do work on ranges that make up 0 … count, one in each thread."""
    edges = np.linspace(0, count, THREADS + 1).astype(int)
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))


@kernel
def _multiply(
    field: Spectra, direct: Single, reflected: Single, level: NDArray[np.int64], signs: NDArray[np.int64],
    turned: Spectra, low: int, high: int,
) -> None:  # fmt: skip
    """Put the spectra of the radiance in place of those of the emission, for some rows of wave numbers.

    With K_ab(−k) = ± K_ab(k) along x and y, signs are given to what is multiplied and to the result, and one kernel
    does for four wave numbers. The emission turned upside down, which the surface shows, has the spectrum
    conj Q(−kx, −ky, kz) · e^{−2πi kz (nz − 1)/n}.

    Parameters
    ----------
    field
        (moments, wave numbers along x, y and z) spectra, replaced.
    direct, reflected
        As `Propagation` has them.
    level, signs
        Degrees of the moments, and what they are multiplied by where an axis is turned round.
    turned
        The exponential, by wave number along z.
    low, high
        Rows: wave numbers along x.
    """
    moments, across, along, up = field.shape
    plane = direct.shape[2]
    mirrored = reflected.shape[1] > 0
    source = np.empty((2, 2, 2, moments, plane), np.float32)  # turned along x, along y; real and imaginary part
    come, back, total, shown = np.empty((4, 2, moments, plane), np.float32)
    for i in range(low, high):
        for at_x, at_y, b, j in np.ndindex(2, 2, moments, plane // up):
            row = field[b, (across - i) % across if at_x else i, (along - j) % along if at_y else j]
            source[at_x, at_y, 0, b, j * up : (j + 1) * up] = row.real
            source[at_x, at_y, 1, b, j * up : (j + 1) * up] = row.imag
        for at_x, at_y in np.ndindex(2, 2):
            total[:], shown[:] = 0.0, 0.0
            for b in range(moments):
                sign = np.float32((signs[0, b] if at_x else 1) * (signs[1, b] if at_y else 1))
                odd = level[b] % 2
                come[0, b] = source[at_x, at_y, odd, b] * (-sign if odd else sign)
                come[1, b] = source[at_x, at_y, 1 - odd, b] * sign
                if mirrored:
                    _turn(back, b, source[1 - at_x, 1 - at_y], turned, float(sign * signs[2, b]))
            pair = 0
            for a in range(moments):
                for b in range(a + 1):
                    _add_real(total, a, direct[pair, i], come, b)
                    if b < a:
                        _add_real(total, b, direct[pair, i], come, a)
                    if mirrored:
                        _add_complex(shown, a, reflected[0, pair, i], reflected[1, pair, i], back, b)
                        if b < a:
                            _add_complex(shown, b, reflected[0, pair, i], reflected[1, pair, i], back, a)
                    pair += 1
            for a, j in np.ndindex(moments, plane // up):
                sign = np.float32((signs[0, a] if at_x else 1) * (signs[1, a] if at_y else 1))
                odd = level[a] % 2
                row = field[a, (across - i) % across if at_x else i, (along - j) % along if at_y else j]
                for k in range(up):
                    n = j * up + k
                    real = -total[1, a, n] if odd else total[0, a, n]
                    imaginary = total[0, a, n] if odd else total[1, a, n]
                    row[k] = complex(sign * (real + shown[0, a, n]), sign * (imaginary + shown[1, a, n]))


@part
def _turn(back: Single, b: int, source: Single, turned: Spectra, sign: float) -> None:
    """Spectrum of moment b of the emission upside down; `source` is at the opposite wave numbers along x and y."""
    for n in range(source.shape[2]):
        phase = turned[n % turned.size]
        back[0, b, n] = sign * (source[0, b, n] * phase.real + source[1, b, n] * phase.imag)
        back[1, b, n] = sign * (source[0, b, n] * phase.imag - source[1, b, n] * phase.real)


@part
def _add_real(into: Single, a: int, factor: Single, come: Single, b: int) -> None:
    """Add moment b, times a real spectrum, to moment a."""
    for plane in range(2):
        sums, values = into[plane, a], come[plane, b]
        for n in range(factor.size):
            sums[n] += factor[n] * values[n]


@part
def _add_complex(into: Single, a: int, real: Single, imaginary: Single, come: Single, b: int) -> None:
    """The same with a complex spectrum."""
    sums_re, sums_im, values_re, values_im = into[0, a], into[1, a], come[0, b], come[1, b]
    for n in range(real.size):
        sums_re[n] += real[n] * values_re[n] - imaginary[n] * values_im[n]
        sums_im[n] += real[n] * values_im[n] + imaginary[n] * values_re[n]


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
    level = degrees(degree) % 2
    both_odd = (level[a] * level[b] == 1)[:, None]  # their i² is taken out, as it is put in again with the moments
    octant = _octant(degree, cells.counts, cells.size_mm, sigma_t, 0.0)
    direct = _of_pairs(np.where(both_odd, -pairs, pairs), _spectra(degree, octant, padded, reflected=False)[None])[0]
    reflected = np.zeros((2, 0, 0, 0), np.float32)
    if refractive_index > 1.0:
        across, along, up = cells.counts
        octant = _octant(degree, (across, along, 2 * up), cells.size_mm, sigma_t, refractive_index)
        reflected = _of_pairs(pairs, _spectra(degree, octant, padded, reflected=True))
    return Propagation(degree, cells, padded, direct, reflected)


def _of_pairs(pairs: Single, spectra: Single) -> Single:
    """(parts, pairs, kx, ky and kz) kernels between moments from (parts, harmonics, kx, ky, kz) spectra."""
    parts, count, across = spectra.shape[:3]
    return np.asarray((pairs @ spectra.reshape(parts, count, -1)).reshape(parts, len(pairs), across, -1))


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
    by_angle, along_way = REFLECTED_POINTS if index > 0.0 else POINTS
    directions, weights = sphere(by_angle, octant=True)
    nodes, lengths = np.polynomial.legendre.leggauss(along_way)
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


def _spectra(degree: int, octant: Array, padded: tuple[int, int, int], reflected: bool) -> Single:
    """Spectra of the scalar kernels from one octant of them, at wave numbers ≥ 0.

    They are (harmonics, …), real or over i, where light comes straight, and otherwise (2, harmonics, …) real and
    imaginary parts: the way up to the surface and down is a displacement below, and only those are filled in.
    """
    signs, odd = parities(2 * degree), degrees(2 * degree) % 2
    kept = tuple(slice(0, count // 2 + 1) for count in padded)
    planes = (2,) if reflected else ()
    spectra = np.empty((*planes, len(octant), *(count // 2 + 1 for count in padded)), np.float32)

    def transform(harmonic: int) -> None:
        full = np.zeros(padded, np.float32)
        for flips in np.ndindex(2, 2, 2):
            if reflected and not flips[2]:
                continue
            target: list[slice] = []
            origin: list[slice] = []
            for flip, count, size in zip(flips, octant.shape[1:], padded, strict=True):
                far = min(count, size) if flip and count > size // 2 else min(count, (size + 1) // 2)
                target.append(slice(size - far + 1, size) if flip else slice(0, far))
                origin.append(slice(far - 1, 0, -1) if flip else slice(0, far))
            sign = math.prod(int(signs[axis, harmonic]) for axis in range(3) if flips[axis])
            full[tuple(target)] = sign * octant[harmonic][tuple(origin)]
        if reflected:
            full = np.roll(
                full, octant.shape[3] // 2, axis=2
            )  # from the mirror image of cell j to cell n − 1 − j itself
        found = scipy.fft.rfftn(full)[kept]
        if reflected:
            spectra[0, harmonic], spectra[1, harmonic] = found.real, found.imag
        else:
            spectra[harmonic] = found.imag if odd[harmonic] else found.real

    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(transform, range(len(octant))))
    return spectra
