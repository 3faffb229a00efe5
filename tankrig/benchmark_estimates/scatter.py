"""Many noise draws of one truth: scatter against the Cramér–Rao bound, and the bias."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.scenes import LIQUIDS, NOISE, STRIPES, monte_carlo
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.benchmark_estimates.surrogate import near
from tankrig.estimation.estimate import Estimate, estimate, fit_models
from tankrig.estimation.forward import models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.versions import Models, corrected
from tankrig.scene import Medium

Array = NDArray[np.float64]

SCATTER = 1.15
"""Times the Cramér–Rao bound that estimates may scatter."""
REACH = (8.0, np.array([0.04, 0.2, 0.04]))
"""Of the polynomial: so many standard deviations, and at least so much, in log σs, logit ϖ, atanh g."""
FULL = 2
"""Draws that are fitted with the tank model itself, to compare."""


def scatter_section(records: Records, draws: int, quick: bool) -> Section:
    """Thin, medium and thick liquids, gain known and free."""
    found = []
    for name in ("thin",) if quick else tuple(LIQUIDS):
        image, own = monte_carlo(records, name, quick)
        for gain in ("known", "free"):
            one = records.numbers(f"scatter/{name}-{gain}-{draws}", partial(_drawn, name, gain, image, draws))
            found.append({**one, "own_noise": own / NOISE})
    worst = max(max(one["scatter"]) for one in found)
    furthest = max(max(np.abs(one["bias"])) for one in found)
    about = (
        "Stripes in three liquids, images by our Monte Carlo (which shares nothing with the fitted model), "
        f"{draws} noise draws of 0.2 % of the peak each. Fits use a polynomial of second degree through 13 images "
        f"of the tank model about the first full fit; the largest difference from {FULL} full fits is given in "
        f"standard deviations. Scatter is over the Cramér–Rao bound of the camera's noise alone (bound {SCATTER}); "
        "bias is in the standard deviations that the estimate states, and in percent (of g absolute), and holds "
        "the model's error and the Monte Carlo's own noise."
    )
    headings = (
        "liquid", "gain", "", "scatter / CR", "bias, sd", "bias, %", "stated sd, %", "CR sd, %", "within 95 %",
        "full fits off by, sd", "Monte Carlo's noise / camera's",
    )  # fmt: skip
    result = f"Largest scatter {worst:.2f} times Cramér–Rao; largest bias {furthest:.1f} standard deviations."
    return Section(
        "Repeated measurements", about, headings, tuple(row for one in found for row in _rows(one)), result, found
    )


def _drawn(name: str, gain: str, image: Array, draws: int) -> dict[str, Any]:
    truth = LIQUIDS[name]
    noise = NOISE * float(image.max())
    scaling = Scaling(1.0, 0.0) if gain == "known" else Scaling(None, None)
    asked: dict[str, Any] = {"gain": 1.0, "offset": 0.0} if gain == "known" else {}

    def noisy(seed: int) -> Array:
        return image + np.random.default_rng(seed).normal(0.0, noise, image.shape)

    full = [estimate(noisy(seed), STRIPES, noise=noise, **asked) for seed in range(FULL)]
    centre = full[0].medium
    sd = np.sqrt(np.diag(full[0].covariance))
    size = np.array([centre.sigma_s, centre.sigma_a, 1.0 - centre.g**2])
    reach = np.maximum(REACH[0] * sd[[1, 0, 2]] / size, REACH[1])
    whole = models_of(STRIPES, "tank", None)
    assert whole.exact is not None
    local = near(corrected(whole.refined(centre)[1], centre, whole.exact(centre, 1)), centre, reach)
    fits = [_fit(noisy(seed), noise, scaling, local) for seed in range(draws)]
    values, true = np.array([one.medium.coefficients for one in fits]), np.array(truth.coefficients)
    stated = np.sqrt(np.mean([np.diag(one.covariance) for one in fits], axis=0))
    inside = [_inside(one, truth) for one in fits]
    apart = np.array([one.medium.coefficients for one in full]) - values[:FULL]
    bound = cramer_rao(local, truth, scaling, noise, fits[0].gain)
    return {
        "liquid": name, "gain": gain, "truth": true.tolist(), "mean": values.mean(axis=0).tolist(),
        "scatter": (values.std(axis=0, ddof=1) / bound).tolist(), "cramer_rao": bound.tolist(),
        "bias": ((values.mean(axis=0) - true) / stated).tolist(), "stated": stated.tolist(),
        "inside": np.mean(inside, axis=0).tolist(), "full_off": np.abs(apart / stated).max(axis=0).tolist(),
    }  # fmt: skip


def _fit(image: Array, noise: float, scaling: Scaling, models: Models) -> Estimate:
    return fit_models(observe(image, image.shape, noise), STRIPES, scaling, models, lambda _: None)


def _inside(one: Estimate, truth: Medium) -> list[bool]:
    return [low <= getattr(truth, name) <= high for name, (low, high) in one.interval().items()]


def cramer_rao(models: Models, medium: Medium, scaling: Scaling, noise: float, gain: float) -> Array:
    """Standard deviations of σa, σs, g that white noise in all pixels allows."""
    assert models.slopes is not None
    image = np.asarray(models.coarse(medium).image, float).ravel()
    weight = np.full(image.size, 1.0 / noise)
    changes = scaling.project_out(gain * models.slopes(medium).reshape(3, -1) * weight, [image * weight], [weight])
    size = np.linalg.norm(changes, axis=1)
    found: Array = np.sqrt(np.diag(np.linalg.inv(changes @ changes.T / np.outer(size, size)))) / size
    return found


def _rows(one: dict[str, Any]) -> list[tuple[Cell, ...]]:
    rows: list[tuple[Cell, ...]] = []
    for k, symbol in enumerate(("σa", "σs", "g")):
        size = one["truth"][k] if k < 2 else 1.0
        rows.append((
            Cell(one["liquid"]), Cell(one["gain"]), Cell(symbol),
            Cell(f"{one['scatter'][k]:.3f}", one["scatter"][k] <= SCATTER),
            Cell(f"{one['bias'][k]:+.2f}"), Cell(f"{100 * (one['mean'][k] - one['truth'][k]) / size:+.3f}"),
            Cell(f"{100 * one['stated'][k] / size:.3f}"), Cell(f"{100 * one['cramer_rao'][k] / size:.3f}"),
            Cell(f"{100 * one['inside'][k]:.1f} %"),
            Cell(f"{one['full_off'][k]:.2f}"), Cell(f"{one['own_noise']:.2f}"),
        ))  # fmt: skip
    return rows
