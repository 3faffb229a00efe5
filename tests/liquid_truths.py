"""Two independent truths of liquids that are not Henyey–Greenstein: beads, emulsions and natural waters in the tank.

    python tests/liquid_truths.py FOLDER --program TRUTH.py [--only NAME] [--noise .004] [--limit-s 30]

TRUTH.py is run as for `tests/wide_truths.py`, with `--phase table:FILE` besides. Phase tables are made here from
`miepython`'s intensities, and of natural waters from Petzold's table, without tankrig. FOLDER gets NAME.toml, NAME.txt
(its phase table) and NAME.npz, for `tests/fits_liquids.py`; what is there is not made again.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.mie import Mie
from tankrig.scene.writing import scene_text

Array = NDArray[np.float64]

WATER, WAVELENGTH_UM, LATEX = 1.3317, 0.633, 1.58242
COSINES = np.concatenate([np.linspace(-1.0, 0.95, 2400, endpoint=False), 1.0 - np.geomspace(0.05, 1e-7, 1600), [1.0]])
BEADS_UM = {"bead-0.2": 0.2, "bead-0.5": 0.5, "bead-1.0": 1.0, "bead-2.0": 2.0}
BEAD_SPREAD = 0.02
PETZOLD = (
    (0.1, 1767.0), (0.2, 699.0), (0.4, 275.0), (0.8, 101.0), (1.6, 33.5), (3.16, 10.0), (6.3, 2.81), (10.0, 1.153),
    (15.0, 0.489), (20.0, 0.244), (25.0, 0.147), (30.0, 0.0861), (40.0, 0.0421), (50.0, 0.0228), (60.0, 0.0131),
    (70.0, 0.00849), (80.0, 0.00584), (90.0, 0.00429), (100.0, 0.0034), (110.0, 0.00291), (120.0, 0.00269),
    (130.0, 0.00248), (140.0, 0.00233), (150.0, 0.00236), (160.0, 0.00266), (170.0, 0.00303), (180.0, 0.00315),
)  # fmt: skip
"""Angle in degrees and p in 1/sr of natural waters' particles, as Petzold's measurements are usually averaged."""
SIGMA_S = {
    "bead-0.2": (0.01, 0.03),
    "bead-0.5": (0.01, 0.03),
    "bead-1.0": (0.01, 0.03),
    "bead-2.0": (0.01, 0.03),
    "intralipid": (0.004, 0.01, 0.02, 0.03, 0.05),
    "milk": (0.004, 0.02),
    "petzold": (0.01, 0.04),
    "two-term": (0.02,),
    "reynolds-mccormick": (0.02,),
    "fournier-forand": (0.02,),
}
ABSORBED = 0.03
"""σa over σs, the same everywhere, so that images of one liquid are a dilution series in clear water."""
THREE_BEAMS = tuple(Beam((low, low + 4.0), (58.0, 62.0)) for low in (-42.0, -2.0, 38.0))
SHEET = (Beam((-60.0, 60.0), (58.0, 62.0)),)
WITH_SHEET = ("bead-1.0-0.010", "intralipid-0.010")
"""Liquids of which there is an image of a sheet of light besides."""
SLANTED = (
    "bead-0.2-0.030", "bead-0.5-0.010", "bead-1.0-0.010", "intralipid-0.010", "intralipid-0.030", "milk-0.020",
    "petzold-0.010", "two-term-0.020", "reynolds-mccormick-0.020", "fournier-forand-0.020",
)  # fmt: skip
"""Liquids that two pinholes light and see besides: in a tank that bends no light (NAME-pinholes), and through glass and
surface (NAME-bent; `--only=-bent` makes these alone)."""


def spheres(diameters_um: Array, index: float, number: Array) -> Array:
    """p at `COSINES` of spheres in water, by number of each diameter."""
    import miepython

    total = np.zeros(COSINES.size)
    for diameter, weight in zip(diameters_um, number / number.sum(), strict=True):
        m, x = index / WATER, np.pi * float(diameter) * WATER / WAVELENGTH_UM
        scattered = miepython.efficiencies_mx(m, x)[1] * float(diameter) ** 2
        total += weight * scattered * np.asarray(miepython.i_unpolarized(m, x, COSINES, norm="one"))
    return normalised(total)


def normalised(density: Array) -> Array:
    """p in 1/sr."""
    return np.asarray(density / (2.0 * np.pi * np.trapezoid(density, COSINES)))


def density_of(liquid: str) -> Array:
    """p of a liquid at `COSINES`."""
    if liquid in BEADS_UM:
        off = np.linspace(-3.0, 3.0, 13)
        return spheres(BEADS_UM[liquid] * (1.0 + BEAD_SPREAD * off), LATEX, np.exp(-0.5 * off**2))
    if liquid == "intralipid":
        sizes = np.linspace(0.025, 1.0, 60)
        return spheres(sizes, 1.47, np.exp(-sizes / 0.097))
    if liquid == "milk":  # fat drops, and casein that scatters a quarter of the light
        fat, casein = np.geomspace(0.1, 3.0, 80), np.geomspace(0.05, 0.4, 30)
        drops = spheres(fat, 1.462, np.exp(-0.5 * (np.log(fat / 0.35) / 0.5) ** 2))
        return 0.75 * drops + 0.25 * spheres(casein, 1.47, np.exp(-0.5 * (np.log(casein / 0.12) / 0.3) ** 2))
    angles = np.degrees(np.arccos(np.clip(COSINES, -1.0, 1.0)))
    if liquid == "petzold":
        at, value = np.array(PETZOLD).T
        return normalised(np.exp(np.interp(np.log(np.maximum(angles, 0.1)), np.log(at), np.log(value))))
    if liquid == "two-term":
        return normalised(0.94 * henyey_greenstein(0.88) + 0.06 * henyey_greenstein(-0.3))
    if liquid == "reynolds-mccormick":
        return normalised((1.0 + 0.7**2 - 2.0 * 0.7 * COSINES) ** -1.9)
    return normalised(fournier_forand(1.1, 3.58))


def henyey_greenstein(g: float) -> Array:
    """Of asymmetry g, up to a factor that is the same for all."""
    return np.asarray((1.0 - g * g) * (1.0 + g * g - 2.0 * g * COSINES) ** -1.5)


def fournier_forand(index: float, slope: float) -> Array:
    """Of particles of an index relative to water and a slope of their sizes (Fournier and Jonasz 1999)."""
    nu = 0.5 * (3.0 - slope)
    half = np.maximum(0.5 * (1.0 - COSINES), 1e-8)  # sin²(θ/2)
    delta, behind = 4.0 * half / (3.0 * (index - 1.0) ** 2), 4.0 / (3.0 * (index - 1.0) ** 2)
    delta = np.where(np.abs(delta - 1.0) < 1e-6, 1.0 + 1e-6, delta)
    raised = delta**nu
    ahead = nu * (1.0 - delta) - (1.0 - raised) + (delta * (1.0 - raised) - nu * (1.0 - delta)) / half
    back = (1.0 - behind**nu) / (16.0 * np.pi * (behind - 1.0) * behind**nu) * (3.0 * COSINES**2 - 1.0)
    return np.asarray(ahead / (4.0 * np.pi * (1.0 - delta) ** 2 * raised) + back)


def liquid_scene(sigma_s: float, light: tuple[Beam, ...]) -> Scene:
    """The tank with such a liquid, Henyey–Greenstein for now."""
    medium = Medium(ABSORBED * sigma_s, sigma_s, 0.8)
    return Scene(Tank(), medium, Projector("collimated", light), Camera("orthographic", (40, 60), 4.0))


def with_pinholes(scene: Scene) -> Scene:
    """The same by two pinholes."""
    projector = Projector("pinhole", scene.projector.beams, position_mm=(-380.0, 0.0, 60.0))
    camera = Camera("pinhole", (40, 60), 4.0, position_mm=(120.0, 0.0, 520.0))
    return replace(scene, projector=projector, camera=camera)


def bent(scene: Scene) -> Scene:
    """The same by two others, through glass and surface."""
    tank = Tank(surface="fresnel", refractive_index=1.3317, entry="glass", wall_mm=8.0)
    projector = Projector("pinhole", scene.projector.beams, position_mm=(-450.0, 25.0, 75.0))
    camera = Camera("pinhole", (40, 60), 4.0, position_mm=(140.0, -20.0, 600.0))
    return replace(scene, tank=tank, projector=projector, camera=camera)


def scenes() -> dict[str, tuple[str, Scene]]:
    """All of them: name, and liquid and scene."""
    found = {}
    for liquid, strengths in SIGMA_S.items():
        for sigma_s in strengths:
            name = f"{liquid}-{sigma_s:.3f}"
            found[name] = liquid, liquid_scene(sigma_s, THREE_BEAMS)
            if name in WITH_SHEET:
                found[f"{name}-sheet"] = liquid, liquid_scene(sigma_s, SHEET)
    slanted = {name: found[name] for name in SLANTED}
    for name, (liquid, scene) in slanted.items():
        found |= {f"{name}-pinholes": (liquid, with_pinholes(scene)), f"{name}-bent": (liquid, bent(scene))}
    return found


def written(scene: Scene, liquid: str, table: Path) -> str:
    """The scene file: a bead's own label, any other liquid's table."""
    if liquid in BEADS_UM:
        phase = Mie(BEADS_UM[liquid], LATEX, WATER, 1000.0 * WAVELENGTH_UM, spread=BEAD_SPREAD)
        liquid_itself = Medium(scene.medium.sigma_a, scene.medium.sigma_s, phase=phase)
        return scene_text(replace(scene, medium=liquid_itself))
    return scene_text(scene).replace("g = 0.8\n", f'phase = {{ kind = "table", file = "{table.name}" }}\n')


def main() -> None:
    """What the command line asks for."""
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("folder", type=Path)
    given.add_argument("--program", type=Path, required=True)
    given.add_argument("--only", default="", help="what names must contain")
    given.add_argument("--noise", type=float, default=0.004, help="relative L2 of each truth")
    given.add_argument("--limit-s", type=float, default=30.0, help="of each truth")
    options = given.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for number, (name, (liquid, scene)) in enumerate(scenes().items()):
        whole, table = options.folder / f"{name}.npz", options.folder / f"{liquid}.txt"
        if whole.exists() or options.only not in name:
            continue
        if not table.exists():
            np.savetxt(table, np.stack([COSINES, density_of(liquid)]).T, fmt="%.17e")
        plain = options.folder / f".{name}.toml"
        plain.write_text(scene_text(scene), encoding="utf-8")
        arrays: dict[str, NDArray[np.float64]] = {}
        for suffix, seed in (("", 1000 * number + 1), ("_2", 1000 * number + 2)):
            out = options.folder / f".{name}{suffix}.npz"
            subprocess.run(
                [
                    sys.executable, str(options.program), str(plain), str(out), "--phase", f"table:{table}",
                    "--n", "1e10", "--n1", "1e7", "--batches", "20000", "--target", str(options.noise),
                    "--maxtime", str(options.limit_s), "--threads", "1", "--seed", str(seed),
                ],
                check=True,
            )  # fmt: skip
            with np.load(out) as data:
                arrays |= {f"{key}{suffix}": data[key] for key in data.files if key != "metadata"}
                told = json.loads(str(data["metadata"]))
            out.unlink()
        plain.unlink()
        (options.folder / f"{name}.toml").write_text(written(scene, liquid, table), encoding="utf-8")
        unfinished = whole.with_name(f".{whole.name}")
        np.savez_compressed(unfinished, **arrays, metadata=np.array(json.dumps(told)))  # type: ignore[arg-type]
        unfinished.replace(whole)


if __name__ == "__main__":
    main()
