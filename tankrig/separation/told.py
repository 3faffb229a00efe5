"""What a separated sheet tells, in numbers and in a sentence."""

from dataclasses import dataclass, field
from typing import Any

from tankrig.light.single import single_scattering
from tankrig.live.formatting import with_error
from tankrig.live.results import DoseFit
from tankrig.scene.description import Interval
from tankrig.separation.expected import Agreement, agreement, extinction, sheet_scene
from tankrig.separation.recorded import Separation
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
    sigma_t
        1/mm, by how order 1 decays, and its standard deviation; None where order 1 is lost in its own uncertainty.
    over_fit
        Order 1 over that of the fitted liquid; None where the dose is not fitted.
    doubts
        Sentences.
    """

    dose_ml: float
    z_mm: Interval
    follow: dict[float, float] = field(default_factory=dict)
    order_1: tuple[float, float] | None = None
    sigma_t: tuple[float, float] | None = None
    over_fit: Agreement | None = None
    doubts: tuple[str, ...] = ()

    @property
    def height_mm(self) -> float:
        """Middle of the sheet."""
        return 0.5 * (self.z_mm[0] + self.z_mm[1])

    @property
    def sentence(self) -> str:
        """In words.

        >>> Told(0.2, (58.0, 62.0), order_1=(0.874, 0.002), sigma_t=(0.00094, 0.00002)).sentence
        '0.2 ml, z = 60 mm: 87.40 ± 0.20 % of the light is order 1, σt 0.000940 ± 0.000020 /mm by its decay.'
        """
        words = []
        if self.order_1 is not None:
            words.append(f"{with_error(*(100.0 * one for one in self.order_1))} % of the light is order 1")
        if self.sigma_t is not None:
            words.append(f"σt {with_error(*self.sigma_t)} /mm by its decay")
        if self.over_fit is not None:
            words.append(f"order 1 over the fitted liquid's {with_error(self.over_fit.ratio, self.over_fit.sd)}")
        return f"{self.dose_ml:.4g} ml, z = {self.height_mm:g} mm: {', '.join(words) or 'nothing could be told'}."

    @property
    def row(self) -> dict[str, Any]:
        """As JSON can say it."""
        found: dict[str, Any] = {"dose_ml": self.dose_ml, "z_mm": list(self.z_mm), "doubts": list(self.doubts)}
        found["follow"] = {f"{period_mm:g}": part for period_mm, part in self.follow.items()}
        for name in ("order_1", "sigma_t"):
            if (known := getattr(self, name)) is not None:
                found[name], found[f"{name}_sd"] = known
        if self.over_fit is not None:
            found["over_fit"], found["over_fit_sd"] = self.over_fit.ratio, self.over_fit.sd
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
    known = first.known
    part = float(one.sheet[known].sum())
    by_noise = float(first.alike * (first.noise[known] ** 2).sum()) ** 0.5
    order_1 = float(first.image[known].sum()) / part, float(by_noise**2 + first.model[known].sum() ** 2) ** 0.5 / part
    scene = sheet_scene(one.transfers[0].wave, one.bench, one.camera, LIQUID if fit is None else fit.medium)
    sigma_t = extinction(first, scene) if order_1[0] > SURE * order_1[1] else None
    beside = agreement(first, fit.gain * single_scattering(scene)) if fit is not None else None
    doubts = (*one.doubts, *([beside.doubt] if beside is not None and beside.doubt else []))
    return Told(one.dose_ml, one.z_mm, follow, order_1, sigma_t, beside, doubts)
