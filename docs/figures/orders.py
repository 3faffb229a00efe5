"""Draw how wrong an image is that stops at an order of scattering, from 1 to 100, thin to dense.

    python docs/figures/orders.py [--batches 8] [--out docs/figures]

Orders 1 and 2 and all further ones come from the tank model, three beams; the truth is the sum of all its orders.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from tankrig.light.double import double_scattering
from tankrig.light.paths.block import PathLimits
from tankrig.light.paths.lattices import THINNING
from tankrig.light.single import single_scattering
from tankrig.light.tank import CellGrid, traced
from tankrig.scene import Medium, Scene, load_scene

ROOT = Path(__file__).parents[2]
MEDIA = (
    (0.002, 0.9, 0.5),
    (0.008, 0.99, 0.85),
    (0.02, 0.9, 0.5),
    (0.02, 0.99, 0.5),
    (0.05, 0.999, 0.85),
    (0.1, 0.999, 0.0),
)
"""σt per mm, albedo, g; thin to dense."""
HIGHEST = 100
FAINTEST = 1e-6


def errors(scene: Scene, batches: int) -> NDArray[np.float64]:
    """Relative L2 error of the sums of orders 1 … n, n = 1 … `HIGHEST`."""
    grid = CellGrid.of(scene)
    bins = np.arange(HIGHEST + 2)  # the last holds all orders above
    limits = PathLimits(1_000_000, FAINTEST, THINNING)
    images = np.mean([traced(scene, grid, (0, batch), bins, limits) for batch in range(batches)], axis=0)
    images = np.array([grid.to_pixels(image) for image in images])
    images[1], images[2] = single_scattering(scene), double_scattering(scene)
    sums = np.cumsum(images[1:], axis=0)
    rest = np.linalg.norm(sums[-1] - sums[:-1], axis=(1, 2))
    return np.asarray(rest / np.linalg.norm(sums[-1]), np.float64)


def main() -> None:
    """Compute, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--batches", type=int, default=8)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "figures")
    arguments = parser.parse_args()
    mpl.use("agg")
    console = Console(width=140, highlight=False)
    beams = load_scene(ROOT / "tests" / "data" / "reference" / "pub01.toml")
    figure, axes = plt.subplots(figsize=(7.0, 4.4), layout="constrained")
    for sigma_t, albedo, g in MEDIA:
        scene = replace(beams, medium=Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, g))
        found = errors(scene, arguments.batches)
        within = int(np.argmax(found < 0.01)) + 1 if (found < 0.01).any() else None
        kept = ", ".join(f"{n}: {found[n - 1]:.3%}" for n in (1, 2, 3, 5, 10, 20, 50, 100))
        console.print(f"{sigma_t:g} {albedo:g} {g:g}  {kept}; 1 % at {within}")
        axes.loglog(np.arange(1, HIGHEST + 1), 100.0 * found, label=f"{sigma_t:g}, {albedo:g}, {g:g}")
    axes.axhline(1.0, color="0.6", lw=0.8, ls=":")
    axes.set(xlabel="orders of scattering summed", ylabel="error of the image, relative L2 in %", ylim=(0.01, 120.0))
    axes.legend(title="σt per mm, albedo, g", fontsize="small")
    axes.grid(alpha=0.3)
    figure.savefig(arguments.out / "orders.png", dpi=110)


if __name__ == "__main__":
    main()
