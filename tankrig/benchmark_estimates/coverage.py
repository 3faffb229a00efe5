"""How often 95 % intervals hold the truth, over random liquids."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.scenes import NOISE, RANDOM, STRIPES, other_paths, random_media
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.estimation.estimate import fit_models
from tankrig.estimation.models import Models, models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.parameters import NAMES
from tankrig.estimation.projection import Scaling
from tankrig.image.prediction import Prediction
from tankrig.image.prepare import Prepared
from tankrig.scene import Medium

Array = NDArray[np.float64]

COVERED = (0.93, 0.97)


def coverage_section(records: Records, prepared: Prepared, media: int, draws: int) -> Section:
    """Truth from the model itself, which tells about noise alone, and from other light paths, which the model misses."""
    found = []
    for truth in ("the model itself", "other light paths"):
        for gain in ("known", "free"):
            key = f"coverage/{truth.replace(' ', '-')}-{gain}-{media}x{draws}"
            found.append(records.numbers(key, lambda truth=truth, gain=gain: _covered(  # type: ignore[misc]
                records, prepared, truth, gain, media, draws
            )))  # fmt: skip
    low, high = COVERED
    rows = tuple(
        (Cell(one["truth"]), Cell(one["gain"]), *(Cell(f"{100 * one['covered'][name]:.1f} %", low <= one["covered"][name] <= high) for name in NAMES),
         Cell(f"{100 * np.mean(list(one['covered'].values())):.1f} %", low <= np.mean(list(one["covered"].values())) <= high),
         *(Cell(f"{one['rms'][name]:.2f}") for name in NAMES), Cell(str(one["failed"])))
        for one in found
    )  # fmt: skip
    return Section(
        "Coverage of 95 % intervals",
        f"{media} random liquids (at most σt {RANDOM.sigma_t[0]} … {RANDOM.sigma_t[1]}, ϖ {RANDOM.albedo[0]} … {RANDOM.albedo[1]}, g {RANDOM.g[0]} … {RANDOM.g[1]}), {draws} noise draws of 0.2 % of the peak each, "
        f"fitted with the prepared model. Bound: 93 … 97 %. Where the truth is the model itself the intervals count the camera's "
        "noise alone; where it comes from other light paths they count the prepared model's own stated error too, and with "
        "it dominating they are as wide as that statement is cautious. Error is the RMS in standard deviations; it would be 1.",
        ("truth", "gain", "σa", "σs", "g", "all", "error of σa", "σs", "g", "failed"),
        rows,
        "; ".join(
            f"{one['truth']}, gain {one['gain']}: {100 * np.mean(list(one['covered'].values())):.1f} %" for one in found
        )
        + ".",
        found,
    )


def _covered(records: Records, prepared: Prepared, truth: str, gain: str, count: int, draws: int) -> dict[str, Any]:
    scaling = Scaling(1.0, 0.0) if gain == "known" else Scaling(None, None)
    own = truth == "the model itself"
    models = _exact(prepared) if own else models_of(STRIPES, prepared, None)
    inside: dict[str, list[bool]] = {name: [] for name in NAMES}
    errors: dict[str, list[float]] = {name: [] for name in NAMES}
    failed = 0
    for index, medium in enumerate(random_media(count, prepared.box)):
        scene = replace(STRIPES, medium=medium)
        image = prepared.predict(medium) if own else other_paths(records, f"random-{index}", scene)
        noise = NOISE * float(image.max())
        for draw in range(draws):
            noisy = image + np.random.default_rng((index, draw)).normal(0.0, noise, image.shape)
            fit = fit_models(observe(noisy, image.shape, noise), STRIPES, scaling, models, _silently)
            sd = np.sqrt(np.diag(fit.covariance))
            failed += not np.isfinite(sd).all()
            for k, (name, (low, high)) in enumerate(fit.interval().items()):
                inside[name].append(low <= getattr(medium, name) <= high)
                errors[name].append((getattr(fit.medium, name) - getattr(medium, name)) / float(sd[k]))
    return {
        "truth": truth, "gain": gain, "failed": failed,
        "covered": {name: float(np.mean(one)) for name, one in inside.items()},
        "rms": {name: float(np.sqrt(np.mean(np.square(one)))) for name, one in errors.items()},
    }  # fmt: skip


def _exact(prepared: Prepared) -> Models:
    """The prepared model taken at its word: no error of its own."""
    models = models_of(STRIPES, prepared, None)

    def without_error(forward: Callable[[Medium], Prediction]) -> Callable[[Medium], Prediction]:
        return lambda medium: replace(forward(medium), skipped=())

    exact = without_error(models.coarse)
    return replace(models, coarse=exact, refine=lambda _: (exact, exact))


def _silently(_: str) -> None:
    pass
