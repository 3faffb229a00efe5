"""Two independent truths of random scenes, by a program that knows nothing of tankrig.

    python tests/wide_truths.py FOLDER --program TRUTH.py [--seed N] [--scenes 0-99] [--noise .01] [--limit-s 120]

TRUTH.py is run as `python TRUTH.py SCENE.toml OUT.npz` with options for photons, noise, seconds and a seed; it writes
`total`, `stderr`, the order classes and `metadata`. FOLDER gets NAME.toml and NAME.npz, for `tankrig benchmark --wide`
and `tests/fits_wide.py`. What is there is not made again. On two busy cores a hundred scenes took forty minutes.
"""

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from tankrig.benchmark.wide import wide_scene
from tankrig.scene.writing import scene_text

ORDER_1_POINTS = 3e7
"""Points that order 1 is computed from: with 3e6 both truths of a thin scene were off alike by .8 % of the image. To be
told from predictions at .1 % it takes 1e9."""


def made(scene_file: Path, seed: int, options: argparse.Namespace) -> tuple[dict[str, np.ndarray[Any, Any]], Any]:
    """One truth: its arrays and what the program tells about it."""
    out = scene_file.with_name(f".{scene_file.stem}-{seed}.npz")
    subprocess.run(
        [
            sys.executable, str(options.program), str(scene_file), str(out), "--n", "1e10",
            "--n1", str(options.order_1_points), "--batches", "20000", "--target", str(options.noise),
            "--maxtime", str(options.limit_s), "--threads", "1", "--seed", str(seed),
        ],
        check=True,
    )  # fmt: skip
    with np.load(out) as data:
        arrays = {name: data[name] for name in data.files if name != "metadata"}
        told = json.loads(str(data["metadata"]))
    out.unlink()
    return arrays, told


def main() -> None:
    """What the command line asks for."""
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("folder", type=Path)
    given.add_argument("--program", type=Path, required=True)
    given.add_argument("--seed", type=int, default=20261123)
    given.add_argument("--scenes", default="0-99")
    given.add_argument("--noise", type=float, default=0.01, help="relative L2 of each truth")
    given.add_argument("--order-1-points", type=float, default=ORDER_1_POINTS)
    given.add_argument("--limit-s", type=float, default=120.0, help="of each truth")
    options = given.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    first, last = map(int, options.scenes.split("-"))
    for number in range(first, last + 1):
        wide = wide_scene(number, options.seed)
        scene_file, whole = (options.folder / f"{wide.name}{suffix}" for suffix in (".toml", ".npz"))
        if whole.exists():
            continue
        scene_file.write_text(scene_text(wide.scene), encoding="utf-8")
        arrays, one = made(scene_file, 1000 * number + 1, options)
        again, other = made(scene_file, 1000 * number + 2, options)
        spent = {
            "cpu_seconds": 0.5 * (one["cpu_seconds"] + other["cpu_seconds"]),
            "l2_noise": math.sqrt(0.5 * (one["l2_noise"] ** 2 + other["l2_noise"] ** 2)),
        }
        unfinished = whole.with_name(f".{whole.name}")
        both = arrays | {f"{name}_2": values for name, values in again.items()}
        np.savez_compressed(unfinished, **both, metadata=np.array(json.dumps(spent)))  # type: ignore[arg-type]
        unfinished.replace(whole)


if __name__ == "__main__":
    main()
