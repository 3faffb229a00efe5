"""Fits of random scenes with independent truths: pooled z, coverage, the worst, and CPU time; goes on where it stopped.

    python tests/fits_wide.py FOLDER RESULTS.jsonl [--gain known|free|both] [--model tank|prepared|dose] [--only NAME …]

`--model prepared` prepares the whole box of media, as `tankrig prepare` does; `dose` the small one that a live run does
about what its first look has found, here some per cent off the truth.

FOLDER holds NAME.toml and NAME.npz with `total` and `stderr`, and perhaps `total_2` and `stderr_2`, as those of
`tankrig benchmark --wide` do. RESULTS gets a line for each fit. Truths' own noise is given to the fit as the camera's,
pixel by pixel, but a photon of theirs lights many pixels: what that moves coefficients by is what the two truths show
by their difference, and is counted with its root mean square over all fits.
"""

import argparse
import json
import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import tankrig
from tankrig.light.prepared.about import box_for
from tankrig.light.tangent import tank_tangent
from tankrig.live.preparing import model_for
from tankrig.scene import Medium

NOISE = 0.002
"""Of the camera, of the image's peak."""
SMOOTH_PIXELS = 3.0
"""Over which the truth's stated noise is averaged, which is noisy itself."""
LOOKED_OFF = 0.03, 0.02
"""Standard deviations of a first look's σt, of itself, and of its g."""
SLOPE_BATCHES = 24
"""Lattices of paths that tell what truths' noise does to coefficients."""
NAMED = "The residual shows", "It looks most like"
"""How a verdict begins to name a cause; scenes are as described, so that each is a false alarm."""
NAMES = ("sigma_a", "sigma_s", "g")

Array = NDArray[np.float64]


def truths(path: Path) -> tuple[list[Array], Array]:
    """One truth or two, and the variance of their mean, smooth."""
    with np.load(path) as arrays:
        two = "total_2" in arrays
        totals = [arrays[name].astype(float) for name in (("total", "total_2") if two else ("total",))]
        errors = [arrays[name].astype(float) for name in (("stderr", "stderr_2") if two else ("stderr",))]
    return totals, gaussian_filter(np.sum(np.square(errors), axis=0) / len(errors) ** 2, SMOOTH_PIXELS)


def observed(path: Path, seed: int, share: float = NOISE) -> tuple[Array, Array]:
    """An image with noise, and its standard deviation, from a truth or the mean of two; the camera's is a share."""
    totals, variance = truths(path)
    truth = np.mean(totals, axis=0)
    camera = share * float(truth.max())
    image = truth + np.random.default_rng(seed).normal(0.0, camera, truth.shape)
    return image, np.sqrt(camera**2 + variance)


def moved_by_truth(scene: tankrig.Scene, path: Path, noise: Array, gain: str) -> tuple[list[float], list[float]]:
    """What half of the difference of two truths moves σa, σs and g by, and what it would if pixels were independent."""
    totals, variance = truths(path)
    if len(totals) < 2:
        return [], []
    tangent = tank_tangent(scene, SLOPE_BATCHES, 5, blur_mm=4.0)
    weight = 1.0 / noise.ravel()
    alike = np.stack([tangent.prediction.image.ravel() * weight, weight], axis=1)
    basis = np.linalg.qr(alike if gain == "free" else alike[:, :0])[0]

    def whitened(images: Array) -> Array:
        rows = images.reshape(len(images), -1) * weight
        return rows - (rows @ basis) @ basis.T

    changes = whitened(tangent.slopes)
    products = changes @ changes.T - sum((whitened(one) @ whitened(one).T for one in tangent.noise), np.zeros((3, 3)))
    response = np.linalg.solve(products, changes)
    apart = response @ whitened(0.5 * (totals[0] - totals[1])[None])[0]
    return apart.tolist(), np.sqrt((response**2) @ (variance.ravel() * weight**2)).tolist()


def looked(scene: tankrig.Scene, name: str) -> Medium:
    """About what a first look finds."""
    random, liquid = np.random.default_rng(zlib.crc32(name.encode())), scene.medium
    sigma_t = liquid.sigma_t * float(np.exp(random.normal(0.0, LOOKED_OFF[0])))
    g = liquid.g + float(random.normal(0.0, LOOKED_OFF[1]))
    return Medium((1.0 - liquid.albedo) * sigma_t, liquid.albedo * sigma_t, g)


def fitted(scene_file: Path, gain: str, model: str) -> dict[str, Any]:
    """One fit, as a line of the results."""
    scene = tankrig.load_scene(scene_file)
    # Each fit has noise of its own: one noise for all would push fits of like scenes the same way.
    image, noise = observed(scene_file.with_suffix(".npz"), zlib.crc32(f"{scene_file.stem} {gain}".encode()))
    used = model if model != "dose" else model_for(scene, box_for(looked(scene, scene_file.name)))
    began = time.process_time()
    known = (1.0, 0.0) if gain == "known" else ("free", "free")
    found = tankrig.estimate(image, scene, *known, noise=noise, model=used, phase="hg")
    cpu_s = time.process_time() - began
    truth = np.array(scene.medium.coefficients)
    sd = np.sqrt(np.diag(found.covariance))
    off = np.array(found.medium.coefficients) - truth
    inside = [
        bool(low <= value <= high) for value, (low, high) in zip(truth, found.interval(0.95).values(), strict=True)
    ]
    moved, expected = moved_by_truth(scene, scene_file.with_suffix(".npz"), noise, gain)
    return {
        "truth_moved": moved, "truth_sd": expected,
        "name": scene_file.stem, "gain": gain, "model": model, "sigma_t": scene.medium.sigma_t,
        "albedo": scene.medium.albedo, "g": scene.medium.g, "off": off.tolist(), "sd": sd.tolist(),
        "z": (off / sd).tolist(), "inside": inside, "cpu_s": cpu_s, "model_error": found.model_error,
        "verdict": found.verdict,
    }  # fmt: skip


def spread_of(line: dict[str, Any], factor: Array) -> Array:
    """Stated standard deviations, with the truth's noise as it moves coefficients."""
    more = np.square(line["truth_sd"]) * (np.square(factor) - 1.0) if line.get("truth_sd") else np.zeros(3)
    return np.asarray(np.sqrt(np.square(line["sd"]) + more))


def false_alarms(lines: list[dict[str, Any]]) -> str:
    """How many fits name a cause, of those whose verdict was kept."""
    told = [one["verdict"] for one in lines if "verdict" in one]
    return f"{sum(any(words in one for words in NAMED) for one in told)} of {len(told)} verdicts name a cause"


def summary(lines: list[dict[str, Any]]) -> str:
    """Pooled figures."""
    told = [np.divide(one["truth_moved"], one["truth_sd"]) for one in lines if one.get("truth_sd")]
    factor = np.sqrt(np.mean(np.square(told), axis=0)) if told else np.ones(3)
    z = np.array([np.divide(one["off"], spread_of(one, factor)) for one in lines])
    cpu_s, within = np.array([one["cpu_s"] for one in lines], float), np.abs(z) < 1.96
    names = zip(NAMES, np.sqrt(np.mean(z**2, axis=0)), within.mean(axis=0), strict=True)
    return "; ".join(
        [
            f"N = {len(lines)}: rms z {np.sqrt(np.mean(z**2)):.2f}, within 1.96 sd {within.mean():.1%}",
            f"worst |z| {np.abs(z).max():.1f}, {np.mean(np.abs(z) > 3.5):.1%} above 3.5",
            *(f"{name} rms z {size:.2f}, within {share:.0%}" for name, size, share in names),
            false_alarms(lines),
            f"truths' noise moves {', '.join(f'{one:.2f}' for one in factor)} times as far as white noise",
            f"CPU seconds {np.median(cpu_s):.1f} (median), {cpu_s.max():.1f} (worst)",
        ]
    )


def main() -> None:
    """What the command line asks for."""
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("folder", type=Path)
    given.add_argument("results", type=Path)
    given.add_argument("--gain", choices=("known", "free", "both"), default="both")
    given.add_argument("--model", choices=("tank", "prepared", "dose"), default="tank")
    given.add_argument("--only", nargs="*", default=[""], help="one of which names of scenes must contain")
    given.add_argument("--limit", type=int, default=1_000_000, help="fits to add at most")
    options = given.parse_args()
    known = options.results.read_text().splitlines() if options.results.exists() else []
    lines = [json.loads(line) for line in known]
    done = {(one["name"], one["gain"], one["model"]) for one in lines}
    gains = ("known", "free") if options.gain == "both" else (options.gain,)
    for scene_file in sorted(options.folder.glob("*.toml")):
        for gain in gains:
            if not any(part in scene_file.stem for part in options.only):
                continue
            wanted = scene_file.stem, gain, options.model
            if wanted in done or not scene_file.with_suffix(".npz").exists() or options.limit <= 0:
                continue
            options.limit -= 1
            lines.append(fitted(scene_file, gain, options.model))
            with options.results.open("a") as file:
                file.write(json.dumps(lines[-1]) + "\n")
            print(json.dumps(lines[-1]), flush=True)
    if lines:
        print(summary(lines))


if __name__ == "__main__":
    main()
