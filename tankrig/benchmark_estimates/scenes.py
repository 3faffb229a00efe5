"""Scenes that estimates are tried on: stripes of light in thin, medium and thick liquids, and random ones."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tankrig.benchmark_estimates.records import Records
from tankrig.light.prepared.box import Box
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

Array = NDArray[np.float64]

NOISE = 0.002
"""Of the camera, as a share of the image's peak."""
LIQUIDS = {"thin": Medium(0.0004, 0.004, 0.8), "medium": Medium(0.001, 0.02, 0.8), "thick": Medium(0.001, 0.1, 0.8)}
STRIPES = Scene(
    Tank(),
    LIQUIDS["medium"],
    Projector("collimated", tuple(Beam((16.0 * k - 4.0, 16.0 * k + 4.0), (58.0, 62.0)) for k in range(-3, 4))),
    Camera("orthographic", (40, 60), 4.0),
)
"""Seven stripes of period 16 mm, 40 × 60 pixels of 4 mm."""
RANDOM = Box((0.0015, 0.04), (0.7, 0.998), (-0.1, 0.85))
"""That random liquids are drawn from."""
PHOTONS = {"thin": (5_000_000, 1), "medium": (13_000_000, 4), "thick": (24_000_000, 19)}
"""Per piece, and pieces, of the Monte Carlo: noise of at most 0.06 % of the peak."""


def monte_carlo(records: Records, name: str, quick: bool) -> tuple[Array, float]:
    """Image of the stripes in a liquid by Monte Carlo, and the RMS of its own noise as a share of the peak."""
    from tankrig.montecarlo import simulate

    photons, pieces = PHOTONS[name]
    if quick:
        photons, pieces = photons // 5, 1
    scene = replace(STRIPES, medium=LIQUIDS[name])

    def piece(seed: int) -> dict[str, Array]:
        tally = simulate(scene, photons, seed)
        return {"image": tally.image, "stderr": tally.stderr}

    found = [records.arrays(f"truth/{name}-{seed}", partial(piece, seed)) for seed in range(pieces)]
    image = np.mean([one["image"] for one in found], axis=0)
    noise = np.sqrt(np.sum([one["stderr"] ** 2 for one in found], axis=0)) / pieces
    return image, float(np.sqrt(np.mean(noise**2)) / image.max())


def random_media(count: int, box: Box, seed: int = 60) -> list[Medium]:
    """Liquids even in log σt, log(1 − ϖ) and g over what a box and `RANDOM` have in common."""
    random = np.random.default_rng(seed)
    low, high = (np.array([RANDOM.sigma_t[k], RANDOM.albedo[k], RANDOM.g[k]]) for k in (0, 1))
    low = np.maximum(low, [1.05 * box.sigma_t[0], box.albedo[0], box.g[0]])
    high = np.minimum(high, [0.95 * box.sigma_t[1], box.albedo[1], box.g[1]])
    media = []
    for _ in range(count):
        sigma_t = float(np.exp(random.uniform(np.log(low[0]), np.log(high[0]))))
        albedo = 1.0 - float(np.exp(random.uniform(np.log(1.0 - high[1]), np.log(1.0 - low[1]))))
        media.append(Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, float(random.uniform(low[2], high[2]))))
    return media


def other_paths(records: Records, name: str, scene: Scene) -> Array:
    """Image of a scene by the tank model to 0.2 %, along light paths that no fit follows."""
    from tankrig.light.tank import tank_image

    def compute() -> dict[str, Array]:
        image = tank_image(scene, 0.002, seed=77)
        return {"image": np.asarray(image.image, float), "stderr": np.asarray(image.stderr, float)}

    return records.arrays(f"truth/{name}", compute)["image"]
