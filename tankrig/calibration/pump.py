"""How much ink a pump's nominal microlitre is: doses weighed on a balance."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tankrig import bounded_reading
from tankrig.errors import CalibrationError, DeviceError, StoreError
from tankrig.files import whole_file

FORMAT = 1
LEAST_WEIGHTS = 3
MOST_SCATTER = 0.05
_PLAUSIBLE = (0.5, 2.0)
_AIR_G_PER_ML, _WEIGHTS_G_PER_ML = 0.0012, 8.0


@dataclass(frozen=True)
class PumpCalibration:
    """True volumes of a pump: `volume_ul = correction · nominal_ul + offset_ul` for each dose.

    Parameters
    ----------
    doser
        Identity of the device that was calibrated.
    basis
        The settings that its nominal volumes rest on, which have to be the same where the correction is used.
    date
        When, ISO 8601, UTC.
    correction, correction_sd
        True volume of a nominal µl, and its standard deviation.
    offset_ul, offset_sd_ul
        What every dose has besides, µl; not applied, and to be small.
    scatter_ul
        Standard deviation of a dose about the line, µl.
    increment_ul, increment_sd_ul
        True volume of the smallest step.
    temperature_c, ul_per_mg, evaporation_mg
        Of the liquid, what a weighed mg of it fills (buoyancy in air included), and what was lost before each weighing.
    nominal_ul, mass_mg
        The measurements.
    """

    doser: str
    basis: dict[str, float]
    date: str
    correction: float
    correction_sd: float
    offset_ul: float
    offset_sd_ul: float
    scatter_ul: float
    increment_ul: float
    increment_sd_ul: float
    temperature_c: float
    ul_per_mg: float
    evaporation_mg: float
    nominal_ul: tuple[float, ...]
    mass_mg: tuple[float, ...]

    @property
    def diameter_mm(self) -> float | None:
        """Inside diameter of the syringe that the doses speak for, where the basis has one."""
        nominal = self.basis.get("diameter_mm")
        return None if nominal is None else nominal * math.sqrt(self.correction)

    def correction_for(self, name: str, basis: Mapping[str, float]) -> float:
        """The correction, for a device with these settings.

        Raises
        ------
        DeviceError
            When it was calibrated with other settings.
        """
        for key, value in basis.items():
            found = self.basis.get(key)
            if found is None or not math.isclose(found, value, rel_tol=1e-9):
                raise DeviceError(
                    f"{name}: setting calibration: that file was measured with {key} = {found} and the rig file says "
                    f"{value:g}; calibrate anew (tankrig calibrate pump)"
                )
        return self.correction


def microlitres_per_mg(temperature_c: float, density_g_per_ml: float | None = None) -> float:
    """Volume of liquid that a balance shows as 1 mg, weighed in air at sea level.

    Parameters
    ----------
    temperature_c
        Of the liquid, °C; decides the density of water.
    density_g_per_ml
        Of the liquid at that temperature; None: water.

    Notes
    -----
    Density of water after Kell (1975), J. Chem. Eng. Data 20, 97, without dissolved air; buoyancy as in ISO 8655-6:
    Z = (1 − ρ_air/ρ_weights) / (ρ − ρ_air).

    Examples
    --------
    >>> round(microlitres_per_mg(20.0), 4)
    1.0029
    """
    if not 4.0 <= temperature_c <= 40.0:
        raise CalibrationError(f"temperature = {temperature_c:g} °C is not between 4 and 40; measure the liquid's")
    density = water_density(temperature_c) if density_g_per_ml is None else density_g_per_ml
    if not 0.5 <= density <= 5.0:
        raise CalibrationError(f"density = {density:g} g/ml is no liquid's; give g/ml at the temperature of weighing")
    return (1.0 - _AIR_G_PER_ML / _WEIGHTS_G_PER_ML) / (density - _AIR_G_PER_ML)


def water_density(temperature_c: float) -> float:
    """Density of water, g/ml (Kell 1975).

    >>> round(water_density(20.0), 5)
    0.9982
    """
    t = temperature_c
    above = 999.83952 + t * (
        16.945176 + t * (-7.9870401e-3 + t * (-46.170461e-6 + t * (105.56302e-9 - t * 280.54253e-12)))
    )
    return above / (1.0 + 16.879850e-3 * t) / 1000.0


def calibrate_pump(
    nominal_ul: Sequence[float],
    mass_mg: Sequence[float],
    *,
    doser: str,
    basis: Mapping[str, float],
    nominal_increment_ul: float,
    temperature_c: float = 20.0,
    density_g_per_ml: float | None = None,
    evaporation_mg: float = 0.0,
) -> PumpCalibration:
    """Fit weighed doses.

    A straight line by least squares where there are at least two volumes (10, 50 and 100 % of the largest dose, ten of
    each, make a good set), else the mean ratio. The standard deviations are those of the fit, widened by Student's t
    for few weights so that ± 2 of them hold 95 %.

    Parameters
    ----------
    nominal_ul
        What the pump said that it delivered, for each dose.
    mass_mg
        What the balance said.
    doser, basis
        See `PumpCalibration`.
    nominal_increment_ul
        The pump's smallest step as it takes it.
    temperature_c, density_g_per_ml
        See `microlitres_per_mg`.
    evaporation_mg
        Lost from each dose before it was weighed.

    Raises
    ------
    CalibrationError
        When there are fewer than three weights, one is not positive, they scatter by more than 5 %, or the volumes come
        out at less than half or more than twice what the pump says.

    Examples
    --------
    >>> weights = {"doser": "pump", "basis": {}, "nominal_increment_ul": 0.1}
    >>> found = calibrate_pump([100.0, 200.0, 300.0, 400.0], [102.0, 204.1, 305.9, 408.0], **weights)
    >>> round(found.correction, 3), round(found.correction_sd, 4)
    (1.023, 0.0009)
    """
    from scipy.special import stdtrit  # quantiles of Student's t; `scipy.stats` takes half a second more to import

    nominal, mass = np.asarray(nominal_ul, dtype=float), np.asarray(mass_mg, dtype=float)
    _refuse_nonsense(nominal, mass, evaporation_mg)
    ul_per_mg = microlitres_per_mg(temperature_c, density_g_per_ml)
    volume = (mass + evaporation_mg) * ul_per_mg
    line = np.ptp(nominal) > 0.2 * nominal.max()
    design = np.column_stack([nominal, np.ones_like(nominal)]) if line else nominal[:, None]
    solution, *_ = np.linalg.lstsq(design, volume, rcond=None)
    freedom = len(volume) - design.shape[1]
    scatter = float(np.sqrt(np.sum((volume - design @ solution) ** 2) / freedom))
    widened = float(stdtrit(freedom, 0.975)) / 2.0
    sd = widened * scatter * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    _refuse_doubtful(float(solution[0]), scatter / float(volume.mean()))
    correction, correction_sd = float(solution[0]), float(sd[0])
    return PumpCalibration(
        doser=doser,
        basis=dict(basis),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        correction=correction,
        correction_sd=correction_sd,
        offset_ul=float(solution[1]) if line else 0.0,
        offset_sd_ul=float(sd[1]) if line else 0.0,
        scatter_ul=scatter,
        increment_ul=nominal_increment_ul * correction,
        increment_sd_ul=nominal_increment_ul * correction_sd,
        temperature_c=temperature_c,
        ul_per_mg=ul_per_mg,
        evaporation_mg=evaporation_mg,
        nominal_ul=tuple(nominal.tolist()),
        mass_mg=tuple(mass.tolist()),
    )


def _refuse_nonsense(nominal: Any, mass: Any, evaporation_mg: float) -> None:
    if len(nominal) != len(mass):
        raise CalibrationError(f"{len(nominal)} volumes and {len(mass)} weights; give one weight for each dose")
    if len(mass) < LEAST_WEIGHTS:
        raise CalibrationError(f"{len(mass)} weights are too few; weigh at least {LEAST_WEIGHTS} doses, better thirty")
    for what, unit, values in (("weight", "mg", mass), ("volume", "µl", nominal)):
        for number, value in enumerate(values.tolist(), start=1):
            if not (math.isfinite(value) and value > 0.0):
                raise CalibrationError(f"{what} {number} = {value:g} {unit} is not positive; weigh that dose again")
    if not 0.0 <= evaporation_mg < mass.min():
        raise CalibrationError(f"evaporation = {evaporation_mg:g} mg is negative or more than a dose; weigh it again")


def _refuse_doubtful(correction: float, scatter: float) -> None:
    if not scatter <= MOST_SCATTER:
        raise CalibrationError(
            f"the weights scatter by {100 * scatter:.1f} %, more than {100 * MOST_SCATTER:.0f} %; look for air in the "
            "syringe, drops on the tube or a draught on the balance, and weigh again"
        )
    if not _PLAUSIBLE[0] <= correction <= _PLAUSIBLE[1]:
        raise CalibrationError(
            f"a nominal µl comes out as {correction:.3g} µl; check the syringe's settings and that weights are in mg"
        )


def save_pump_calibration(calibration: PumpCalibration, path: Path) -> None:
    """Write a calibration; never over another.

    Raises
    ------
    StoreError
        When the file is there already or cannot be written.
    """
    if path.exists():
        raise StoreError(f"{path}: is there already and is not overwritten; give another name with --out")
    values = {"kind": "pump", "format": FORMAT, **asdict(calibration)}
    basis = values.pop("basis")
    lines = [f"{key} = {_toml(value)}" for key, value in values.items()]
    lines += ["", "[basis]", *(f"{key} = {_toml(value)}" for key, value in basis.items())]
    with whole_file(path) as unfinished:
        unfinished.write_text("\n".join(lines) + "\n", encoding="utf-8")


def load_pump_calibration(path: Path) -> PumpCalibration:
    """Read a calibration.

    Raises
    ------
    StoreError
        When the file cannot be read or is no calibration of a pump.
    """
    try:
        values = bounded_reading.parsed_toml(bounded_reading.text(path))
        if (values.pop("kind"), values.pop("format")) != ("pump", FORMAT):
            raise ValueError("another kind or version")
        if unknown := sorted(values.keys() - {field.name for field in fields(PumpCalibration)}):
            raise ValueError(f'key "{unknown[0][:60]}" is unknown')
        found = PumpCalibration(**values)
        found = replace(found, nominal_ul=tuple(found.nominal_ul), mass_mg=tuple(found.mass_mg))
        if not _PLAUSIBLE[0] <= found.correction <= _PLAUSIBLE[1]:
            raise ValueError("its correction is no factor near 1")
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror}); give a file of tankrig calibrate pump") from error
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(
            f"{path}: is no calibration of a pump ({error}); give a file of tankrig calibrate pump"
        ) from error
    return found


def _toml(value: object) -> str:
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
