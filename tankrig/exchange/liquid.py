"""A liquid to hand on: read from the numbers of a fit, from a run, or from a scene file."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tankrig.checked_toml import checked
from tankrig.errors import SceneError
from tankrig.scene.description import Medium
from tankrig.scene.loading import load_scene
from tankrig.scene.phase_functions import Tabulated

NAMES = ("sigma_a", "sigma_s", "g")
WATER_INDEX = 1.33
HENYEY_GREENSTEIN = {"hg", "henyey-greenstein"}
"""Names of families whose curve the mean cosine is enough for."""


@dataclass(frozen=True)
class Liquid:
    """A liquid, and where it is from.

    Parameters
    ----------
    medium
        σa, σs in 1/mm and the phase function.
    origin
        What it was read from, for comments in files.
    refractive_index
        Of the water.
    sd
        Standard deviations of "sigma_a", "sigma_s", "g", where they were fitted.
    undetermined
        Names of those that the fit did not determine: numbers within the fit's bounds, and no measurement.
    """

    medium: Medium
    origin: str
    refractive_index: float = WATER_INDEX
    sd: Mapping[str, float] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()

    @property
    def lines(self) -> list[str]:
        """What comments in files say of it."""
        medium = self.medium
        said = [f"liquid of {self.origin}, by tankrig"]
        for name in NAMES:
            unit = "" if name == "g" else " 1/mm"
            error = f" +- {self.sd[name]:.3g}" if self.sd.get(name) else ""
            doubt = ", not determined by the fit" if name in self.undetermined else ""
            said.append(f"{name} = {getattr(medium, name):.6g}{error}{unit}{doubt}")
        said.append(f"phase function: {medium.phase_function.kind}")
        return said


def liquid_of(path: Path, dose_ml: float | None = None) -> Liquid:
    """Read a liquid.

    Parameters
    ----------
    path
        The .json that `tankrig fit` writes or prints, the folder of a run, or a scene file (.toml).
    dose_ml
        Which dose of a run; None: the last that was fitted.

    Raises
    ------
    SceneError
        When there is no liquid in it.
    """
    if path.is_dir():
        return _of_run(path, dose_ml)
    if dose_ml is not None:
        raise SceneError(f"{path}: is no run, so it has no dose; leave --dose-ml out")
    if path.suffix == ".toml":
        scene = load_scene(path)
        return Liquid(scene.medium, path.name, scene.tank.refractive_index)
    return _of_fit(path)


def _of_fit(path: Path) -> Liquid:
    try:
        numbers: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror or error}); give a fit, a run or a scene") from error
    except ValueError as error:
        raise SceneError(f"{path}: is not JSON; give what tankrig fit --json prints, a run or a scene.toml") from error
    medium = numbers.get("medium") if isinstance(numbers, dict) else None
    if not isinstance(medium, dict):
        raise SceneError(f"{path}: holds no fitted medium; give what tankrig fit --json prints")
    given = {key: value for key, value in medium.items() if value is not None}
    if "phase" in given:
        given.pop("g", None)  # its mean cosine
    found = checked(Medium, given, f"{path}: medium", SceneError)
    curve = numbers.get("phase")
    if found.phase is None and isinstance(curve, dict) and {*curve.get("families", ("?",))} - HENYEY_GREENSTEIN:
        found = Medium(found.sigma_a, found.sigma_s, phase=_curve(curve, str(path)))
    sd = numbers.get("standard_deviation")
    known = numbers.get("identifiable")
    return Liquid(
        found,
        path.name,
        sd={} if not isinstance(sd, dict) else _finite(sd),
        undetermined=_undetermined(known) if isinstance(known, dict) else (),
    )


def _curve(curve: Mapping[str, Any], name: str) -> Tabulated:
    """The phase function that a fit gives at some angles: ln p is a cubic spline of the angle, level at both ends.

    Through Mie's of 1 µm beads at steps of 5° it is within 5 %, through those of 2 µm within 18 %.
    """
    from scipy.interpolate import CubicSpline

    try:
        angle = np.array(curve["angle_deg"], float)
        log = np.log(np.array(curve["value"], float))
        fine = np.linspace(180.0, 0.0, 1441)
        p = np.exp(CubicSpline(angle, log, bc_type="clamped")(fine))
    except (KeyError, TypeError, ValueError) as error:
        raise SceneError(f'{name}: its "phase" is no curve of angle_deg and value; fit again') from error
    cosine = np.cos(np.radians(fine))
    p /= 2.0 * math.pi * np.trapezoid(p, cosine)
    return Tabulated(tuple(cosine.tolist()), tuple(p.tolist()))


def _undetermined(known: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(name for name in NAMES if known.get(name) is False)


def _finite(sd: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in sd.items() if isinstance(value, int | float) and math.isfinite(value)}


def _of_run(path: Path, dose_ml: float | None) -> Liquid:
    from tankrig.live.recorded import fits_that_hold
    from tankrig.live.results import fits_in
    from tankrig.run.reading import open_run

    run = open_run(path)
    doses, _ = fits_in([event.fields for event in fits_that_hold(run)])
    if not doses:
        raise SceneError(f"{path}: nothing of it is fitted; run tankrig refit {path}")
    fit = doses[-1] if dose_ml is None else min(doses, key=lambda one: abs(one.dose_ml - dose_ml))
    if dose_ml is not None and abs(fit.dose_ml - dose_ml) > 0.01 * abs(dose_ml) + 1e-9:
        there = ", ".join(f"{one.dose_ml:g}" for one in doses)
        raise SceneError(f"{path}: has no fit at {dose_ml:g} ml; there is {there}")
    tank = run.settings.get("bench", {}).get("tank", {})
    index = float(tank.get("refractive_index", WATER_INDEX))
    sd = dict(zip(NAMES, fit.sd, strict=False))
    return Liquid(fit.medium, f"{path.name} at {fit.dose_ml:g} ml", index, sd, _undetermined(fit.identifiable))
