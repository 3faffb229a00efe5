"""What a run's separated sheets tell, in numbers and in words; what they say of its fits, and where fits can begin."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from tankrig.errors import ImageError
from tankrig.light.single import single_scattering
from tankrig.live.formatting import with_error
from tankrig.live.recorded import wave_names
from tankrig.live.results import DoseFit, SeriesFit
from tankrig.run.reading import Run
from tankrig.scene.description import Interval, Medium, Scene
from tankrig.separation.expected import Agreement, agreement, sheet_scene
from tankrig.separation.order_one import OrderOne
from tankrig.separation.order_one_fit import KNOWN_SLOPE_SD, THIN, OrderOneFit, fit_order_one, slope_of
from tankrig.separation.recorded import SAME_ML, Separation, separations_of_run
from tankrig.separation.transfer import LIQUID

SURE = 3.0
"""Standard deviations that order 1 has to be above 0 by before its decay is looked at."""


@dataclass(frozen=True)
class Told:
    """Of one sheet at one dose.

    Parameters
    ----------
    dose_ml, z_mm
        Which.
    follow
        Part of the sheet's light that follows each wave, by period in mm.
    order_1
        Part of it that is order 1, and its standard deviation; None where it cannot be told.
    alone
        What order 1 alone says of the liquid; None where it is lost in its own uncertainty.
    over_fit
        Order 1 over that of the fitted liquid; None where the dose is not fitted.
    doubts
        Sentences.
    """

    dose_ml: float
    z_mm: Interval
    follow: dict[float, float] = field(default_factory=dict)
    order_1: tuple[float, float] | None = None
    alone: OrderOneFit | None = None
    over_fit: Agreement | None = None
    doubts: tuple[str, ...] = ()

    @property
    def height_mm(self) -> float:
        """Middle of the sheet."""
        return 0.5 * (self.z_mm[0] + self.z_mm[1])

    @property
    def sigma_t(self) -> tuple[float, float] | None:
        """1/mm, by how order 1 decays, and its standard deviation; None where that cannot be told."""
        return None if self.alone is None else (self.alone.sigma_t, self.alone.sigma_t_sd)

    @property
    def thin(self) -> bool:
        """Whether most of the light is order 1, so that it is a fit of its own, without a model of the rest."""
        return self.alone is not None and self.order_1 is not None and self.order_1[0] > THIN

    @property
    def sentence(self) -> str:
        """In words.

        >>> import numpy as np
        >>> alone = OrderOneFit(0.00094, 0.1, 1.2, np.diag([0.0, 0.0213**2, 0.1]), (0.0, 0.0))
        >>> Told(0.2, (58.0, 62.0), order_1=(0.474, 0.002), alone=alone).sentence
        '0.2 ml, z = 60 mm: 47.40 ± 0.20 % of the light is order 1, σt 0.000940 ± 0.000020 /mm by its decay.'
        """
        words = []
        if self.order_1 is not None:
            words.append(f"{with_error(*(100.0 * one for one in self.order_1))} % of the light is order 1")
        if self.sigma_t is not None:
            words.append(f"σt {with_error(*self.sigma_t)} /mm by its decay")
        if self.over_fit is not None:
            words.append(f"order 1 over the fitted liquid's {with_error(self.over_fit.ratio, self.over_fit.sd)}")
        if self.thin:
            words.append("thin enough that this is a fit by itself")
        return f"{self.dose_ml:.4g} ml, z = {self.height_mm:g} mm: {', '.join(words) or 'nothing could be told'}."

    @property
    def row(self) -> dict[str, Any]:
        """As JSON can say it; `right_angle` is gain · σs p(90°) in counts per ms and 1/(mm sr)."""
        found: dict[str, Any] = {"dose_ml": self.dose_ml, "z_mm": list(self.z_mm), "doubts": list(self.doubts)}
        found["follow"] = {f"{period_mm:g}": part for period_mm, part in self.follow.items()}
        known: dict[str, tuple[float, float] | None] = {"order_1": self.order_1, "sigma_t": self.sigma_t}
        if self.alone is not None:
            known |= {"right_angle": (self.alone.at_right_angle, self.alone.at_right_angle_sd)}
            known |= {"phase_slope": (self.alone.slope, self.alone.slope_sd)}
            found["thin"] = self.thin
        if self.over_fit is not None:
            known["over_fit"] = self.over_fit.ratio, self.over_fit.sd
        for name, one in known.items():
            if one is not None:
                found[name], found[f"{name}_sd"] = one
        return found


def told_of(one: Separation, fit: DoseFit | None = None) -> Told:
    """What a separation tells, beside the fit of its dose where there is one."""
    if not one.transfers:
        return Told(one.dose_ml, one.z_mm, doubts=one.doubts)
    lit = one.transfers[0].seen
    whole = float(one.sheet[lit].sum())
    follow = {period_mm: float(waves.modulated[lit].sum()) / whole for period_mm, waves in one.waves.items()}
    first = one.order_one
    if first is None:
        return Told(one.dose_ml, one.z_mm, follow, doubts=one.doubts)
    order_1 = _part(one, first)
    alone = fit_order_one([(first, _scene(one))], *_slope(fit)) if order_1[0] > SURE * order_1[1] else None
    beside = None if fit is None else _beside(one, first, alone, fit)
    doubts = (*one.doubts, *([beside.doubt] if beside is not None and beside.doubt else []))
    return Told(one.dose_ml, one.z_mm, follow, order_1, alone, beside, doubts)


def _part(one: Separation, first: OrderOne) -> tuple[float, float]:
    """Part of the sheet's light that is order 1, where that is known, and its standard deviation."""
    known = first.known
    part = float(one.sheet[known].sum())
    by_noise = float(first.alike * (first.noise[known] ** 2).sum()) ** 0.5
    return float(first.image[known].sum()) / part, float(by_noise**2 + first.model[known].sum() ** 2) ** 0.5 / part


def _scene(one: Separation, medium: Medium = LIQUID) -> Scene:
    return sheet_scene(one.transfers[0].wave, one.bench, one.camera, medium)


def _slope(fit: DoseFit | None) -> tuple[tuple[float, float], ...]:
    """What is believed of the phase function's slope at 90°, as `fit_order_one` takes it; nothing without a fit."""
    return () if fit is None else ((slope_of(fit.medium), KNOWN_SLOPE_SD),)


def _beside(one: Separation, first: OrderOne, alone: OrderOneFit | None, fit: DoseFit) -> Agreement:
    """Order 1 beside the fitted liquid's; what the fit is unsure of counts as well."""
    beside = agreement(first, fit.gain * single_scattering(_scene(one, fit.medium)))
    if not fit.sd:
        return beside
    absorption_sd, scattering_sd, g_sd = fit.sd
    sd = math.hypot(beside.sd, scattering_sd / fit.medium.sigma_s, _change_of_side(fit.medium.g) * g_sd)
    if alone is None:
        return replace(beside, sd=sd)
    of_liquid = fit.medium.sigma_t, absorption_sd + scattering_sd  # at most: nobody has kept how they go together
    return Agreement(beside.ratio, sd, (alone.sigma_t, alone.sigma_t_sd), of_liquid)


def _change_of_side(g: float) -> float:
    """|d ln p(90°)/dg| of Henyey and Greenstein's phase function.

    >>> round(_change_of_side(0.8), 2)
    5.91
    """
    return abs(2.0 * g / (1.0 - g**2) + 3.0 * g / (1.0 + g**2))


@dataclass(frozen=True)
class Separated:
    """What a run separated, for its fits.

    A sheet with a fault is no start of a fit and no witness against one: the fault itself is said instead.

    Parameters
    ----------
    sheets
        Of all doses, or of one.
    """

    sheets: Sequence[Separation] = ()

    @classmethod
    def of_run(cls, run: Run, dose_ml: float | None = None) -> "Separated":
        """Of all doses or of one; nothing where the run has no waves, or none that are complete.

        Raises
        ------
        StoreError
            When a frame cannot be read.
        """
        if not wave_names(run):
            return cls()
        try:
            return cls(separations_of_run(run, dose_ml))
        except ImageError:
            return cls()

    @cached_property
    def media(self) -> Mapping[float, tuple[Medium, ...]]:
        """Liquids that the fit of a dose can begin from, by dose in ml; see `OrderOneFit.media`."""
        found = {}
        for dose_ml in {one.dose_ml for one in self.sheets}:
            told = [(one, one.order_one) for one in self.sheets if one.dose_ml == dose_ml and not one.faults]
            parts = [(one, first, _part(one, first)) for one, first in told if first is not None]
            sure = [(first, _scene(one)) for one, first, (part, sd) in parts if part > SURE * sd]
            if sure:
                found[dose_ml] = fit_order_one(sure).media()
        return found

    def beside(self, fit: DoseFit) -> DoseFit:
        """A dose's fit with what order 1 has against it, in a sentence."""
        here = [one for one in self.sheets if abs(one.dose_ml - fit.dose_ml) < SAME_ML]
        said = [_said(one, fit) for one in here]
        return replace(fit, order_one=" ".join(filter(None, said)))

    def beside_series(self, series: SeriesFit) -> SeriesFit:
        """The same of a series, in its verdict."""
        said = []
        for one in self.sheets:
            if one.dose_ml not in series.doses_ml:
                continue
            sd = [one.dose_ml * sigma for sigma in series.sd[:2]] + [*series.sd[2:3]]
            liquid = DoseFit(one.dose_ml, series.at(one.dose_ml), tuple(sd), gain=series.gain)
            if words := _said(one, liquid):
                said.append(f"At {one.dose_ml:.4g} ml {words}")
        return replace(series, verdict=" ".join(filter(None, [series.verdict, *said])))


def _said(one: Separation, fit: DoseFit) -> str:
    """What order 1 of a sheet has against a fit, or why it says nothing: a sentence for a verdict, or nothing."""
    where = f"(sheet at z = {0.5 * sum(one.z_mm):g} mm)."
    if one.faults:
        return f"order 1 does not count, for {'; '.join(one.faults)} {where}"
    told = told_of(one, fit)
    doubt = "" if told.over_fit is None else told.over_fit.doubt
    return f"{doubt} {where}" if doubt else ""
