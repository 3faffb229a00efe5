"""Measure where each model holds: print the tables of docs/models.md and draw its figure.

    python docs/figures/models.py [--tolerance 0.03] [--out docs/figures]

The truth is the reference images, and for three beams from thin to dense our own Monte Carlo (noise: the tolerance).
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from tankrig.errors import SceneError
from tankrig.light.diffuse import diffuse_image
from tankrig.light.lightfield import lightfield_orders
from tankrig.light.single import single_scattering
from tankrig.montecarlo import simulate_to
from tankrig.scene import Medium, Scene, load_scene

ROOT = Path(__file__).parents[2]
CASES = ROOT / "tests" / "data" / "reference"
THREE_BEAMS = (
    (0.008, 0.99, 0.5),
    (0.02, 0.9, 0.5),
    (0.02, 0.99, 0.85),
    (0.02, 0.99, 0.5),
    (0.05, 0.999, 0.85),
    (0.05, 0.999, 0.0),
    (0.1, 0.999, 0.0),
)
"""σt per mm, albedo, g; the scenes for which the infinite medium's error is known from elsewhere."""
BY_ORDERS = (0, 3, 4, 5, 6)
NUMBERS_OF_ORDERS = (1, 2, 3, 5, 10, 20, 50, 100)

Image = NDArray[np.float64]


def error(image: Image, truth: Image) -> float:
    """Relative L2."""
    return float(np.linalg.norm(image - truth) / np.linalg.norm(truth))


def transport_depth(scene: Scene) -> float:
    """Height of the tank in transport mean free paths."""
    medium = scene.medium
    return (medium.sigma_t - medium.g * medium.sigma_s) * scene.tank.size_mm[2]


def row(name: str, scene: Scene, truth: Image, noise: float) -> tuple[list[str], dict[str, float]]:
    """Errors of each model, as table cells and as numbers."""
    medium = scene.medium
    cells = [name, f"{medium.sigma_t:.3f}", f"{medium.albedo:.3f}", f"{medium.g:.2f}", f"{transport_depth(scene):.1f}"]
    errors = {"single": error(single_scattering(scene), truth)}
    started = time.perf_counter()
    try:
        errors["convolution"] = error(np.sum(list(lightfield_orders(scene).values()), axis=0), truth)
    except SceneError:
        errors["convolution"] = float("nan")
    between = time.perf_counter()
    errors["diffuse"] = error(diffuse_image(scene), truth)
    seconds = f"{between - started:.1f}", f"{time.perf_counter() - between:.1f}"
    cells += ["–" if np.isnan(value) else f"{100 * value:.1f}" for value in errors.values()]
    return [*cells, f"{100 * noise:.1f}", *seconds], errors


def draw(points: list[tuple[float, dict[str, float]]], curves: dict[str, list[float]], out: Path) -> None:
    """Error by density, and by the number of orders summed."""
    mpl.use("agg")
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for model, marker in (("single", "o"), ("convolution", "s"), ("diffuse", "^")):
        left.loglog([depth for depth, _ in points], [100 * found[model] for _, found in points], marker, label=model)
    left.set_xlabel("height of the tank in transport mean free paths")
    left.set_ylabel("error of the image against the tank, relative L2 in %")
    left.legend()
    for name, values in curves.items():
        right.loglog(NUMBERS_OF_ORDERS, [100 * value for value in values], ".-", label=name)
    right.set_xlabel("orders of scattering summed by the light-field convolution")
    right.legend(title="σt per mm, albedo, g", loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(out / "models.png", dpi=110)


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tolerance", type=float, default=0.03)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "figures")
    arguments = parser.parse_args()
    table = Table(title="Error of the image, relative L2 in %", box=None)
    headings = (
        "case",
        "σt /mm",
        "albedo",
        "g",
        "depth",
        "single",
        "convolution",
        "diffuse",
        "noise",
        "s conv.",
        "s diff.",
    )
    for heading in headings:
        table.add_column(heading, justify="right")
    points: list[tuple[float, dict[str, float]]] = []
    curves: dict[str, list[float]] = {}
    for path in sorted(CASES.glob("pub*.npz")):
        scene = load_scene(path.with_suffix(".toml"))
        with np.load(path) as data:
            truth, stderr = data["total"].astype(float), data["stderr"].astype(float)
        cells, errors = row(path.stem, scene, truth, float(np.linalg.norm(stderr) / np.linalg.norm(truth)))
        table.add_row(*cells)
        points.append((transport_depth(scene), errors))
    beams = load_scene(CASES / "pub01.toml")
    for index, (sigma_t, albedo, g) in enumerate(THREE_BEAMS):
        scene = replace(beams, medium=Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, g))
        tally = simulate_to(scene, arguments.tolerance, seed=1)
        cells, errors = row("three beams", scene, tally.image, tally.noise)
        table.add_row(*cells)
        points.append((transport_depth(scene), errors))
        if index in BY_ORDERS:
            sums = (np.sum(list(lightfield_orders(scene, n).values()), axis=0) for n in NUMBERS_OF_ORDERS)
            curves[f"{sigma_t:g}, {albedo:g}, {g:g}"] = [error(image, tally.image) for image in sums]
    Console(width=140).print(table)
    draw(points, curves, arguments.out)


if __name__ == "__main__":
    main()
