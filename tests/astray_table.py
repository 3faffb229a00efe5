"""What each effect of lenses, walls and the projector's dark does to a fit that does not know it, that is told it, and
that finds it along: the table of decision 234 anew, effect by effect.

python tests/astray_table.py --out table

Prints a line for each effect as soon as it is done, most of them after one to three minutes of a core. What a folder
holds already is read, the rest is worked out, so it can be stopped at any time. Images are the tank model's along other
paths than the fit's, of a pinhole camera and two beams of 8 mm; gain and offset are known, as after calibration. Fits
are told of noise of .2 % of the peak, but none is drawn unless a seed is given: what they are off by is bias, beside
standard deviations of such noise.
"""

import argparse
import json
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

import tankrig
from tankrig.light.tank import tank_image
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import Blur, Face, Faces, Halo, WideLens

TRUTH = Medium(0.0012, 0.0108, 0.4)
NOISE, LATTICES, SEED = 0.002, 96, 91
"""Share of the peak; lattices of paths in an image, which leave .1 % of noise of their own, and where they begin."""
CLOSE, CLOSE_SDS = 0.005, 1.0


@dataclass(frozen=True)
class Effect:
    """One way in which a bench is not ideal.

    Parameters
    ----------
    name
        In words.
    tank, camera, light
        What of the scene is otherwise.
    along
        What is fitted along where it was not measured; none where it has to be measured.
    pane_mm, halo_mm
        What fits along are told of it all the same: the entry pane's thickness, and the width of the projector's halo.
    """

    name: str
    tank: Faces | None = None
    camera: tuple[tuple[str, object], ...] = ()
    light: tuple[tuple[str, object], ...] = ()
    along: tuple[tuple[str, float], ...] = ()
    pane_mm: float | None = None
    halo_mm: float | None = None

    def in_part(self, scene: Scene) -> Scene:
        """A scene that says so much of it."""
        tank, light = scene.tank, scene.projector
        if self.pane_mm is not None:
            tank = replace(tank, faces=Faces(entry=Face(thickness_mm=self.pane_mm)))
        if self.halo_mm is not None:
            light = replace(light, halo=Halo(0.0, self.halo_mm))
        return replace(scene, tank=tank, projector=light)

    def of(self, scene: Scene) -> Scene:
        """A scene that has it."""
        tank = scene.tank if self.tank is None else replace(scene.tank, faces=self.tank)
        camera, light = replace(scene.camera, **dict(self.camera)), replace(scene.projector, **dict(self.light))
        return replace(scene, tank=tank, camera=camera, projector=light)


GLASS = Face("glass", thickness_mm=6.0)
EFFECTS = (
    Effect("none"),
    Effect("halo of 2 %, 30 mm", camera=(("halo", Halo(0.02, 30.0)),), along=(("halo", 0.02),)),
    Effect("veil of 2 %", camera=(("veil", 0.02),), along=(("veil", 0.02),)),
    Effect("camera blur .3 mm", camera=(("blur", Blur(0.3)),), along=(("blur_mm2", 0.1),)),
    Effect("camera blur .6 mm", camera=(("blur", Blur(0.6)),), along=(("blur_mm2", 0.4),)),
    Effect("camera blur 1 mm", camera=(("blur", Blur(1.0)),), along=(("blur_mm2", 1.0),)),
    Effect("projector blur .3 mm", light=(("blur", Blur(0.3)),)),
    Effect(
        "projector halo of 2 %, 20 mm",
        light=(("halo", Halo(0.02, 20.0)),),
        along=(("projector_halo", 0.02),),
        halo_mm=20.0,
    ),
    Effect("projector lens 16 mm wide", light=(("wide_lens", WideLens(16.0, 100.0)),)),
    Effect("black level of .001", light=(("black_level", 0.001),), along=(("black_level", 0.001),)),
    Effect("floor of 4 %", tank=Faces(floor=Face("diffuse", 0.04)), along=(("floor", 0.05),)),
    Effect("entry pane", tank=Faces(entry=GLASS), along=(("pane", 1.0),), pane_mm=6.0),
    Effect("four clear walls", tank=Faces(GLASS, GLASS, GLASS, GLASS)),
)


def bench() -> Scene:
    """The scene without any effect."""
    beams = (Beam((-14.0, -6.0), (54.0, 62.0)), Beam((10.0, 18.0), (54.0, 62.0)))
    light = Projector("pinhole", beams, (-400.0, 0.0, 58.0))
    camera = Camera("pinhole", (40, 60), 4.0, (120.0, 0.0, 620.0))
    return Scene(Tank(surface="fresnel"), TRUTH, light, camera)


def row(effect: Effect, noise_seed: int | None = None) -> dict[str, object]:
    """σs, g and σa of fits that do not know an effect, are told it, and find it along: off, and in deviations."""
    plain = bench()
    seen = effect.of(plain)
    began = cpu_s()
    truth = tank_image(seen, 0.005, seed=SEED, batches=LATTICES)
    image = np.asarray(truth.image, float)
    noise = NOISE * float(image.max())
    if noise_seed is not None:
        image = image + np.random.default_rng(noise_seed).normal(0.0, noise, image.shape)
    known = {"gain": 1.0, "offset": 0.0, "noise": noise, "phase": "hg"}
    found: dict[str, object] = {"effect": effect.name, "truth": float(truth.error), "truth_cpu_s": cpu_s() - began}
    ways: dict[str, tuple[Scene, dict[str, float] | None]] = {"unaware": (plain, None)}
    if seen != plain:
        ways["told"] = seen, None
    if effect.along:
        ways["along"] = effect.in_part(plain), dict(effect.along)
    for way, (scene, nuisance) in ways.items():
        began = cpu_s()
        fit = tankrig.estimate(image, scene, nuisance=nuisance, **known)
        sd = np.sqrt(np.diag(fit.covariance))[:3]
        off = np.array(fit.medium.coefficients) - TRUTH.coefficients
        share = off / [TRUTH.sigma_a, TRUTH.sigma_s, 1.0]
        found[way] = {
            "off": share.tolist(), "sds": (off / sd).tolist(), "verdict": fit.verdict, "cpu_s": cpu_s() - began,
        }  # fmt: skip
    return found


def cpu_s() -> float:
    """Of this process so far."""
    user, system, *_ = os.times()
    return user + system


def line(found: dict[str, object]) -> str:
    """In words."""
    words = [f"{found['effect']:30s}"]
    for way in ("unaware", "told", "along"):
        one = found.get(way)
        if isinstance(one, dict):
            (_, by_s, by_g), (_, sds, sds_g) = one["off"], one["sds"]
            close = abs(by_s) <= CLOSE or abs(sds) <= CLOSE_SDS
            off = f"σs {by_s:+.2%} {sds:+.1f} sd{' ' if close else '✗'} g {by_g:+.4f} {sds_g:+.1f} sd"
            words.append(f"{way} {one['cpu_s']:.0f} s: {off}")
    return "  ".join(words)


def main() -> int:
    """Work out what is missing, and print all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of what was worked out")
    parser.add_argument("--only", default="", help="effects whose names begin with this, and no others")
    parser.add_argument("--noise-seed", type=int, help="draw noise; give every seed a folder of its own")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for number, effect in enumerate(EFFECTS):
        if not effect.name.startswith(given.only):
            continue
        kept = given.out / f"{number:02d}.json"
        if not kept.exists():
            kept.write_text(json.dumps(row(effect, given.noise_seed), ensure_ascii=False), encoding="utf-8")
        print(line(json.loads(kept.read_text(encoding="utf-8"))), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
