"""A plain Monte Carlo, as one would write it first: what importance sampling and lattices are measured against.

Photons start at random points of the projector's beams and fly random free paths until they leave the tank; absorption
is a weight, ended by roulette; every collision, the first included, is counted towards the camera by its next-event
estimate. There is nothing else: no flight is forced to end inside, no direction is drawn towards the camera, no start
comes from a lattice, nothing is integrated along flights, and symmetry isn't used.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from tankrig.compiled import kernel
from tankrig.montecarlo.draws import draw, draw_scattered, scrambled, turning
from tankrig.montecarlo.kernel_scene import KernelScene, Ray, beam_table, departure, flight, kernel_scene, seen
from tankrig.scene import Scene
from tankrig.threads import THREADS

Array = NDArray[np.float64]

LIGHT = 0.05
"""Weight below which a photon plays roulette."""


def plain_image(scene: Scene, photons: int, seed: int = 0) -> Array:
    """Image by plain Monte Carlo, all orders.

    Parameters
    ----------
    scene
        Any scene.
    photons
        How many to follow.
    seed
        Of the random numbers.

    Returns
    -------
    (rows, columns) array, W/mm²/sr

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.002, 0.018, 0.5), light, Camera("orthographic", (8, 12), 20.0))
    >>> float(plain_image(scene, 20_000).sum()) > 0.0
    True
    """
    beams = beam_table(scene)
    powers = np.cumsum([beam.power for beam in scene.projector.beams])
    if scene.medium.sigma_t == 0.0 or powers[-1] == 0.0:
        return np.zeros(scene.camera.shape)

    def share(thread: int) -> Array:
        image = np.zeros(scene.camera.shape)
        first, stop = (photons * part // THREADS for part in (thread, thread + 1))
        _follow(kernel_scene(scene), beams, powers, np.uint64(seed << 40), first, stop, image)
        return image

    with ThreadPoolExecutor(THREADS) as pool:
        return np.asarray(sum(pool.map(share, range(THREADS))) * (powers[-1] / photons / scene.camera.pixel_mm**2))


@kernel
def _follow(
    scene: KernelScene, beams: Array, powers: Array, seed: np.uint64, first: int, stop: int, image: Array
) -> None:
    """Add to `image` what photons `first` … `stop` − 1 send to the camera, each as one of unit power."""
    for photon in range(first, stop):
        state = scrambled(seed + np.uint64(photon))
        u, state = draw(state)
        beam = min(np.searchsorted(powers, u * powers[-1], side="right"), powers.size - 1)
        u, state = draw(state)
        v, state = draw(state)
        x = 0.0
        y = beams[beam, 0] + u * (beams[beam, 1] - beams[beam, 0])
        z = beams[beam, 2] + v * (beams[beam, 3] - beams[beam, 2])
        ux, uy, uz = departure(scene, y, z)
        weight = 1.0
        while True:
            u, state = draw(state)
            distance = -math.log(1.0 - u) / scene.sigma_t
            wall, reflected, further = flight(scene, Ray(x, y, z, ux, uy, uz))
            x, y, z = x + ux * distance, y + uy * distance, z + uz * distance
            if distance >= wall:
                u, state = draw(state)
                if u >= reflected or distance >= wall + further:
                    break
                z, uz = 2.0 * scene.height - z, -uz
            weight *= scene.albedo
            if weight < LIGHT:
                u, state = draw(state)
                if u * LIGHT >= weight:
                    break
                weight = LIGHT
            px, py, vx, vy, vz, path, factor = seen(scene, x, y, z)
            column, row = math.floor(px / scene.pixel), math.floor((py + scene.half_width) / scene.pixel)
            if factor > 0.0 and 0 <= column < scene.columns and 0 <= row < scene.rows:
                lobe = turning(ux * vx + uy * vy + uz * vz, scene.phase)
                image[row, column] += weight * factor * lobe * math.exp(-scene.sigma_t * path)
            ux, uy, uz, state = draw_scattered(ux, uy, uz, scene.phase, state)
