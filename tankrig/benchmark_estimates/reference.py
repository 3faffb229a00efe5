"""Reference images of an independent program with camera noise: how wrong the coefficients are."""

import math
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.estimation.estimate import Estimate
from tankrig.figures.paper import Observed, fitted, observed
from tankrig.scene import Medium

SIGMA_S, G, SIGMA_A = 0.01, 0.01, 0.05
"""Errors allowed: of σs and σa relative, of g absolute; σa may also be off by two Cramér–Rao standard deviations."""
FRESNEL = 1.5
"""Times as much under a Fresnel surface."""


def reference_section(records: Records, cases: list[Path]) -> Section:
    """Fit every case twice, with the gain known and free."""
    found = []
    for case in cases:
        one = observed(case)
        for gain in ("known", "free"):
            name = f"reference/{case.stem}-{gain}"
            found.append(records.numbers(name, partial(_fitted, one, gain == "known")))
    rows = tuple(_row(one) for one in found)
    missed = sum(any(cell.met is False for cell in row) for row in rows)
    about = (
        "Images of an independent Monte Carlo program with camera noise of 0.2 % of the peak. Bounds: σs 1 %, g "
        "0.01, σa 5 % or two Cramér–Rao standard deviations (CR sd); under a Fresnel surface 1.5 times those; "
        "with the gain free σs and g only, where the verdict says determined. ± is the estimate's own standard "
        "deviation. The reference's own noise is 0.3 … 0.5 % of the image."
    )
    return Section(
        "Reference images",
        about,
        ("case", "gain", "σs off", "±", "CR sd", "g off", "±", "CR sd", "σa off", "±", "CR sd", "determined", "CPU s"),
        rows,
        f"{len(rows) - missed} of {len(rows)} fits are within their bounds.",
        found,
    )


def _fitted(one: Observed, gain_known: bool) -> dict[str, Any]:
    started = time.process_time()
    fit = fitted(one, gain_known=gain_known)
    return {
        "case": one.name, "gain": "known" if gain_known else "free", "fresnel": one.scene.tank.surface == "fresnel",
        "truth": asdict(one.scene.medium), "found": asdict(fit.medium), "sd": np.sqrt(np.diag(fit.covariance)).tolist(),
        "cramer_rao": cramer_rao(fit, one, gain_known), "determined": fit.identifiable, "verdict": fit.verdict,
        "cpu_s": time.process_time() - started,
    }  # fmt: skip


def cramer_rao(fit: Estimate, one: Observed, gain_known: bool) -> list[float]:
    """Standard deviations that camera noise alone allows."""
    from tankrig.estimation.forward import models_of
    from tankrig.estimation.scaling import Scaling

    models = models_of(one.scene, "tank", None)
    scaling = Scaling(1.0, 0.0) if gain_known else Scaling(None, None)
    slopes = models.slopes_of(models.refined(fit.medium)[1], max(one.scene.tank.size_mm))(fit.medium)
    pixels = int(np.prod(one.image.shape))
    weight = np.full(pixels, 1.0 / one.noise)
    image = np.asarray((fit.image - fit.offset) / fit.gain, float).ravel()
    changes = scaling.project_out(fit.gain * slopes.reshape(3, -1) * weight, [image * weight], [weight])
    size = np.sqrt(np.sum(changes**2, axis=1))
    return list(np.sqrt(np.diag(np.linalg.inv(changes @ changes.T / np.outer(size, size)))) / size)


def _row(one: dict[str, Any]) -> tuple[Cell, ...]:
    truth, found = Medium(**one["truth"]), Medium(**one["found"])
    allowed = FRESNEL if one["fresnel"] else 1.0
    known, free = one["determined"], one["gain"] == "free"
    off_s = found.sigma_s / truth.sigma_s - 1.0
    off_g = found.g - truth.g
    off_a = found.sigma_a / truth.sigma_a - 1.0 if truth.sigma_a else math.inf
    least = one["cramer_rao"][0] / truth.sigma_a
    least_s, least_g = one["cramer_rao"][1] / truth.sigma_s, one["cramer_rao"][2]
    met_s = abs(off_s) <= allowed * SIGMA_S if known["sigma_s"] or not free else None
    met_g = abs(off_g) <= allowed * G if known["g"] or not free else None
    met_a = None if free else abs(off_a) <= allowed * max(SIGMA_A, 2.0 * least)
    sd_a, sd_s, sd_g = one["sd"]
    names = ", ".join(symbol for symbol, name in (("σa", "sigma_a"), ("σs", "sigma_s"), ("g", "g")) if known[name])
    return (
        Cell(one["case"]), Cell(one["gain"]),
        Cell(f"{100 * off_s:+.2f} %", met_s), Cell(f"{100 * sd_s / truth.sigma_s:.2f} %"),
        Cell(f"{100 * least_s:.2f} %"),
        Cell(f"{off_g:+.4f}", met_g), Cell(f"{sd_g:.4f}"), Cell(f"{least_g:.4f}"),
        Cell(f"{100 * off_a:+.1f} %", met_a), Cell(f"{100 * sd_a / truth.sigma_a:.1f} %"),
        Cell(f"{100 * least:.1f} %"), Cell(names or "none"), Cell(f"{one['cpu_s']:.0f}"),
    )  # fmt: skip
