"""Fits of liquids that are not Henyey–Greenstein, with independent truths: what they must keep, and whether they do.

    PYTHONPATH=. python tests/fits_liquids.py FOLDER RESULTS.jsonl [--mode family default label hg free doses sheet]
        [--only NAME] [--gain known|free|both] [--seeds 0-4] [--limit N] [--summary]

FOLDER is what `tests/liquid_truths.py` makes. RESULTS gets a line for each fit, and what is there is not fitted again.
Modes: the truth's own family (a bead's label as it is, a table as it is); what a fit left alone does; a label whose
diameter and index are off; Henyey–Greenstein; a free phase function; all strengths of a liquid as a dilution series;
three beams and a sheet of light together.
"""

import argparse
import json
import math
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import tankrig
from tankrig.estimation.observation import observe
from tankrig.estimation.one_liquid import fit_liquid
from tankrig.estimation.phase_answer import asked_for
from tankrig.estimation.phase_families import FAMILIES
from tankrig.estimation.phase_result import Scattering
from tankrig.estimation.scaling import Scaling
from tankrig.scene import Medium, Scene
from tankrig.scene.mie import Mie
from tankrig.scene.phase_table import PhaseFunction
from tests.fits_wide import observed

Array = NDArray[np.float64]
Line = dict[str, Any]

NOISE = 0.003
"""Of the camera, of the image's peak."""
CONE_DEG = {"petzold": 5.0, "fournier-forand": 5.0}
"""What a liquid scatters into less than this stays in its beam and passes for light that was not scattered: σs is
compared without it, and p over what is scattered beyond it."""
LABEL_OFF = (0.05, 0.002)
"""Largest error of a label: of the diameter as a share, and of the particles' index."""
MODES = ("family", "default", "label", "hg", "free", "doses", "sheet")
GAINS = {"known": (1.0, 0.0), "free": ("free", "free")}


def asked_of(mode: str, liquid: str, truth: PhaseFunction, seed: int) -> str | PhaseFunction | None:
    """What `estimate`'s `phase` is."""
    if mode == "default":
        return None
    if mode in ("hg", "free"):
        return mode
    if mode == "label" and isinstance(truth, Mie):
        diameter, index = np.random.default_rng(seed + 100).uniform(-1.0, 1.0, 2) * LABEL_OFF
        return replace(
            truth, diameter_um=truth.diameter_um * (1.0 + diameter), particle_index=truth.particle_index + index
        )
    return liquid if liquid in FAMILIES else truth


def beyond(phase: PhaseFunction, cone_deg: float) -> float:
    """Share of the light that one scattering turns by more."""
    cosines = 1.0 - 2.0 * np.linspace(math.sin(0.5 * math.radians(cone_deg)), 1.0, 20001) ** 2
    return float(-2.0 * math.pi * np.trapezoid(phase.at(cosines), cosines)) if cone_deg else 1.0


def compared(
    medium: Medium, covariance: Array, scattering: Scattering, inside: Iterable[bool], truth: Medium, cone_deg: float
) -> Line:
    """What was found beside what is true."""
    sd, phase = np.sqrt(np.diag(covariance)[:3]), truth.phase_function
    true = np.array([*truth.coefficients[:2], phase.mean_cosine])
    off = np.array(medium.coefficients) - true
    out, found = beyond(phase, cone_deg), beyond(medium.phase_function, cone_deg)
    off[1] = medium.sigma_s * found / out - truth.sigma_s
    curve = scattering.curve
    at = found / out * np.maximum(phase.at(np.cos(np.radians(curve.angle_deg))), 1e-300)
    low, high = curve.band(0.95)
    diameter = scattering.parameters.get("diameter_um")
    return {
        "off": [off[0] / true[0], off[1] / true[1], off[2]], "sd": [sd[0] / true[0], sd[1] / true[1], sd[2]],
        "z": (off / sd).tolist(), "inside": [bool(one) for one in inside],
        "ln_p_off": np.log(curve.value / at).tolist(), "ln_p_sd": curve.sd.tolist(),
        "in_band": [bool(one) for one in (low < at) & (at < high)], "angle_deg": curve.angle_deg.tolist(),
        "diameter": diameter and [diameter[0], diameter[1], getattr(phase, "diameter_um", math.nan)],
        "families": dict(scattering.families),
    }  # fmt: skip


def inside_of(intervals: dict[str, tuple[float, float]], truth: Medium) -> list[bool]:
    """Whether the 95 % intervals of σa, σs and g hold the truth."""
    values = (*truth.coefficients[:2], truth.phase_function.mean_cosine)
    return [low <= value <= high for value, (low, high) in zip(values, intervals.values(), strict=True)]


def normal(medium: Medium, covariance: Array) -> dict[str, tuple[float, float]]:
    """Intervals of 95 %."""
    reach = 1.96 * np.sqrt(np.diag(covariance)[:3])
    values = zip(("sigma_a", "sigma_s", "g"), medium.coefficients, reach, strict=True)
    return {name: (value - one, value + one) for name, value, one in values}


def fitted(scene_file: Path, gain: str, mode: str, seed: int) -> Line:
    """One fit of an image, or of two of one liquid."""
    liquid = scene_file.stem.split("-0.0")[0]
    scene = tankrig.load_scene(scene_file)
    truth, known = scene.medium, GAINS[gain]
    asked = asked_of(mode, liquid, truth.phase_function, seed)
    plain = replace(scene, medium=Medium(truth.sigma_a, truth.sigma_s, 0.0))
    image, noise = observed(scene_file.with_suffix(".npz"), seed, NOISE)
    began = time.process_time()
    if mode == "sheet":
        sheet = tankrig.load_scene(scene_file.with_name(f"{scene_file.stem}-sheet.toml"))
        other = observed(scene_file.with_name(f"{scene_file.stem}-sheet.npz"), seed + 50, NOISE)
        pair: list[Scene] = [plain, replace(sheet, medium=plain.medium)]
        seen = [observe(*one) for one in ((image, image.shape, noise), (other[0], other[0].shape, other[1]))]
        asked = "any" if not isinstance(truth.phase_function, Mie) else truth.phase_function
        found = fit_liquid(seen, pair, Scaling.given(*known), asked=asked_for(asked, scene))
        assert found is not None
        assert found.scattering is not None
        told: Line = {"determined": found.identifiable, "verdict": "", "beyond": found.beyond}
        intervals, scattering = normal(found.medium, found.covariance), found.scattering
        medium, covariance = found.medium, found.covariance
    else:
        one = tankrig.estimate(image, plain, *known, noise=noise, phase=asked)  # type: ignore[arg-type]
        assert one.scattering is not None
        told = {"determined": one.identifiable, "verdict": one.verdict}
        intervals, scattering = one.interval(0.95), one.scattering
        medium, covariance = one.medium, one.covariance
    cpu_s = time.process_time() - began
    line = compared(medium, covariance, scattering, inside_of(intervals, truth), truth, CONE_DEG.get(liquid, 0.0))
    return {"name": scene_file.stem, "liquid": liquid, "gain": gain, "mode": mode, "seed": seed, "cpu_s": cpu_s} | (
        told | line
    )


def fitted_doses(folder: Path, liquid: str, gain: str, seed: int) -> Line:
    """All images of a liquid by three beams as one dilution series in clear water; a dose of 1 ml gives .01 per mm."""
    files = sorted(one for one in folder.glob(f"{liquid}-0.0??.toml"))
    scenes = [tankrig.load_scene(one) for one in files]
    seen = [observed(one.with_suffix(".npz"), seed + 10 * k, NOISE) for k, one in enumerate(files)]
    phase = scenes[0].medium.phase_function
    doses = [scene.medium.sigma_s / 0.01 for scene in scenes]
    truth = Medium(scenes[0].medium.sigma_a / doses[0], 0.01, phase=phase)
    asked: str | PhaseFunction = phase if isinstance(phase, Mie) else "any"
    began = time.process_time()
    found = tankrig.estimate_series(
        [one for one, _ in seen], [replace(one, medium=Medium(0.0, 0.0, 0.0)) for one in scenes], doses,
        gain=1.0 if gain == "known" else "free", offset=0.0 if gain == "known" else "free",
        noise=[one for _, one in seen], phase=asked,
    )  # fmt: skip
    cpu_s = time.process_time() - began
    assert found.scattering is not None
    inside = inside_of(normal(found.ink, found.covariance), truth)
    told = {"determined": found.identifiable, "verdict": found.verdict, "cpu_s": cpu_s}
    line = compared(found.ink, found.covariance, found.scattering, inside, truth, CONE_DEG.get(liquid, 0.0))
    return {"name": liquid, "liquid": liquid, "gain": gain, "mode": "doses", "seed": seed} | told | line


def near(one: Line, which: int, share: float) -> bool:
    """Whether a value is within a share (of g: that much) or two standard deviations of the truth."""
    return bool(abs(one["off"][which]) <= max(share, 2.0 * one["sd"][which]))


def p_near(one: Line) -> bool:
    """Whether p(80 … 100°) is within 3 % or two standard deviations."""
    rows = zip(one["angle_deg"], one["ln_p_off"], one["ln_p_sd"], strict=True)
    return all(abs(off) <= max(math.log(1.03), 2.0 * sd) for angle, off, sd in rows if 80.0 <= angle <= 100.0)


def banded(lines: list[Line]) -> float:
    """Share of the angles elsewhere whose band of 95 % holds p."""
    held = [
        yes
        for one in lines
        for angle, yes in zip(one["angle_deg"], one["in_band"], strict=True)
        if not 80.0 <= angle <= 100.0
    ]
    return float(np.mean(held))


def summary(mode: str, lines: list[Line]) -> str:
    """What the fits of a mode must keep, and how many do."""
    z, inside = np.array([one["z"] for one in lines]), np.array([one["inside"] for one in lines])
    beyond_sd = 2.5 if mode == "hg" else 3.0
    bold = [one["name"] for one in lines if one["determined"]["sigma_s"] and abs(one["z"][1]) > beyond_sd]
    share = {"label": 0.015, "doses": 0.015}.get(mode, 0.03)
    cpu_s = np.array([one["cpu_s"] for one in lines])
    count = inside.size
    said = [
        f"N = {len(lines)}: rms z {np.sqrt(np.mean(z**2)):.2f} (σs {np.sqrt(np.mean(z[:, 1] ** 2)):.2f}), inside 95 % "
        f"{inside.mean():.1%} (3 binomial sd: {100 * 3 * math.sqrt(0.0475 / count):.1f} %)",
        f"σs within {share:.1%} or 2 sd {sum(near(one, 1, share) for one in lines)}, determined "
        f"{sum(one['determined']['sigma_s'] for one in lines)}, beyond {beyond_sd} sd and determined {len(bold)} "
        f"{' '.join(bold)}",
        f"mean cosine within .015 or 2 sd {sum(near(one, 2, 0.015) for one in lines)}",
        f"p(80 … 100°) within 3 % or 2 sd {sum(p_near(one) for one in lines)}, band elsewhere {banded(lines):.0%}",
        f"CPU seconds {np.median(cpu_s):.0f} (median), {cpu_s.max():.0f} (worst)",
    ]
    beads = [one["diameter"] for one in lines if one["diameter"]]
    if beads:
        right = [abs(found - true) <= max(0.003 * true, 2.0 * sd) for found, sd, true in beads]
        said.append(f"diameter within .3 % or 2 sd {sum(right)} of {len(beads)}")
    return f"{mode}: " + "; ".join(said)


def main() -> None:
    """What the command line asks for."""
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("folder", type=Path)
    given.add_argument("results", type=Path)
    given.add_argument("--mode", nargs="+", choices=MODES, default=["family", "default", "label", "hg"])
    given.add_argument("--gain", choices=("known", "free", "both"), default="both")
    given.add_argument("--seeds", default="0", help="one, or the first and the last with a dash between")
    given.add_argument("--only", default="", help="what names must contain")
    given.add_argument("--limit", type=int, default=1_000_000, help="fits to add at most")
    given.add_argument("--summary", action="store_true", help="fit nothing")
    options = given.parse_args()
    lines = [json.loads(line) for line in options.results.read_text().splitlines()] if options.results.exists() else []
    done = {(one["name"], one["gain"], one["mode"], one["seed"]) for one in lines}
    first, _, last = options.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    gains = ("known", "free") if options.gain == "both" else (options.gain,)
    files = [one for one in sorted(options.folder.glob("*.toml")) if one.with_suffix(".npz").exists()]
    names = {one.stem for one in files}
    wanted = []
    for mode in options.mode:
        of_mode = [name for name in sorted(names) if not name.endswith("-sheet")]
        if mode == "label":
            of_mode = [name for name in of_mode if name.startswith("bead")]
        if mode == "sheet":
            of_mode = [name for name in of_mode if f"{name}-sheet" in names]
        if mode == "doses":
            of_mode = sorted({name.split("-0.0")[0] for name in of_mode})
            of_mode = [one for one in of_mode if len(list(options.folder.glob(f"{one}-0.0??.toml"))) >= 5]
        chosen = [name for name in of_mode if options.only in name]
        wanted += [
            (name, gain, mode, seed) for seed in seeds for name in chosen for gain in gains
        ]  # fmt: skip
    for name, gain, mode, seed in [one for one in wanted if one not in done and not options.summary][: options.limit]:
        scene_file = options.folder / f"{name}.toml"
        line = (
            fitted_doses(options.folder, name, gain, seed)
            if mode == "doses"
            else fitted(scene_file, gain, mode, seed)
        )  # fmt: skip
        lines.append(line)
        with options.results.open("a") as file:
            file.write(json.dumps(line) + "\n")
        off, sd, known = line["off"], line["sd"], [name for name, yes in line["determined"].items() if yes]
        print(
            f"{mode} {name} {gain} {seed}: "
            f"σs {100 * off[1]:+.2f} ± {100 * sd[1]:.2f} %, g {off[2]:+.4f} ± {sd[2]:.4f}, "
            f"σa {100 * off[0]:+.1f} ± {100 * sd[0]:.1f} %, determined {known}, "
            f"{line['diameter']}, {line['families']}, {line['cpu_s']:.0f} s; {line['verdict']}",
            flush=True,
        )
    for mode in MODES:
        of_mode = [one for one in lines if one["mode"] == mode]
        if of_mode:
            print(summary(mode, of_mode))


if __name__ == "__main__":
    main()
