"""What fits of a run find, typed, and as the `fit` lines of its journal: the only place where the two meet."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from dataclasses import fields as dataclass_fields
from typing import Any

from tankrig.estimation.coordinates import NAMES
from tankrig.estimation.ink_blocks import in_tank
from tankrig.estimation.phase_result import Scattering
from tankrig.estimation.result import DOUBTED, Linearity
from tankrig.scene import Medium
from tankrig.scene.phase_fields import phase_fields, phase_from_fields

Fields = dict[str, Any]

FIRST_LOOK = "first look"
"""The model of nearly all media, of one pattern; its fits are told and not recorded."""


@dataclass(frozen=True)
class SingleScattering:
    """What light scattered once would say: the extinction that fits best, 1/mm, and the RMSE that is left."""

    sigma_t: float
    rmse: float


@dataclass(frozen=True)
class PhaseFound:
    """What a fit found of how the liquid scatters, beside its coefficients.

    Parameters
    ----------
    angle_deg, value, sd
        The phase function: p in 1/sr at scattering angles, and the standard deviation of ln p.
    at_right_angle, reduced, outside_cone
        σs p(90°), σs (1 − mean cosine), and σs of what is scattered by more than
        `tankrig.estimation.phase_families.CONE_DEG`, each with its standard deviation; the last None in journals older
        than it.
    parameters
        What the family describes p by, as name: (value, standard deviation).
    families
        How much of the answer each family has.
    """

    angle_deg: tuple[float, ...]
    value: tuple[float, ...]
    sd: tuple[float, ...]
    at_right_angle: tuple[float, float]
    reduced: tuple[float, float]
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    families: Mapping[str, float] = field(default_factory=dict)
    outside_cone: tuple[float, float] | None = None

    @classmethod
    def of(cls, found: Scattering | None) -> "PhaseFound | None":
        """Of an estimate; None of Henyey–Greenstein's, of which the coefficients say all."""
        if found is None or found.liquid.phase is None:
            return None
        curve = found.curve
        return cls(
            tuple(curve.angle_deg.tolist()), tuple(curve.value.tolist()), tuple(curve.sd.tolist()),
            found.at_right_angle, found.reduced, dict(found.parameters), dict(found.families), found.outside_cone,
        )  # fmt: skip

    @classmethod
    def from_fields(cls, fields: Mapping[str, Any]) -> "PhaseFound":
        """As a journal's line has it."""
        known = {name: tuple(fields[name]) for name in ("angle_deg", "value", "sd", "at_right_angle", "reduced")}
        parameters = {name: (value, sd) for name, (value, sd) in fields.get("parameters", {}).items()}
        outside = fields.get("outside_cone")
        return cls(
            **known, parameters=parameters, families=dict(fields.get("families", {})),
            outside_cone=None if outside is None else tuple(outside),
        )  # fmt: skip


@dataclass(frozen=True)
class DoseFit:
    """One dose's liquid.

    Parameters
    ----------
    dose_ml, dose_sd_ml
        Ink in the tank.
    medium, sd
        Fitted, and standard deviations of σa, σs, g.
    identifiable
        Which of "sigma_a", "sigma_s", "g" are determined.
    gain, rmse
        Counts per ms and radiance; what is left, counts per ms.
    frames, left_out, not_seen
        Fitted; left out because the ink had not mixed; and that the live fit could not take in.
    patterns
        Names.
    model
        "tank" or "prepared"; of passing fits `FIRST_LOOK` too.
    seconds
        That it took.
    model_error
        Of prepared models, relative L2, as counted; None where not known.
    single
        Single scattering beside it; None where it has not been fitted.
    newest
        Number of the newest frame, as the run counts them; −1: of another dose.
    passing
        Whether another fit of the same frames is to come, which lacks nothing.
    structure
        Of what is left, relative L2, beyond what noise and the model's own error explain; None where there is none.
    scattering
        How it scatters, where another phase function than Henyey–Greenstein's was fitted.
    astray
        Value and standard deviation of what nobody has measured and was fitted along: halo and veil of the camera's
        lens, reflectance of the floor.
    order_one
        A sentence where order 1, separated without a model, disagrees with the fit; empty where it agrees, or where the
        dose was not separated.
    first
        Whether it is by a first model of a pattern, and another fit was to come.
    """

    dose_ml: float
    medium: Medium
    sd: tuple[float, ...] = ()
    identifiable: Mapping[str, bool] = field(default_factory=dict)
    gain: float = 1.0
    rmse: float = 0.0
    frames: int = 0
    patterns: tuple[str, ...] = ()
    model: str = "tank"
    seconds: float = 0.0
    dose_sd_ml: float = 0.0
    model_error: float | None = None
    single: SingleScattering | None = None
    left_out: int = 0
    newest: int | None = None
    passing: bool = False
    not_seen: int = 0
    structure: float | None = None
    scattering: PhaseFound | None = None
    astray: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    order_one: str = ""
    first: bool = False

    @property
    def rough(self) -> bool:
        """Whether it is by first models, or saw a floor's light by few paths, and another one was to come."""
        return self.first or (self.single is None and "floor" in self.astray)

    @property
    def doubted(self) -> bool:
        """Whether it is by Henyey–Greenstein's phase function, which leaves so much that the ink may have another."""
        return self.scattering is None and self.structure is not None and self.structure > DOUBTED


@dataclass(frozen=True)
class SeriesFit:
    """Ink and water, from all doses.

    Parameters
    ----------
    doses_ml
        Rising.
    ink, water
        Per mm and ml; what the tank holds without ink.
    sd
        Standard deviations of the ink's σa, σs, g, and the water's σa.
    gain, rmse
        Common gain; what is left of each photograph.
    linearity
        Whether the ink acts in proportion to its dose; None where that was not tested.
    verdict
        In sentences.
    seconds
        That it took.
    identifiable, covariance, patterns
        As in a `SeriesEstimate`; names of the patterns of the photographs.
    scattering
        How the ink scatters, per ml, where another phase function than Henyey–Greenstein's was fitted.
    astray
        As in a `DoseFit`, the same at all doses.
    doubted
        Whether Henyey–Greenstein's was fitted and leaves so much that the ink may well have another phase function.
    """

    doses_ml: tuple[float, ...]
    ink: Medium
    water: Medium
    sd: tuple[float, ...] = ()
    gain: float = 1.0
    rmse: tuple[float, ...] = ()
    linearity: Linearity | None = None
    verdict: str = ""
    seconds: float = 0.0
    identifiable: Mapping[str, bool] = field(default_factory=dict)
    covariance: tuple[tuple[float, ...], ...] = ()
    patterns: tuple[str, ...] = ()
    scattering: PhaseFound | None = None
    astray: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    doubted: bool = False

    def at(self, dose_ml: float) -> Medium:
        """The liquid at a dose."""
        return in_tank(self.ink, self.water.sigma_a, dose_ml)


@dataclass(frozen=True)
class FailedFit:
    """A fit that could not be made: of which dose, or None of the series; why; the newest frame, as in `DoseFit`."""

    dose_ml: float | None
    error: str
    newest: int | None = None


Fit = DoseFit | SeriesFit | FailedFit


def diluted(liquid: Medium, from_ml: float, to_ml: float) -> Medium:
    """About what a liquid with `from_ml` of ink would be with `to_ml`."""
    grown = to_ml / from_ml
    return replace(liquid, sigma_a=liquid.sigma_a * grown, sigma_s=liquid.sigma_s * grown)


def to_fields(fit: Fit) -> Fields:
    """Fields of the journal's line; what is not known is not written.

    Examples
    --------
    >>> to_fields(FailedFit(0.4, "too dark"))
    {'fit': 'dose', 'dose_ml': 0.4, 'error': 'too dark'}
    """
    if isinstance(fit, FailedFit):
        of = {"fit": "series"} if fit.dose_ml is None else {"fit": "dose", "dose_ml": fit.dose_ml}
        return {**of, "error": fit.error} | ({} if fit.newest is None else {"newest": fit.newest})
    found: Fields = {name: list(value) if isinstance(value, tuple) else value for name, value in vars(fit).items()}
    scattering = found.pop("scattering")
    liquid = fit.medium if isinstance(fit, DoseFit) else fit.ink
    if liquid.phase is not None:
        found |= {"phase": phase_fields(liquid.phase), "scattering": scattering and asdict(scattering)}
    if isinstance(fit, SeriesFit):
        found |= {"ink": _coefficients(fit.ink), "covariance": [list(row) for row in fit.covariance]}
        found |= {"water_sigma_a": found.pop("water").sigma_a, "linearity": fit.linearity and asdict(fit.linearity)}
        return {"fit": "series", **found}
    found |= {**_coefficients(found.pop("medium")), "single": fit.single and asdict(fit.single)}
    unknown: Fields = {"model_error": None, "single": None, "structure": None, "newest": None, "passing": False}
    unknown |= {"order_one": "", "astray": {}}
    return {"fit": "dose"} | {
        name: value for name, value in found.items() if name not in unknown or value != unknown[name]
    }


def _coefficients(medium: Medium) -> Fields:
    """What earlier versions read of a liquid, whose g is the mean cosine; `phase` beside it says more."""
    return dict(zip(NAMES, medium.coefficients, strict=True))


def from_fields(fields: Mapping[str, Any]) -> Fit:
    """What a journal's line says; lines of earlier versions lack some of it, and those of later ones may hold more.

    Examples
    --------
    >>> from_fields({"fit": "dose", "dose_ml": 0.4, "error": "too dark"})
    FailedFit(dose_ml=0.4, error='too dark', newest=None)
    """
    of_dose = fields["fit"] == "dose"
    if "error" in fields:
        return FailedFit(fields.get("dose_ml"), fields["error"], fields.get("newest"))
    given: Fields = {name: tuple(value) if isinstance(value, list | tuple) else value for name, value in fields.items()}
    phase, scattering = given.get("phase"), given.get("scattering")
    given["scattering"] = scattering and PhaseFound.from_fields(scattering)
    given["astray"] = {name: (value, sd) for name, (value, sd) in given.get("astray", {}).items()}
    if of_dose:
        single = given.get("single")
        given["medium"] = _liquid(given, phase)
        given["single"] = None if single is None else SingleScattering(**single)
        return DoseFit(**{one.name: given[one.name] for one in dataclass_fields(DoseFit) if one.name in given})
    bend = given.get("linearity")
    given["ink"], given["water"] = _liquid(given["ink"], phase), Medium(given["water_sigma_a"], 0.0, 0.0)
    given["linearity"] = None if bend is None else Linearity(**bend)
    given["covariance"] = tuple(tuple(row) for row in given.get("covariance", ()))
    return SeriesFit(**{one.name: given[one.name] for one in dataclass_fields(SeriesFit) if one.name in given})


def _liquid(given: Mapping[str, Any], phase: Mapping[str, Any] | None) -> Medium:
    if phase is None:
        return Medium(*(given[name] for name in NAMES))
    return Medium(given["sigma_a"], given["sigma_s"], phase=phase_from_fields(phase))


def last_of_each(fits: Iterable[Fit]) -> list[Fit]:
    """What counts of a run's fits: the last of each dose and the last of the series, in the order they were made.

    A dose is fitted without single scattering first, and again with it. A failure stands for a dose, or for the
    series, that has no fit.

    Examples
    --------
    >>> last_of_each([FailedFit(0.1, "too dark"), FailedFit(0.4, "too dark"), FailedFit(0.1, "no light")])
    [FailedFit(dose_ml=0.4, error='too dark', newest=None), FailedFit(dose_ml=0.1, error='no light', newest=None)]
    """
    last: dict[float | None, Fit] = {}
    for fit in fits:
        dose_ml = None if isinstance(fit, SeriesFit) else fit.dose_ml
        before = last.get(dose_ml)
        if before is None or isinstance(before, FailedFit) or not isinstance(fit, FailedFit):
            last.pop(dose_ml, None)
            last[dose_ml] = fit
    return list(last.values())


def fits_in(lines: Sequence[Mapping[str, Any]]) -> tuple[list[DoseFit], SeriesFit | None]:
    """The last fit of each dose that was recorded, by dose, and the last of the series."""
    fits = [from_fields(line) for line in lines]
    doses = {one.dose_ml: one for one in fits if isinstance(one, DoseFit)}
    series = next((one for one in reversed(fits) if isinstance(one, SeriesFit)), None)
    return [doses[dose_ml] for dose_ml in sorted(doses)], series
