"""Radiometric calibration on a bench: darks, exposure sweeps, two flats, the projector's levels."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tankrig.calibration.darks import Dark, fit_darks
from tankrig.calibration.exposed import Array, Exposed, exposed
from tankrig.calibration.flats import Flat, fit_flat
from tankrig.calibration.linearity import Linearity, fit_linearity
from tankrig.calibration.lit_camera import LitCamera, Look
from tankrig.calibration.photon_transfer import PhotonTransfer, photon_transfer
from tankrig.calibration.radiometry_plan import CHECKED_LEVELS, REFERENCE_EVERY, ExposuresError, RadiometryPlan
from tankrig.calibration.response import LEVELS, Response, fit_response
from tankrig.devices import CameraDevice, Pixels, Projector

CAP, DIFFUSER, TURNED, NOTHING = "cap", "diffuser", "diffuser turned", "nothing"
"""What a person puts before the lens."""
_WELL_LIT, _FLAT_LIT = 0.85, 0.6
_TOO_DIM = 0.3
_DIMMEST_LEVEL = 3


@dataclass(frozen=True, eq=False)
class Sweep:
    """A camera at one gain.

    Parameters
    ----------
    gain
        As read back.
    dark
        Without light.
    exposures
        Above the dark, the shortest first.
    level
        Of the projector.
    drift
        By how much the light on the way up was brighter than on the way down.
    """

    gain: float
    dark: Dark
    exposures: tuple[Exposed, ...]
    level: int
    drift: float
    linearity: Linearity
    transfer: PhotonTransfer


@dataclass(frozen=True, eq=False)
class RadiometryMeasured:
    """All that was measured and fitted.

    Parameters
    ----------
    camera
        Its name.
    sweeps
        One for each gain.
    flat
        Of the pixels.
    response
        Of the projector.
    measured
        Level, its light above level 0's over level 255's, and its standard deviation, of each level that was shown.
    checked
        Relative deviations of the response at levels that were left out of its fit.
    """

    camera: str
    sweeps: tuple[Sweep, ...]
    flat: Flat
    response: Response
    measured: Array
    checked: Array


@dataclass
class _Light:
    """How bright the projector's full level is, as linear counts per ms of a pixel, followed while the lamp drifts."""

    at: list[int] = field(default_factory=list)
    value: list[float] = field(default_factory=list)

    def scale(self, number: int) -> float:
        """What it was at the frame `number` over what it was at first."""
        return float(np.interp(number, self.at, self.value)) / self.value[0]


def measure_radiometry(
    projector: Projector,
    camera: CameraDevice,
    plan: RadiometryPlan,
    ask: Callable[[str], object],
    tell: Callable[[Look], object] = lambda _: None,
) -> RadiometryMeasured:
    """Carry the calibration out.

    Parameters
    ----------
    projector, camera
        Open; the projector's light falls on the diffuser when that is before the lens.
    plan
        What to photograph.
    ask
        Called with `CAP`, `DIFFUSER`, `TURNED`, and in the end `NOTHING`: to have that put before the lens; returns
        once it is there.
    tell
        Called after each frame.

    Raises
    ------
    ImageError, DeviceError
        When the frames are no darks, are saturated or too dim, or the devices fail: with what to do.
    """
    lit = LitCamera(projector, camera, tell)
    ask(CAP)
    lit.look_anew()
    darks = [_darks(lit, plan, gain, number / len(plan.gains)) for number, gain in enumerate(plan.gains)]
    ask(DIFFUSER)
    lit.look_anew()
    sweeps = tuple(_sweep(lit, plan, gain, dark) for gain, dark in zip(plan.gains, darks, strict=True))
    first = _flat_picture(lit, plan, sweeps[0])
    measured, light = _levels(lit, plan, sweeps[0])
    ask(TURNED)
    lit.look_anew()
    second = _flat_picture(lit, plan, sweeps[0])
    ask(NOTHING)
    flat = fit_flat(first[0], second[0], float(np.hypot(first[1], second[1]) / np.sqrt(2.0)), ~sweeps[0].dark.hot)
    fitted = np.isin(light[:, 0], LEVELS)
    response = fit_response(light[fitted, 0].astype(int).tolist(), light[fitted, 1].tolist(), light[fitted, 2].tolist())
    left_out = measured[~fitted]
    checked = response.curve[left_out[:, 0].astype(int)] / left_out[:, 1] - 1.0
    return RadiometryMeasured(camera.name, sweeps, flat, response, measured, checked)


def _darks(lit: LitCamera, plan: RadiometryPlan, gain: float, done: float) -> Dark:
    lit.doing, lit.done = f"darks, gain {gain:g}", 0.15 * done
    taken = []
    for exposure_ms in plan.dark_exposures_ms:
        frames, settings = lit.frames(0, exposure_ms, gain, plan.dark_frames)
        taken.append(exposed(frames, settings.exposure_ms, lit.camera.saturation))
    return fit_darks(taken, lit.camera.saturation)


def _sweep(lit: LitCamera, plan: RadiometryPlan, gain: float, dark: Dark) -> Sweep:
    lit.doing, lit.done = f"level for the sweep, gain {gain:g}", 0.15
    level = _level_for(lit, plan, gain, dark)
    times = plan.exposures_ms
    half = max(1, plan.sweep_frames // 2)
    taken: dict[float, list[Pixels]] = {}
    means: tuple[dict[float, float], dict[float, float]] = ({}, {})
    actual = gain
    for way, ordered in enumerate((times, times[::-1])):
        for number, exposure_ms in enumerate(ordered):
            lit.doing = f"exposure sweep, gain {gain:g}, {exposure_ms:.4g} ms"
            lit.done = 0.2 + 0.25 * (way + number / len(times)) / 2.0
            frames, settings = lit.frames(level, exposure_ms, gain, half)
            actual = settings.gain
            taken.setdefault(settings.exposure_ms, []).extend(frames)
            means[way][settings.exposure_ms] = float(np.mean([f.mean() for f in frames]) - dark.at(exposure_ms).mean())
    sweep = []
    for exposure_ms in sorted(taken):
        black = dark.at(exposure_ms)
        sweep.append(exposed(taken[exposure_ms], exposure_ms, lit.camera.saturation, black, ~dark.hot).above(black))
    brightest = [exposure_ms for exposure_ms in taken if means[1][exposure_ms] > 0.02 * max(means[1].values())]
    drift = float(np.mean([means[0][at] / means[1][at] for at in brightest])) - 1.0
    linearity = fit_linearity(sweep, ~dark.hot)
    return Sweep(actual, dark, tuple(sweep), level, drift, linearity, photon_transfer(sweep, dark, linearity))


def _level_for(lit: LitCamera, plan: RadiometryPlan, gain: float, dark: Dark) -> int:
    """The level with which the longest exposure is well filled, by halving at a shorter one."""
    exposure_ms = plan.exposures_ms[len(plan.exposures_ms) // 2]
    wanted = _WELL_LIT * exposure_ms / plan.exposures_ms[-1]
    low, high = 0, 255

    def filled(level: int) -> float:
        frames, settings = lit.frames(level, exposure_ms, gain, 1)
        light = (frames[0] - dark.at(settings.exposure_ms))[~dark.hot]
        return float(np.quantile(light, 0.999)) / lit.camera.saturation

    brightest = filled(high)
    if brightest < _TOO_DIM * wanted / _WELL_LIT:
        raise ExposuresError(
            f"{lit.camera.name}: at level 255 and {plan.exposures_ms[-1]:g} ms the diffuser fills only "
            f"{brightest / wanted * _WELL_LIT:.0%} of the range; bring the light nearer, open the aperture, or let "
            f"the longest exposure be longer",
            "longest_ms",
        )
    if brightest <= wanted:
        return high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if filled(middle) <= wanted else (low, middle)
    if low < _DIMMEST_LEVEL:
        raise ExposuresError(
            f"{lit.camera.name}: is too bright even at level {high} of the projector; close the aperture, or let the "
            f"shortest and the longest exposure be shorter",
            "shortest_ms",
            "longest_ms",
        )
    return low


def _flat_picture(lit: LitCamera, plan: RadiometryPlan, sweep: Sweep) -> tuple[Array, float]:
    """Linear counts above the dark, and the relative noise of a pixel."""
    lit.doing, lit.done = "flat", 0.5
    filled = np.array([one.mean.max() for one in sweep.exposures])
    chosen = sweep.exposures[int(np.abs(filled - _FLAT_LIT * sweep.linearity.full).argmin())]
    frames, settings = lit.frames(sweep.level, chosen.exposure_ms, sweep.gain, plan.flat_frames)
    black = sweep.dark.at(settings.exposure_ms)
    one = exposed(frames, settings.exposure_ms, lit.camera.saturation, black).above(black)
    good = ~sweep.dark.hot
    noise = float(np.sqrt(one.variance[good].mean() / one.frames) / one.mean[good].mean())
    return sweep.linearity.linear(one.mean), noise


def _levels(lit: LitCamera, plan: RadiometryPlan, sweep: Sweep) -> tuple[Array, Array]:
    """(levels, 3) level, light and its standard deviation: over that of level 255 above 0; and as counts per ms."""
    levels = sorted({*LEVELS, *CHECKED_LEVELS}, reverse=True)
    first_ms = sweep.exposures[-1].exposure_ms
    reference_ms = _full_exposure(lit, plan, sweep)
    light, rows, exposure_ms = _Light(), [], reference_ms
    for number, level in enumerate(levels):
        lit.doing, lit.done = f"projector's level {level}", 0.55 + 0.4 * number / len(levels)
        if number % REFERENCE_EVERY == 0 or number == len(levels) - 1:
            light.at.append(number)
            light.value.append(_brightness(lit, sweep, 255, reference_ms)[0])
        value, sd, filled = _brightness(lit, sweep, level, exposure_ms)
        rows.append((level, value, sd))
        if filled < _FLAT_LIT / 2.0:
            exposure_ms = _whole(min(exposure_ms * min(_FLAT_LIT / max(filled, 1e-3), 3.0), first_ms), plan)
    table = np.array(rows)
    scale = np.array([light.scale(number) for number in range(len(levels))])
    table[:, 1:] /= scale[:, None]
    table[:, 2] = np.hypot(table[:, 2], 2e-4 * table[:, 1])
    relative = table.copy()
    relative[:, 1:] /= table[0, 1] - table[-1, 1]
    relative[:, 1] -= relative[-1, 1]
    return relative[::-1], table[::-1]


def _full_exposure(lit: LitCamera, plan: RadiometryPlan, sweep: Sweep) -> float:
    """An exposure that level 255 fills well."""
    exposure_ms = plan.exposures_ms[0]
    while (filled := _brightness(lit, sweep, 255, exposure_ms)[2]) < _FLAT_LIT / 2.0:
        longer = _whole(min(exposure_ms * min(_FLAT_LIT / max(filled, 0.02), 8.0), plan.exposures_ms[-1]), plan)
        if longer <= exposure_ms:
            break
        exposure_ms = longer
    if filled > 0.97:
        raise ExposuresError(
            f"{lit.camera.name}: is saturated by level 255 at {exposure_ms:g} ms; close the aperture, put a second "
            f"diffuser before the lens, or let the shortest exposure be shorter",
            "shortest_ms",
        )
    return exposure_ms


def _whole(exposure_ms: float, plan: RadiometryPlan) -> float:
    """The nearest whole number of periods."""
    if plan.period_ms <= 0.0:
        return exposure_ms
    return max(1.0, float(np.round(exposure_ms / plan.period_ms))) * plan.period_ms


def _brightness(lit: LitCamera, sweep: Sweep, level: int, exposure_ms: float) -> tuple[float, float, float]:
    """Linear counts per ms of the mean pixel, their standard deviation, and how far the frame is filled."""
    frames, settings = lit.frames(level, exposure_ms, sweep.gain, 2)
    black, good = sweep.dark.at(settings.exposure_ms), ~sweep.dark.hot
    one = exposed(frames, settings.exposure_ms, lit.camera.saturation, black).above(black)
    value = float(sweep.linearity.linear(one.mean[good]).mean()) / settings.exposure_ms
    noise = np.sqrt(one.variance[good].mean() / (2 * good.sum()) + sweep.dark.level_sd**2 / good.sum())
    return value, float(noise) / settings.exposure_ms, lit.filled(frames[0])
