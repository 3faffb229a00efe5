"""How fast the pump of a rig delivers, and between which bounds its driver takes another rate."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from tankrig.errors import SceneError

if TYPE_CHECKING:
    from drivers.rig import RigFile

PULSES_PER_STROKE, PULSES_PER_S = 6000, (5, 6000)
"""Of a Cavro's plunger, on every model: firmware_notes/cavro.md."""
_SLOW_UL_PER_S = 0.01
"""Where a driver takes any rate above 0; a µl would take minutes."""


@dataclass(frozen=True)
class PumpRate:
    """A rate and its bounds, µl/s.

    Parameters
    ----------
    key
        Of the table `[doser]` that holds it, in a unit of its own.
    ul_per_s
        What that says.
    least_ul_per_s, most_ul_per_s
        Between which its driver takes others.
    per_ul_per_s
        The key's value for one µl/s.
    """

    key: str
    ul_per_s: float
    least_ul_per_s: float
    most_ul_per_s: float
    per_ul_per_s: float

    @property
    def span(self) -> str:
        """What may be asked for.

        >>> PumpRate("speed_ul_per_s", 10.0, 0.5, 200.0, 1.0).span
        '0.5 to 200 µl/s'
        """
        return f"{self.least_ul_per_s:g} to {self.most_ul_per_s:g} µl/s"


def _of_simulated(doser: Mapping[str, Any]) -> PumpRate:
    steps = float(doser.get("steps_per_ul", 10.0))
    return PumpRate("rate", float(doser.get("rate", 2000.0)) / steps, _SLOW_UL_PER_S, 65535.0 / steps, steps)


def _of_new_era(doser: Mapping[str, Any]) -> PumpRate:
    per_s = 60e-3  # ml/min for one µl/s
    return PumpRate("rate_ml_per_min", float(doser["rate_ml_per_min"]) / per_s, _SLOW_UL_PER_S, 100.0 / per_s, per_s)


def _of_cavro(doser: Mapping[str, Any]) -> PumpRate:
    pulse_ul = float(doser["syringe_ul"]) / PULSES_PER_STROKE
    least, most = (per_s * pulse_ul for per_s in PULSES_PER_S)
    return PumpRate("speed_ul_per_s", float(doser["speed_ul_per_s"]), least, most, 1.0)


_BY_DRIVER: dict[str, Callable[[Mapping[str, Any]], PumpRate]] = {
    "simulated-doser": _of_simulated, "new-era": _of_new_era, "cavro": _of_cavro,
}  # fmt: skip


def pump_rate(doser: Mapping[str, Any]) -> PumpRate | None:
    """The rate in a rig file's table `[doser]`; None where the pump's own firmware, or a lab's driver, sets it.

    Examples
    --------
    >>> pump_rate({"driver": "new-era", "rate_ml_per_min": 6.0}).ul_per_s
    100.0
    >>> pump_rate({"driver": "rig-doser", "steps_per_ul": 10.0}) is None
    True
    """
    of = _BY_DRIVER.get(str(doser.get("driver")))
    try:
        rate = of(doser) if of is not None else None
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        return None  # the driver says what is wrong with its table when the rig is opened
    return rate if rate is not None and 0.0 < rate.least_ul_per_s < rate.most_ul_per_s < math.inf else None


def at_rate(rig: "RigFile", ul_per_s: float) -> "RigFile":
    """The rig with another rate of its pump, in its driver's settings and in its estimates of time.

    Raises
    ------
    SceneError
        When the pump has no rate that can be set, or takes no such rate.
    """
    rate = pump_rate(rig.doser)
    if rate is None:
        raise SceneError(f"{rig.name}: the rate of its pump is not in the rig file, so that it cannot be set here")
    if not rate.least_ul_per_s <= ul_per_s <= rate.most_ul_per_s:
        raise SceneError(f"{rig.name}: its pump cannot deliver {ul_per_s:g} µl/s; give {rate.span}")
    doser = {**rig.doser, rate.key: rate.per_ul_per_s * ul_per_s}
    return replace(rig, doser=doser, pace=replace(rig.pace, dose_ul_per_s=ul_per_s))
