"""Draw the paper's figures from the reference images and print the tables that go with them.

    python docs/figures/paper.py [--cases tests/data/reference] [--out docs/figures]

Every estimate is of a reference image with noise of 0.2 % of its peak, gain and offset known.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from tankrig.estimation.estimate import Estimate
from tankrig.figures.paper import Observed, collimated_cases, fitted, observed, paper_figures, rebuilt
from tankrig.scene.phase import phase_function

ROOT = Path(__file__).parents[2]
HEADINGS = (
    *("case", "σt /mm", "g", "error of σa", "of σs", "of g", "each in sd", "RMSE/noise", "s"),
    *("σs by order 1", "σt by it"),
)


def main() -> None:
    """Fit every collimated case, then print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=Path, default=ROOT / "tests" / "data" / "reference")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "figures")
    parser.add_argument("--thin", default="pub08")
    parser.add_argument("--dense", default="pub04")
    parser.add_argument("--only", nargs="*", help="names of the cases to fit; default: all")
    parser.add_argument("--gain-free", action="store_true", help="estimate gain and offset too")
    arguments = parser.parse_args()
    console = Console(width=150)
    estimates = Table(title="Estimates from reference images", box=None)
    for heading in HEADINGS:
        estimates.add_column(heading, justify="right")
    fits: dict[str, tuple[Observed, Estimate]] = {}
    for case in collimated_cases(arguments.cases):
        if arguments.only and case.stem not in arguments.only:
            continue
        one = observed(case)
        started = time.perf_counter()
        fit = fitted(one, gain_known=not arguments.gain_free)
        seconds = time.perf_counter() - started
        single = fitted(one, "single", gain_known=not arguments.gain_free)
        fits[one.name] = one, fit
        row = _row(one, fit, single, seconds)
        console.print("  ".join(row), style="dim")
        estimates.add_row(*row)
    console.print(estimates)
    orders = Table(title="RMSE (% of peak) by orders of scattering, at one medium, gain and offset", box=None)
    for heading in ("case", "1", "1–3", "1–20", "all", "noise"):
        orders.add_column(heading, justify="right")
    for one, fit in fits.values():
        peak = float(one.image.max())
        orders.add_row(one.name, *(f"{100 * part.rmse / peak:.3f}" for part in rebuilt(one, fit)), "0.200")
    console.print(orders)
    dense, thin = fits[arguments.dense], fits[arguments.thin]
    for file in paper_figures(dense[0], thin[0], (dense[1], thin[1]), arguments.out):
        console.print(f"written {file}")


def _row(one: Observed, fit: Estimate, single: Estimate, seconds: float) -> list[str]:
    truth, found, name = one.scene.medium, fit.medium, one.name
    off = (found.sigma_a - truth.sigma_a, found.sigma_s - truth.sigma_s, found.g - truth.g)
    # One order at right angles tells σs only through σs·p(90°), so g is taken to be right there.
    single_sigma_s = single.medium.sigma_s * _sideways(single.medium.g) / _sideways(truth.g)
    in_sd = "/".join(f"{error / fit.covariance[k, k] ** 0.5:+.1f}" for k, error in enumerate(off))
    return [
        name, f"{truth.sigma_t:g}", f"{truth.g:g}", f"{off[0] / truth.sigma_a:+.1%}", f"{off[1] / truth.sigma_s:+.2%}",
        f"{off[2]:+.4f}", in_sd, f"{fit.rmse / one.noise:.2f}", f"{seconds:.1f}",
        f"{single_sigma_s / truth.sigma_s - 1.0:+.0%}", f"{single.medium.sigma_t / truth.sigma_t - 1.0:+.0%}",
    ]  # fmt: skip


def _sideways(g: float) -> float:
    """Phase function at right angles."""
    return float(phase_function(np.zeros(1), g)[0])


if __name__ == "__main__":
    main()
