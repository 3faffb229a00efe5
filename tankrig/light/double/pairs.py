"""Order 2 as a bilinear form of the phase function, where light and sight run straight.

    I₂ = σs² Σ_ij a_i a_j G_ij,   p(cos θ) = Σ_i a_i B_i(θ)

With the splines B_i of `PhaseSplines` in place of p, the quadrature of `pair_radiance` gives each pair's share of J: a
point of it belongs to the four splines of its first angle and the four of its second. Averaging over pixels and beams
is linear in the table's values, and the same for all pairs.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.geometry.optics import reflectance
from tankrig.light.double.fineness import FINE
from tankrig.light.double.image import add_beams, columns_of
from tankrig.light.double.lit import lit_heights
from tankrig.light.double.nodes import laid_out
from tankrig.light.double.ray_and_sight import MOST_CUTS, PANEL, Pair, cut_at_critical_angle, half_circle, panel_cuts
from tankrig.light.double.table import Stack, Table
from tankrig.light.elementary import exponential
from tankrig.light.quadrature import Rule, gauss_legendre
from tankrig.light.rays import Geometry, path_inside, sight_line
from tankrig.scene import Scene
from tankrig.scene.phase_splines import PhaseSplines, SplineRecord
from tankrig.scene.phase_table import HenyeyGreensteinRecord
from tankrig.threads import THREADS

Array = NDArray[np.float64]

STEEP = HenyeyGreensteinRecord(0.95, 0.001)
"""About whose lobes the quadrature is graded: those of natural waters' particles, the steepest."""


@dataclass(frozen=True)
class PairTables:
    """What pairs of splines make of order 2 at one σt, before it is averaged over pixels.

    Parameters
    ----------
    values
        (nodes, n²) of the tables of all light sources and heights.
    rows
        (rows, nodes) that average nodes over rows of pixels.
    columns
        (nodes, columns) that average them over columns.
    """

    values: NDArray[np.float32]
    rows: NDArray[np.float32]
    columns: NDArray[np.float32]

    def image(self, coefficients: Array) -> Array:
        """(rows, columns) of order 2 over σs², for a phase function's coefficients."""
        pairs = (coefficients[:, None] * coefficients).ravel().astype(np.float32)
        return np.asarray((self.rows * (self.values @ pairs)) @ self.columns, float)

    def along(self, patterns: Array) -> Array:
        """(n, n, patterns): what each pair has of orthonormal images (patterns, rows, columns)."""
        seen = np.einsum("rn,prc,nc->pn", self.rows, patterns, self.columns, optimize=True)
        count = math.isqrt(self.values.shape[1])
        return np.asarray((seen.astype(np.float32) @ self.values).T.reshape(count, count, -1))


def double_pairs(scene: Scene, splines: PhaseSplines) -> PairTables:
    """Order 2 of a scene for any phase function.

    Parameters
    ----------
    scene
        With collimated light and an orthographic camera, sharp beams and dark walls; of its medium only σt matters.
    splines
        Of the phase functions.
    """
    camera = scene.camera
    finest = min(camera.pixel_mm, scene.tank.size_mm[0] / 20.0)
    found = []
    for one in lit_heights(scene):
        table, z0_weights = laid_out(scene, one.geometry, one.z_mm, one.mirrored, finest, FINE, one.shared)
        nodes = table.z0_mm.size, table.fractions.size
        alone = np.zeros((*table.values.shape, *nodes))
        for j, k in np.ndindex(nodes):
            alone[j, ..., k, j, k] = 1.0
        stack = Stack(alone.reshape(*table.values.shape, -1), np.full(math.prod(nodes), table.decay))
        rows = np.zeros((camera.shape[0], table.x_mm.size, math.prod(nodes)))
        add_beams(rows, scene, one, table, stack, z0_weights)
        columns = columns_of(table.x_mm, camera.shape[1], camera.pixel_mm, one.geometry.length).T
        found.append((
            _pair_values(scene, one.geometry, table, splines),
            rows.reshape(*rows.shape[:2], *nodes).transpose(0, 2, 1, 3).reshape(camera.shape[0], -1),
            np.tile(np.repeat(columns, nodes[1], axis=0), (nodes[0], 1)),
        ))  # fmt: skip
    values, by_row, by_column = zip(*found, strict=True)
    return PairTables(
        np.concatenate(values), np.concatenate(by_row, axis=1).astype(np.float32),
        np.concatenate(by_column).astype(np.float32),
    )  # fmt: skip


def _pair_values(scene: Scene, geometry: Geometry, table: Table, splines: PhaseSplines) -> NDArray[np.float32]:
    """(nodes, n²) J by pairs, as `Table.values` has it: nodes in the order z₀, x, δ."""
    nodes = table.z0_mm.size * table.x_mm.size * table.fractions.size
    values = np.zeros((nodes, splines.count**2), np.float32)
    given = values, splines.record, table, geometry, float(scene.medium.sigma_t), gauss_legendre(FINE.nodes)
    with ThreadPoolExecutor(THREADS) as pool:
        for done in [pool.submit(_fill_pairs, *given, share, THREADS) for share in range(THREADS)]:
            done.result()
    return values


@kernel
def _fill_pairs(
    values: NDArray[np.float32], splines: SplineRecord, table: Table, geometry: Geometry, sigma_t: float, rule: Rule,
    part: int, parts: int,
) -> None:  # fmt: skip
    """Every second x; both lines are put symmetrically about y = 0, inside the tank."""
    x, fractions, _, _, z0, _, decay, mirrored, _ = table
    pairs = np.empty(splines.number * splines.number)
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for k in range(fractions.size):
                pairs[:] = 0.0
                delta = 2.0 * geometry.half_width * fractions[k]
                scale = math.exp(decay * (x[i] + delta))
                pair = Pair(x[i], 0.5 * delta, -0.5 * delta, z0[j], mirrored)
                pair_shares(pairs, splines, geometry, sigma_t, pair, scale, rule)
                node = (j * x.size + i) * fractions.size + k
                for place in range(pairs.size):
                    values[node, place] = pairs[place]


@kernel
def pair_shares(
    pairs: Array, splines: SplineRecord, geometry: Geometry, sigma_t: float, pair: Pair, scale: float, rule: Rule
) -> None:
    """Add `scale` times J to what each pair of splines has of it: `pair_radiance` with p left open.

        G_ij = ∫∫ ds dt exp(−σt (s + r + t)) B_i(u·r̂) B_j(r̂·v) / r²

    Parameters
    ----------
    pairs
        (count²,) added to.
    splines
        Of the phase functions.
    geometry, sigma_t, pair, rule
        As for `pair_radiance`; light is collimated and the camera orthographic.
    scale
        A factor.
    """
    (count, places), (nodes, weights) = splines, rule
    x, y, y0, z0, mirrored = pair
    vx, vy, vz, transmission = sight_line(geometry, x, y)
    s_min, s_max = path_inside(geometry, 0.0, y0, z0, 1.0, 0.0, 0.0)
    _, t_max = path_inside(geometry, x, y, geometry.height, -vx, -vy, -vz)
    if s_max <= s_min or t_max <= 0.0:
        return
    flip = -1.0 if mirrored else 1.0
    qy, qz = y - y0, geometry.height - z0  # from the light ray to where the line of sight leaves
    t0 = qz * flip  # where the line is nearest to the ray: it runs straight up, across the ray
    closest = max(abs(qy), 1e-9)
    first, second = np.empty(4), np.empty(4)
    cuts = np.empty(MOST_CUTS)
    tau_low, tau_high = math.asinh(-t0 / closest), math.asinh((t_max - t0) / closest)
    for side in range(2):
        start = tau_low if side == 0 else max(0.0, tau_low)
        end = min(0.0, tau_high) if side == 0 else tau_high
        if end <= start:
            continue
        panels = 1 + int((end - start) / PANEL)
        half = 0.5 * (end - start) / panels
        for panel in range(panels):
            for i in range(nodes.size):
                growth = math.exp(start + half * (2 * panel + 1.0 + nodes[i]))
                t = t0 + closest * 0.5 * (growth - 1.0 / growth)
                distance = closest * 0.5 * (growth + 1.0 / growth)
                dz = (qz - flip * t) / distance
                lobe = dz * flip
                number = panel_cuts(cuts, x - s_max, x - s_min, distance, STEEP, 0.0, lobe)
                if mirrored:
                    number = cut_at_critical_angle(cuts, number, geometry.refractive_index, 0.0, dz)
                outer = scale * transmission * half * weights[i] * math.exp(-sigma_t * (x + t))
                for k in range(number - 1):
                    middle, width = 0.5 * (cuts[k] + cuts[k + 1]), 0.5 * (cuts[k + 1] - cuts[k])
                    for j in range(nodes.size):
                        at = middle + width * nodes[j]
                        s, c = half_circle(at)
                        share = outer * width * weights[j] * 2.0 / (1.0 + at * at)
                        if mirrored:
                            share *= reflectance(abs(c * dz), geometry.refractive_index)
                        share *= exponential(-sigma_t * distance * (1.0 - at) / (1.0 + at))
                        one = _weigh(first, s, places, count)
                        other = _weigh(second, c * lobe, places, count)
                        for a in range(4):
                            row = (one + a) * count + other
                            for b in range(4):
                                pairs[row + b] += share * first[a] * second[b]


@part
def _weigh(found: Array, cosine: float, places: Array, count: int) -> int:
    """Fill the four splines at an angle; the number of the first of them."""
    steps = places.size - 1
    at = math.sqrt(max(0.5 - 0.5 * cosine, 0.0)) * steps
    step = min(int(at), steps - 1)
    place = places[step] + (at - step) * (places[step + 1] - places[step])
    panel = min(int(place), count - 4)
    share = place - panel
    rest = 1.0 - share
    found[0] = rest * rest * rest / 6.0
    found[1] = (3.0 * share * share * share - 6.0 * share * share + 4.0) / 6.0
    found[2] = (3.0 * rest * rest * rest - 6.0 * rest * rest + 4.0) / 6.0
    found[3] = share * share * share / 6.0
    return panel
