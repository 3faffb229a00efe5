"""What the model says of separated light beside an independent program's: `python tests/separated_truth.py OUT.jsonl`.

For thin, medium and thick ink and three periods: the part of a pixel's light that follows the wave, and the part that
does not, as `tests/data/waves` has them and as `expected_separation` says, in standard deviations of both together;
pixel by pixel, and of means over blocks of 4 × 4 pixels, in which noise is small. Each is a line of OUT, and what is
there is not computed again.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from test_separation import PERIODS, Y_MM, Z_MM, bench_of, truth_of

from tankrig.pattern import Wave
from tankrig.separation import expected_separation

LIT = slice(8, 32), slice(0, 80)
"""Rows within the sheet, away from its edges."""
BLOCK = 4


def blocks(image: np.ndarray) -> np.ndarray:
    rows, columns = (count // BLOCK * BLOCK for count in image.shape)
    whole = image[:rows, :columns].reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
    return whole.mean(axis=(1, 3))


def compared(case: str, period: float, tolerance: float) -> dict:
    bench, (waves, medium) = bench_of(case), truth_of(case)
    said = expected_separation(Wave(period, Z_MM, 0.0, Y_MM), bench, bench.camera, medium, tolerance)["all"]
    seen, turn = waves[period], np.exp(-1j * np.angle(said.wave))
    pairs = {
        "modulated": (np.real(seen.wave * turn), np.abs(said.wave), seen.wave_sd, said.wave_sd),
        "even": (
            seen.sheet - np.real(seen.wave * turn), said.sheet - np.abs(said.wave),
            np.hypot(seen.wave_sd, seen.sheet_sd), np.hypot(said.wave_sd, said.sheet_sd),
        ),
    }  # fmt: skip
    row: dict = {"case": case, "period_mm": period, "tolerance": tolerance}
    sheet = float(np.linalg.norm(seen.sheet[LIT]))
    for name, (truth, model, truth_sd, model_sd) in pairs.items():
        off, sd = (truth - model)[LIT], np.hypot(truth_sd, model_sd)[LIT]
        z = off / sd
        # Noise of both is about independent from pixel to pixel; the model's, smoothed, is counted as alike in a block.
        coarse = blocks(off) / np.hypot(
            np.sqrt(blocks(truth_sd[LIT] ** 2)) / BLOCK, np.sqrt(blocks(model_sd[LIT] ** 2))
        )
        row[name] = {
            "rms_z": float(np.sqrt(np.mean(z**2))), "within_3": float(np.mean(np.abs(z) < 3.0)),
            "blocks_rms_z": float(np.sqrt(np.mean(coarse**2))), "blocks_within_3": float(np.mean(np.abs(coarse) < 3.0)),
            "mean_off": float(off.sum() / seen.sheet[LIT].sum()), "relative_l2": float(np.linalg.norm(off)) / sheet,
        }  # fmt: skip
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--tolerance", type=float, default=0.005)
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {(row["case"], row["period_mm"]) for row in rows}
    for case in ("o-thin", "o-medium", "p-medium", "o-thick"):
        for period in PERIODS:
            if (case, period) not in done:
                rows.append(compared(case, period, options.tolerance))
                with options.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    for row in rows:
        for name in ("modulated", "even"):
            one = row[name]
            print(
                f"{row['case']:9} {row['period_mm']:3g} mm {name:9}: within 3 sd {100 * one['within_3']:.1f} % of "
                f"pixels (rms {one['rms_z']:.2f}), {100 * one['blocks_within_3']:.1f} % of blocks (rms "
                f"{one['blocks_rms_z']:.2f}); mean {100 * one['mean_off']:+.2f} % of the sheet"
            )


if __name__ == "__main__":
    main()
