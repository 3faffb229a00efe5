"""From what was measured to a calibration file: numbers, their uncertainties, and the reasons to doubt them."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from tankrig.calibration.file import Calibration
from tankrig.calibration.linearity import DECADES
from tankrig.calibration.radiometry import Amplified, Radiometry
from tankrig.calibration.radiometry_procedure import RadiometryMeasured, Sweep

LINEAR, LEVELLED, KNOWN, STEADY, TILTED = 0.005, 0.01, 0.03, 0.01, 0.05
"""Largest errors of linearity, response, read noise and counts per electron; drift of the light; tilt of the flat."""
_MISFIT = 5.0
_CLEAR = 4.0
"""Standard deviations of the read noise that black has to lie above 0."""


def radiometry_of(measured: RadiometryMeasured) -> Radiometry:
    """What frames are corrected with."""
    first = measured.sweeps[0].dark
    black, current = float(np.median(first.level[~first.hot])), float(np.median(first.rate[~first.hot]))
    return Radiometry(
        amplified=tuple(sorted((_amplified(sweep) for sweep in measured.sweeps), key=lambda one: one.gain)),
        flat=measured.flat.response,
        dark_excess=first.rate - current,
        black_excess=first.level - black,
        hot=first.hot,
        response=measured.response,
    )


def calibration_of(measured: RadiometryMeasured) -> Calibration:
    """Results, uncertainties and doubts, to be saved."""
    result, arrays = radiometry_of(measured).table()
    sweeps = sorted(measured.sweeps, key=lambda one: one.gain)
    return Calibration(
        kind="radiometry",
        device=measured.camera,
        shape=(measured.flat.response.shape[0], measured.flat.response.shape[1]),
        result={**result, "flat": _flat(measured)},
        sd={
            "amplified": [_amplified_sd(sweep) for sweep in sweeps],
            "projector": {"response": measured.response.curve_sd},
            "flat": {"response": measured.flat.response_sd},
        },
        how_well=_how_well(measured),
        doubts=tuple(_doubts(measured)),
        arrays=arrays,
    )


def _amplified(sweep: Sweep) -> Amplified:
    good = ~sweep.dark.hot
    return Amplified(
        gain=sweep.gain,
        black_dn=float(np.median(sweep.dark.level[good])),
        dark_dn_per_ms=float(np.median(sweep.dark.rate[good])),
        dn_per_e=sweep.transfer.dn_per_e,
        read_noise_e=sweep.transfer.read_noise_e,
        full_dn=sweep.linearity.full,
        linearity=sweep.linearity.coefficients,
    )


def _amplified_sd(sweep: Sweep) -> Mapping[str, Any]:
    pixels = float(np.sqrt((~sweep.dark.hot).sum()))
    return {
        "black_dn": 1.2533 * sweep.dark.level_sd / pixels,
        "dark_dn_per_ms": 1.2533 * sweep.dark.rate_sd / pixels,
        "dn_per_e": sweep.transfer.dn_per_e_sd,
        "read_noise_e": sweep.transfer.read_noise_e_sd,
        "linearity": list(sweep.linearity.coefficients_sd),
    }


def _flat(measured: RadiometryMeasured) -> Mapping[str, float]:
    flat, hot = measured.flat, measured.sweeps[0].dark.hot
    return {"vignetting": flat.vignetting, "uneven": flat.uneven, "tilt": flat.tilt, "hot_pixels": int(hot.sum())}


def _how_well(measured: RadiometryMeasured) -> Mapping[str, float]:
    transfers = [sweep.transfer for sweep in measured.sweeps]
    return {
        "linearity_error_percent": 100.0 * max(sweep.linearity.error for sweep in measured.sweeps),
        "response_error_percent": 100.0 * float(np.abs(measured.checked).max()),
        "dn_per_e_sd_percent": 100.0 * max(one.dn_per_e_sd / one.dn_per_e for one in transfers),
        "read_noise_sd_percent": 100.0 * max(one.read_noise_e_sd / max(one.read_noise_e, 1e-9) for one in transfers),
        "drift_percent": 100.0 * max(abs(sweep.drift) for sweep in measured.sweeps),
        "decades": min(sweep.linearity.decades for sweep in measured.sweeps),
    }


def _doubts(measured: RadiometryMeasured) -> Iterator[str]:
    for sweep in measured.sweeps:
        at, linearity, transfer = f"at gain {sweep.gain:g}", sweep.linearity, sweep.transfer
        if abs(sweep.drift) > STEADY:
            yield (
                f"{at} the light changed by {100 * sweep.drift:+.1f} % during the sweep; let the lamp warm up for half "
                f"an hour and keep other light out"
            )
        if linearity.error > LINEAR:
            yield (
                f"{at} the corrected counts are off a straight line by {100 * linearity.error:.2f} %; give "
                f"the projector's true period, of which exposures are whole ones, and keep the light steady"
            )
        if linearity.decades < DECADES - 0.3:
            yield (
                f"{at} the sweep spans {linearity.decades:.1f} decades of counts and not {DECADES:g}; allow longer and "
                f"shorter exposures"
            )
        if transfer.misfit > _MISFIT:
            yield (
                f"{at} the noise does not follow a straight line (χ² {transfer.misfit:.0f}); use raw frames without "
                f"noise reduction or compression, and a steady light"
            )
        black, noise = float(np.median(sweep.dark.level)), float(np.sqrt(sweep.dark.read_variance))
        if black < _CLEAR * noise:
            yield (
                f"{at} black is {black:.0f} counts and its noise {noise:.0f}, so darks are cut off at 0; raise the "
                f"camera's black level or brightness"
            )
        if transfer.read_noise_e_sd > KNOWN * transfer.read_noise_e:
            yield (
                f"{at} the read noise is known to {100 * transfer.read_noise_e_sd / transfer.read_noise_e:.0f} % only, "
                f"being less than half a count; use a higher gain or more bits"
            )
    worst = float(np.abs(measured.checked).max())
    if worst > LEVELLED:
        yield (
            f"the projector's response predicts levels that were left out to {100 * worst:.1f} % only; switch dynamic "
            f"contrast and lamp saving off, and let the lamp warm up"
        )
    if measured.flat.tilt > TILTED:
        yield (
            f"the light on the diffuser differs by {100 * measured.flat.tilt:.0f} % from side to side; light it from "
            f"farther away, or use a thicker diffuser"
        )
