"""Photons from the projector, scattered through the tank, and shown to the camera on every flight."""

import math

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel, part
from tankrig.montecarlo.draws import AnyTable, draw, draw_scattered, draw_turn, scrambled, turning
from tankrig.montecarlo.kernel_scene import Flight, KernelScene, Ray, Vector, departure, flight, seen
from tankrig.montecarlo.tally import score_flight
from tankrig.scene.phase import henyey_greenstein

LATTICE = 1.2207440846057596 ** -np.arange(1.0, 4.0)
"""Steps of an additive recurrence that fills the unit cube evenly: its root is that of r⁴ = r + 1 (Roberts 2018)."""
LOBES_FROM = 0.45
"""|g| from which on light is also sent along lobes about the camera."""
TOWARD_CAMERA = 0.15
"""Share of directions drawn from the lobe about the camera."""
HEAVY = 4.0
"""Weight from which on a photon no longer draws from that lobe: each other direction makes it heavier still."""
LIGHT = 0.04
"""Weight below which a photon plays roulette."""


@kernel
def trace(
    scene: KernelScene,
    beams: NDArray[np.float64],
    powers: NDArray[np.float64],
    photons: int,
    max_order: int,
    seed: np.uint64,
    shift: NDArray[np.float64],
    images: NDArray[np.float64],
) -> tuple[float, float]:
    """Follow photons from the projector until they have left, or are too light to matter (roulette, without bias).

    Every flight ends in a collision within the tank: what would have got out is taken off the photon's weight instead,
    so that thin media cost no more than dense ones. For |g| ≥ 0.45, two things find the few directions in which light
    is scattered towards the camera. Some of the directions are drawn from a lobe about it. And at each collision a
    probe is sent along such a lobe and shown to the camera; photon and probe share the next order by the balance
    heuristic (Veach 1997), each with its density over the sum of both.

    Parameters
    ----------
    scene, beams
        From `kernel_scene` and `beam_table`.
    powers
        (beams,) cumulative power of the beams, W; positive at the end.
    photons
        How many.
    max_order
        Order of scattering after which photons are dropped.
    seed, shift
        Of the random numbers; (3,) of the lattice of starting points and first collisions.
    images
        (4, rows, columns) to which the radiance of orders 2, 3, 4–20, > 20 is added, W/mm²/sr.

    Returns
    -------
    absorbed, escaped
        Fractions of the light that were absorbed and that left the tank.
    """
    lobes = abs(scene.phase.g) >= LOBES_FROM
    radiance = powers[-1] / photons / (scene.pixel * scene.pixel)  # of one photon per steradian on one pixel
    absorbed, escaped = 0.0, 0.0
    for photon in range(photons):
        state = scrambled(seed + np.uint64(photon))
        x, v = 0.0, _fraction(shift[2] + photon * LATTICE[2])
        y, z = _start(
            beams, powers, _fraction(shift[0] + photon * LATTICE[0]), _fraction(shift[1] + photon * LATTICE[1])
        )
        ux, uy, uz = departure(scene, y, z)
        weight, share, order = 1.0, 1.0, 0
        while True:
            order += 1
            ray = Ray(x, y, z, ux, uy, uz)
            flown = flight(scene, ray)
            if order > 1:
                u, state = draw(state)
                v, state = draw(state)
                power = weight * share * radiance
                score_flight(scene, ray, flown, power, order, u, images)
            before, around, collided = _chances(scene, flown)
            escaped += weight * (1.0 - collided)
            absorbed += weight * collided * (1.0 - scene.albedo)
            weight *= collided * scene.albedo
            if order == max_order or weight == 0.0:
                break
            if weight < LIGHT:
                u, state = draw(state)
                if u * LIGHT >= weight:
                    break
                weight = LIGHT
            distance = _distance(scene, flown, before, around, v * collided)
            x, y, z = x + ux * distance, y + uy * distance, z + uz * distance
            if distance > flown.first:
                z, uz = 2.0 * scene.height - z, -uz
            bias, vx, vy, vz = 0.0, 0.0, 0.0, 1.0
            if lobes:
                _, _, vx, vy, vz, _, _ = seen(scene, x, y, z)
                bias = TOWARD_CAMERA if weight < HEAVY else 0.0
                wx, wy, wz, state = draw_turn(vx, vy, vz, scene.phase.g, state)
                phase, lobe, drawn = _densities((ux, uy, uz), (vx, vy, vz), (wx, wy, wz), scene.phase, bias)
                u, state = draw(state)
                probe = Ray(x, y, z, wx, wy, wz)
                power = weight * phase / (drawn + lobe) * radiance
                score_flight(scene, probe, flight(scene, probe), power, order + 1, u, images)
            u, state = draw(state)
            if u < bias:
                wx, wy, wz, state = draw_turn(vx, vy, vz, scene.phase.g, state)
            else:
                wx, wy, wz, state = draw_scattered(ux, uy, uz, scene.phase, state)
            if lobes:
                phase, lobe, drawn = _densities((ux, uy, uz), (vx, vy, vz), (wx, wy, wz), scene.phase, bias)
                weight *= phase / drawn
                share = drawn / (drawn + lobe)
            ux, uy, uz = wx, wy, wz
    return absorbed / photons, escaped / photons


@part
def _fraction(number: float) -> float:
    return number - math.floor(number)


@part
def _start(beams: NDArray[np.float64], powers: NDArray[np.float64], a: float, b: float) -> tuple[float, float]:
    """Point of the wall x = 0 where a photon enters, by numbers uniform in [0, 1): as much light everywhere."""
    aim = a * powers[-1]
    beam = min(np.searchsorted(powers, aim, side="right"), powers.size - 1)
    below = powers[beam - 1] if beam > 0 else 0.0
    across = (aim - below) / (powers[beam] - below)
    y_low, y_high, z_low, z_high = beams[beam, 0], beams[beam, 1], beams[beam, 2], beams[beam, 3]
    return y_low + across * (y_high - y_low), z_low + b * (z_high - z_low)


@part
def _chances(scene: KernelScene, flown: Flight) -> tuple[float, float, float]:
    """Shares of a flight's light that collide before its first wall, that get round it, and that collide at all."""
    first, reflected, second = flown
    before = 1.0 - math.exp(-scene.sigma_t * first)
    around = reflected * (1.0 - before)
    if around == 0.0:
        return before, 0.0, before
    return before, around, before + around * (1.0 - math.exp(-scene.sigma_t * second))


@part
def _distance(scene: KernelScene, flown: Flight, before: float, around: float, share: float) -> float:
    """Distance by which `share` of a flight's light has collided."""
    if share < before or around == 0.0:
        return min(-math.log(1.0 - share) / scene.sigma_t, flown.first)
    left = max(1.0 - (share - before) / around, 1e-17)
    return flown.first + min(-math.log(left) / scene.sigma_t, flown.second)


@part
def _densities(u: Vector, v: Vector, w: Vector, table: AnyTable, bias: float) -> tuple[float, float, float]:
    """Of direction w, per sr: phase function from u, lobe about the camera's v, and the mixture that a photon draws.

    p(u·w), h(v·w), and (1 − bias) p + bias h.
    """
    phase = turning(u[0] * w[0] + u[1] * w[1] + u[2] * w[2], table)
    lobe = henyey_greenstein(v[0] * w[0] + v[1] * w[1] + v[2] * w[2], table.g)
    return phase, lobe, (1.0 - bias) * phase + bias * lobe
