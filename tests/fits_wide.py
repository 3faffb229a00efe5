"""Fits of random scenes with independent truths: pooled z, coverage, the worst, and CPU time; goes on where it stopped.

    python tests/fits_wide.py FOLDER RESULTS.jsonl [--gain known|free|both] [--model tank|prepared] [--only NAME]

FOLDER holds NAME.toml and NAME.npz with `total` and `stderr`, and perhaps `total_2` and `stderr_2`, as those of
`tankrig benchmark --wide` do. RESULTS gets a line for each fit. Truths' own noise is given to the fit as the camera's.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

import tankrig

NOISE = 0.002
"""Of the camera, of the image's peak."""
SMOOTH_PIXELS = 3.0
"""Over which the truth's stated noise is averaged, which is noisy itself."""
NAMES = ("sigma_a", "sigma_s", "g")

Array = NDArray[np.float64]


def observed(path: Path, seed: int, share: float = NOISE) -> tuple[Array, Array]:
    """An image with noise, and its standard deviation, from a truth or the mean of two; the camera's is a share."""
    with np.load(path) as arrays:
        two = "total_2" in arrays
        totals = [arrays[name].astype(float) for name in (("total", "total_2") if two else ("total",))]
        errors = [arrays[name].astype(float) for name in (("stderr", "stderr_2") if two else ("stderr",))]
    truth = np.mean(totals, axis=0)
    variance = np.sum(np.square(errors), axis=0) / len(errors) ** 2
    camera = share * float(truth.max())
    image = truth + np.random.default_rng(seed).normal(0.0, camera, truth.shape)
    return image, np.sqrt(camera**2 + gaussian_filter(variance, SMOOTH_PIXELS))


def fitted(scene_file: Path, gain: str, model: str) -> dict[str, object]:
    """One fit, as a line of the results."""
    scene = tankrig.load_scene(scene_file)
    image, noise = observed(scene_file.with_suffix(".npz"), 1)
    began = time.process_time()
    known = (1.0, 0.0) if gain == "known" else ("free", "free")
    found = tankrig.estimate(image, scene, *known, noise=noise, model=model, phase="hg")
    cpu_s = time.process_time() - began
    truth = np.array(scene.medium.coefficients)
    sd = np.sqrt(np.diag(found.covariance))
    off = np.array(found.medium.coefficients) - truth
    inside = [
        bool(low <= value <= high) for value, (low, high) in zip(truth, found.interval(0.95).values(), strict=True)
    ]
    return {
        "name": scene_file.stem, "gain": gain, "model": model, "sigma_t": scene.medium.sigma_t,
        "albedo": scene.medium.albedo, "g": scene.medium.g, "off": off.tolist(), "sd": sd.tolist(),
        "z": (off / sd).tolist(), "inside": inside, "cpu_s": cpu_s, "model_error": found.model_error,
    }  # fmt: skip


def summary(lines: list[dict[str, object]]) -> str:
    """Pooled figures."""
    z, inside = np.array([one["z"] for one in lines]), np.array([one["inside"] for one in lines])
    cpu_s = np.array([one["cpu_s"] for one in lines], float)
    each = ", ".join(
        f"{name} rms z {np.sqrt(np.mean(z[:, k] ** 2)):.2f}, inside {inside[:, k].mean():.0%}"
        for k, name in enumerate(NAMES)
    )
    pooled = (
        f"rms z {np.sqrt(np.mean(z**2)):.2f}, inside {inside.mean():.1%}, worst |z| {np.abs(z).max():.1f}, "
        f"{np.mean(np.abs(z) > 3.5):.1%} above 3.5"
    )
    return f"N = {len(lines)}: {pooled}; {each}; CPU seconds {np.median(cpu_s):.1f} (median), {cpu_s.max():.1f} (worst)"


def main() -> None:
    """What the command line asks for."""
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("folder", type=Path)
    given.add_argument("results", type=Path)
    given.add_argument("--gain", choices=("known", "free", "both"), default="both")
    given.add_argument("--model", choices=("tank", "prepared"), default="tank")
    given.add_argument("--only", default="", help="what names of scenes must contain")
    given.add_argument("--limit", type=int, default=1_000_000, help="fits to add at most")
    options = given.parse_args()
    known = options.results.read_text().splitlines() if options.results.exists() else []
    lines = [json.loads(line) for line in known]
    done = {(one["name"], one["gain"], one["model"]) for one in lines}
    gains = ("known", "free") if options.gain == "both" else (options.gain,)
    for scene_file in sorted(options.folder.glob("*.toml")):
        for gain in gains:
            if options.only not in scene_file.stem:
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
