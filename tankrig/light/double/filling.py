"""J of several liquids, computed at the nodes of one table by several threads."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.light.double.fineness import FINE, Fineness
from tankrig.light.double.nodes import hardest, laid_out, peaked
from tankrig.light.double.ray_and_sight import Pair, add_pair, depth_below, meet_beyond, nearest_row, share_seen
from tankrig.light.double.table import LitHeight, Stack, Table, decay_of
from tankrig.light.quadrature import Rule, gauss_legendre
from tankrig.light.rays import Geometry, mirror_symmetric, shift_invariant
from tankrig.light.water import Water, water_of
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction
from tankrig.threads import THREADS

Array = NDArray[np.float64]


def fill_stack(
    scene: Scene,
    media: Sequence[Medium],
    lit: LitHeight,
    finest_mm: float,
    fineness: Fineness,
    others: Sequence[PhaseFunction] = (),
) -> tuple[Table, Stack, Array]:
    """Compute J of several liquids at the nodes of `laid_out`, as close as the densest and the steepest want them.

    Parameters
    ----------
    scene
        Its own medium does not matter.
    media
        The liquids.
    lit
        The beams that the table is for.
    finest_mm, fineness
        As for `laid_out`.
    others
        Phase functions near that of the one liquid there is then; after J the stack holds how it changes by the share
        of the way to each.

    Returns
    -------
    table, stack, weights
        The table has the nodes, and no values; `weights` (nz,) integrate over z₀, mm.
    """
    geometry = lit.geometry
    table, weights = laid_out(
        replace(scene, medium=hardest(media)), geometry, lit.z_mm, lit.mirrored, finest_mm, fineness, lit.shared,
        any(peaked(one) for one in media),
    )  # fmt: skip
    y0 = table.y0_mm
    fill = _fill_shifted if shift_invariant(scene) else _fill_slanted
    half = y0.size // 2 if mirror_symmetric(scene) else 0
    decays = np.array([decay_of(one.sigma_t, geometry) for one in media]).repeat(1 + len(others))
    found = np.empty((*table.values.shape, decays.size))
    densities = np.ascontiguousarray(np.array([one.table for one in others]).T) if others else None
    lobed = any(one.phase is not None for one in media)
    rule, each = gauss_legendre(max(fineness.nodes, FINE.nodes) if lobed else fineness.nodes), 1 + len(others)
    with ThreadPoolExecutor(THREADS) as pool:
        for number, medium in enumerate(media):
            values = np.zeros((*table.values.shape, each))
            one_sided = table._replace(y0_mm=y0[: y0.size - half], decay=float(decays[number * each]))
            given = values[:, : y0.size - half], one_sided, geometry, water_of(medium), densities, rule
            for part in [pool.submit(fill, *given, part, THREADS) for part in range(THREADS)]:
                part.result()
            values[:, y0.size - half :] = values[:, :half, ::-1][:, ::-1]  # the other side is the mirror image
            found[..., number * each : (number + 1) * each] = values
    return table, Stack(found, decays), weights


@kernel
def _fill_shifted(
    values: Array, table: Table, geometry: Geometry, water: Water, others: Array | None, rule: Rule, part: int,
    parts: int,
) -> None:  # fmt: skip
    """Every second x, where only y − y₀ matters: both lines are put symmetrically about y = 0, inside the tank."""
    x, fractions, _, y0, z0, _, decay, mirrored, _ = table
    sigma_t, _, phase = water
    for i in range(part, x.size, parts):
        for j in range(z0.size):
            for k in range(fractions.size):
                delta = 2.0 * geometry.half_width * fractions[k]
                pair = Pair(x[i], y0[0] + 0.5 * delta, y0[0] - 0.5 * delta, z0[j], mirrored)
                found = values[j, 0, 0, i, k]
                add_pair(found, geometry, sigma_t, phase, others, pair, rule)
                found *= math.exp(decay * (x[i] + delta))
                values[j, 0, 1, i, k] = found


@kernel
def _fill_slanted(
    values: Array, table: Table, geometry: Geometry, water: Water, others: Array | None, rule: Rule, part: int,
    parts: int,
) -> None:  # fmt: skip
    """Every second x, with nodes between the crossing and either side wall; J over `share_seen`."""
    x, fractions, _, y0, z0, _, decay, mirrored, _ = table
    sigma_t, _, phase = water
    inside = 0.999 * geometry.half_width  # at the wall itself both are 0
    for i in range(part, x.size, parts):
        beyond = meet_beyond(geometry, x[i], y0, z0)
        for j in range(z0.size):
            for m in range(y0.size):
                crossing = nearest_row(geometry, x[i], y0[m], z0[j], beyond)
                depth = depth_below(geometry, x[i], y0[m], z0[j], mirrored)
                for side in range(2):
                    span = geometry.half_width - crossing if side == 1 else geometry.half_width + crossing
                    for k in range(fractions.size):
                        delta = max(span, 1e-6) * fractions[k]
                        y = crossing + delta if side == 1 else crossing - delta
                        y = min(max(y, -inside), inside)
                        pair = Pair(x[i], y, y0[m], z0[j], mirrored)
                        found = values[j, m, side, i, k]
                        add_pair(found, geometry, sigma_t, phase, others, pair, rule)
                        share = max(share_seen(geometry, x[i], y, abs(y - crossing), depth), 1e-9)
                        found *= math.exp(decay * (x[i] + delta)) / share
