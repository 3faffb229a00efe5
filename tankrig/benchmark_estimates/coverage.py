"""How often 95 % intervals hold the truth, over random liquids."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.benchmark_estimates.records import Records
from tankrig.benchmark_estimates.scenes import NOISE, RANDOM, STRIPES, other_paths, random_media
from tankrig.benchmark_estimates.section import Cell, Section
from tankrig.estimation.coordinates import NAMES
from tankrig.estimation.estimate import fit_models
from tankrig.estimation.forward import models_of
from tankrig.estimation.observation import observe
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.versions import Models
from tankrig.image.prepare import Prepared
from tankrig.prediction import Prediction
from tankrig.scene import Medium

Array = NDArray[np.float64]

COVERED = (0.93, 0.97)


def coverage_section(records: Records, prepared: Prepared, media: int, draws: int) -> Section:
    """Truth from the model itself, which tells about noise alone, and from other light paths."""
    found = []
    for truth in ("the model itself", "other light paths"):
        for gain in ("known", "free"):
            key = f"coverage/{truth.replace(' ', '-')}-{gain}-{media}x{draws}"
            found.append(records.numbers(key, partial(_covered, records, prepared, truth, gain, media, draws)))
    about = (
        f"{media} random liquids (at most σt {_text(RANDOM.sigma_t)}, ϖ {_text(RANDOM.albedo)}, g "
        f"{_text(RANDOM.g)}), {draws} noise draws of 0.2 % of the peak each, fitted with the prepared model. "
        "Bound: 93 … 97 %. Where the truth is the model itself the intervals count the camera's noise alone; "
        "where it comes from other light paths they count the prepared model's own stated error too, and are as "
        "wide as that statement is cautious. Error is the RMS in standard deviations; it would be 1."
    )
    return Section(
        "Coverage of 95 % intervals",
        about,
        ("truth", "gain", "σa", "σs", "g", "all", "error of σa", "σs", "g", "failed"),
        tuple(_row(one) for one in found),
        "; ".join(f"{one['truth']}, gain {one['gain']}: {100 * _all(one):.1f} %" for one in found) + ".",
        found,
    )


def _text(ends: tuple[float, float]) -> str:
    return f"{ends[0]} … {ends[1]}"


def _all(one: dict[str, Any]) -> float:
    return float(np.mean(list(one["covered"].values())))


def _row(one: dict[str, Any]) -> tuple[Cell, ...]:
    low, high = COVERED
    shares = [*(one["covered"][name] for name in NAMES), _all(one)]
    covered = [Cell(f"{100 * share:.1f} %", low <= share <= high) for share in shares]
    errors = [Cell(f"{one['rms'][name]:.2f}") for name in NAMES]
    return Cell(one["truth"]), Cell(one["gain"]), *covered, *errors, Cell(str(one["failed"]))


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
