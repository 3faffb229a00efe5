"""What one camera above a tank can know of a liquid, by information: figure and tables of one_camera.md.

python docs/figures/one_camera.py [--out docs/figures]
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.console import Console

from tankrig.advice.expected import Answer, Expected, Known, Shot, expected
from tankrig.advice.ranking import answer_by_paths
from tankrig.estimation.phase_families import (
    Family,
    as_free,
    free,
    henyey_greenstein,
    labelled,
    reynolds_mccormick,
    two_term,
)
from tankrig.figures.tank_image import STYLE
from tankrig.materials.library import material
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.phase_functions import ReynoldsMcCormick

EMULSION = ReynoldsMcCormick(0.65, 0.75)
"""About what oil droplets do: a mean cosine of .77."""
NOISE, MODEL_ERROR = 0.003, 0.0005
SIGMA_S = (0.003, 0.01, 0.03)
SIGMA_A = 5e-4
LOOKED_AT_DEG = (60.0, 90.0, 120.0, 150.0)
HEADS = ("σs, %", "g", "σs(1−g), %", "σs p(90°), %", *(f"p({angle:g}°), %" for angle in LOOKED_AT_DEG))


def light(y_mm: Sequence[float], width_mm: float = 4.0) -> tuple[Beam, ...]:
    """Beams of the same width in the middle of the height."""
    return tuple(Beam((low - 0.5 * width_mm, low + 0.5 * width_mm), (58.0, 62.0)) for low in y_mm)


PATTERNS = {
    "three beams": light((-40.0, 0.0, 40.0)),
    "stripes": light(np.arange(-56.0, 57.0, 16.0), 8.0),
    "sheet": light((0.0,), 120.0),
    "one beam": light((0.0,)),
    "beam at the side": light((50.0,)),
    "two beams": light((-60.0, 60.0)),
}
ABOVE = Camera("orthographic", (40, 60), 4.0)
CAMERAS = {
    "far above": ABOVE,
    "at .5 m": Camera("pinhole", (40, 60), 4.0, position_mm=(120.0, 0.0, 620.0)),
    "at .5 m, over one end": Camera("pinhole", (40, 60), 4.0, position_mm=(20.0, 0.0, 620.0)),
}
COLLIMATED = "collimated"


def scene(pattern: str, camera: Camera = ABOVE, slanted: bool = False) -> Scene:
    """Of the tank without a liquid."""
    beams = PATTERNS[pattern]
    projector = Projector(COLLIMATED, beams)
    if slanted:
        projector = Projector("pinhole", beams, position_mm=(-120.0, 0.0, 160.0))
    return Scene(Tank(), Medium(0.0, 0.0, 0.0), projector, camera)


def known(family: Family, coordinates: np.ndarray) -> Known:
    """An ink of which a ml makes σs .01, photographed with white noise of its peak's."""
    ink = Medium(SIGMA_A, 0.01, phase=family.phase(coordinates))

    def variance(image: np.ndarray) -> np.ndarray:
        return np.full(image.shape, (NOISE * float(image.max())) ** 2)

    return Known(ink, 0.0, 1.0, False, variance, MODEL_ERROR, family)


def shots(scenes: Mapping[str, Scene], doses_ml: Sequence[float]) -> list[Shot]:
    """Each pattern at each dose; doses are known."""
    return [Shot(name, one, dose_ml, 0.0, 1) for dose_ml in doses_ml for name, one in scenes.items()]


def row(found: Expected) -> list[str]:
    """Standard deviations."""
    answer = found.scattering
    assert answer is not None
    reduced, sideways = (100.0 * sd / value for value, sd in (answer.reduced, answer.at_right_angle))
    at = [100.0 * answer.curve.sd[int(np.flatnonzero(answer.curve.angle_deg == angle)[0])] for angle in LOOKED_AT_DEG]
    numbers = [f"{found.relative_sd['g']:.4f}", *(f"{one:.2g}" for one in (reduced, sideways, *at))]
    return [f"{100.0 * found.relative_sd['sigma_s']:.2g}", *numbers]


def table(title: str, rows: Mapping[str, Expected]) -> str:
    """In Markdown."""
    lines = [f"| {title} | {' | '.join(HEADS)} |", "|---" * (1 + len(HEADS)) + "|"]
    return "\n".join([*lines, *(f"| {name} | {' | '.join(row(one))} |" for name, one in rows.items())])


def families() -> dict[str, tuple[Family, np.ndarray]]:
    """What is fitted, at a liquid that is about the same in all but the labels."""
    g = EMULSION.mean_cosine
    rm = reynolds_mccormick()
    beads = {}
    for size in (0.5, 1.0):
        one = material(f"polystyrene-{size:g}").beads
        assert one is not None
        label = labelled(one.mie(633.0))
        beads[f"label, beads {size:g} µm"] = label, np.zeros(3)
    return {
        "Henyey–Greenstein": (henyey_greenstein(), henyey_greenstein().like(g)),
        "Reynolds–McCormick": (rm, rm.coordinates(EMULSION)),
        "two-term": (two_term(), two_term().like(g)),
        "free": (free(), as_free(EMULSION)),
        **beads,
    }


def measured(told: Callable[[str], object]) -> tuple[dict[str, dict[str, Expected]], dict[str, Expected]]:
    """Tables by title, and free phase functions by σs."""
    found: dict[str, dict[str, Expected]] = {}
    answers: dict[str, tuple[Known, Answer]] = {}
    for name, (family, coordinates) in families().items():
        one = known(family, coordinates)
        answers[name] = one, answer_by_paths(one.family)

    def of(name: str, scenes: Mapping[str, Scene], doses_ml: Sequence[float]) -> Expected:
        told(f"{name}: {', '.join(scenes)}")
        one, answer = answers[name]
        return expected(one, shots(scenes, doses_ml), answer)

    beams = {"three beams": scene("three beams")}
    found["family, σs .01"] = {name: of(name, beams, [1.0]) for name in answers}
    by_density = {f"{sigma_s:g}": of("free", beams, [100.0 * sigma_s]) for sigma_s in SIGMA_S}
    found["free, σs in 1/mm"] = by_density
    names = list(PATTERNS)
    found["free, patterns, σs .01"] = {
        ", ".join(names[:count]): of("free", {name: scene(name) for name in names[:count]}, [1.0])
        for count in (1, 2, 3, 6)
    }
    found["free, where from, σs .01"] = {
        name: of("free", {"three beams": scene("three beams", camera)}, [1.0]) for name, camera in CAMERAS.items()
    }
    found["free, where from, σs .01"]["beams that slant by up to 40°"] = of(
        "free", {"three beams": scene("three beams", slanted=True)}, [1.0]
    )
    doses = {"1": [1.0], "2": [0.3, 3.0], "3": [0.3, 1.0, 3.0], "5": [0.2, 0.4, 0.8, 1.6, 3.2]}
    found["free, doses"] = {name: of("free", beams, doses_ml) for name, doses_ml in doses.items()}
    return found, by_density


def figure(by_density: Mapping[str, Expected], patterns: Mapping[str, Expected]) -> Figure:
    """Standard deviation of p(θ) by density and by patterns."""
    drawn = Figure(figsize=(10.0, 3.7), layout="constrained")
    left, right = drawn.subplots(1, 2, sharey=True)
    for axes, found, title in ((left, by_density, "one image, by σs (1/mm)"), (right, patterns, "σs .01, by patterns")):
        for name, one in found.items():
            assert one.scattering is not None
            curve = one.scattering.curve
            axes.semilogy(
                curve.angle_deg,
                100.0 * curve.sd,
                linewidth=1.2,
                label=name if axes is left else f"{name.count(',') + 1}",
            )
        axes.axvspan(80.0, 100.0, color="#e69f00", alpha=0.12, linewidth=0.0)
        axes.set(title=title, xlabel="θ (°)", xlim=(0.0, 180.0))
        axes.legend()
        axes.grid(alpha=0.25, linewidth=0.6)
    left.set(ylabel="standard deviation of p(θ) (%)")
    return drawn


def main() -> None:
    """Write the picture, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent)
    out = parser.parse_args().out
    console = Console()
    found, by_density = measured(lambda words: Console(stderr=True).print(words))
    for title, rows in found.items():
        console.print(table(title, rows), soft_wrap=True, highlight=False, markup=False)
        console.print()
    with rc_context(STYLE):
        figure(by_density, found["free, patterns, σs .01"]).savefig(out / "one_camera.png", dpi=110)


if __name__ == "__main__":
    main()
