"""The camera as witness: whether the light that it sees follows the patterns that the projector is told to show.

Nothing but the camera can tell what happens behind a video output: a message that the projector itself puts over the
picture, its keystone correction, a cable to another computer. So the picture is cut into bands, side by side, and three
patterns light them by the bits of their numbers; each pixel that sees light can then tell the number of its band.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import LEAST_MARKERS, markers_of_any_board
from tankrig.devices import CameraDevice, CameraSettings, Projector
from tankrig.errors import DeviceError, ImageError
from tankrig.pattern import Pattern
from tankrig.sequence.exposure import ExposureRule

_BITS = 3
BANDS = 2**_BITS
"""That the picture is cut into, from left to right."""
_DIM = 0.01
_LIT = 0.15
"""Part of the brightest light from which on a pixel counts."""
_FEW = 0.1
"""Part of a band's even share of the pixels, below which it counts as unseen."""
_NEVER = 1e-6
"""Weight of a pixel that tells nothing of its band."""
_BACK = 0.02
_LONGEST_MS = 200.0
"""Exposure of a flash: a run is to begin soon, and water that is too dark for this tells nothing anyway."""

Image = NDArray[np.float64]


@dataclass(frozen=True)
class WitnessReport:
    """What the camera says.

    Parameters
    ----------
    follows
        Whether its light follows the patterns; None where the camera sees too little to tell.
    finding
        In words.
    """

    follows: bool | None
    finding: str


def witness(projector: Projector, camera: CameraDevice, rule: ExposureRule) -> WitnessReport:
    """Show dark, full and three patterns of bands, and ask the camera; takes some seconds.

    Parameters
    ----------
    projector, camera
        Open; the camera sees the light of all of the picture.
    rule
        Exposures keep to it.
    """
    exposure_ms = bright_exposure_ms(projector, camera, rule, _LONGEST_MS)
    number = np.arange(projector.shape[1]) * BANDS // projector.shape[1]
    gray = number ^ (number >> 1)  # neighbours differ in one bit, so that a pixel between two is one or the other
    dark = mean_of(projector, camera, _columns(projector, np.zeros_like(gray)), exposure_ms)
    light = mean_of(projector, camera, _columns(projector, np.ones_like(gray)), exposure_ms) - dark
    if _brightest(light) < _DIM * camera.saturation:
        return told_by(light, [], dark - dark, camera.saturation)
    seen = [
        mean_of(projector, camera, _columns(projector, gray >> bit & 1), exposure_ms) - dark for bit in range(_BITS)
    ]
    back = mean_of(projector, camera, _columns(projector, np.zeros_like(gray)), exposure_ms) - dark
    return told_by(light, seen, back, camera.saturation)


def told_by(light: Image, seen: list[Image], back: Image, saturation: float) -> WitnessReport:
    """What pictures say, each (rows, columns) of counts above the dark.

    Parameters
    ----------
    light
        With all bands lit.
    seen
        For each bit of the bands' Gray code, the lowest first.
    back
        Dark again.
    saturation
        Highest count.
    """
    brightest = _brightest(light)
    if brightest < _DIM * saturation:
        return WitnessReport(
            None,
            "the camera sees too little of its light: clear water (it needs ink or paper), a cap, or a cover",
        )
    lit = light > _LIT * brightest
    if abs(float(back[lit].mean())) > _BACK * float(light[lit].mean()):
        return WitnessReport(
            False, "dark is not what it was a second ago: it follows late, or other light comes and goes"
        )
    part = np.array([one[lit] / light[lit] for one in seen])
    if part.min(axis=0).mean() < -_LIT or part.max(axis=0).mean() > 1.0 + _LIT:
        return WitnessReport(False, "parts of the picture are brighter than all of it; it shows something else")
    gray = sum((part[bit] > 0.5).astype(int) << bit for bit in range(_BITS))
    number = np.asarray(gray) ^ (np.asarray(gray) >> 1) ^ (np.asarray(gray) >> 2)
    rows, columns = np.nonzero(lit)
    clear = _NEVER + np.prod(np.abs(2.0 * part - 1.0), axis=0)  # glass walls put one band's light upon another's
    share = np.bincount(number, minlength=BANDS) * BANDS / number.size
    missing = [str(band + 1) for band in range(BANDS) if share[band] < _FEW]
    if missing:
        return WitnessReport(
            None if len(missing) < BANDS - 1 else False,
            f"no light of {', '.join(missing)} of {BANDS} bands, counted from the left, is seen; something covers them "
            f"or the camera does not see there",
        )
    pixels_of = [number == band for band in range(BANDS)]
    places = [np.average([rows[here], columns[here]], axis=1, weights=clear[here]) for here in pixels_of]
    steps = np.diff(places, axis=0)
    across = steps.sum(axis=0)
    if not (steps @ across > 0.0).all():
        return WitnessReport(False, "the bands do not follow each other as they were shown; it shows something else")
    return WitnessReport(True, f"all {BANDS} bands of its picture are seen, one beside the other")


def _brightest(light: Image) -> float:
    return float(np.quantile(light, 0.999))


def require_seen(projector: Projector, camera: CameraDevice, rule: ExposureRule) -> None:
    """Raise a DeviceError unless the camera sees that the light follows the patterns."""
    testimony = witness(projector, camera, rule)
    if not testimony.follows:
        raise DeviceError(
            f"{camera.name}: asked before the run, it does not see what {projector.name} shows: {testimony.finding}; "
            f"look at both, or leave flash_before_run out of the rig file where the camera cannot tell"
        )


def require_no_board(projector: Projector, camera: CameraDevice, rule: ExposureRule) -> None:
    """Refuse a bench whose camera sees a calibration's board, by a white flash and by no light of the projector's.

    Raises
    ------
    ImageError
        When a board is there, where ink is to be seen.
    """
    exposure_ms = bright_exposure_ms(projector, camera, rule, _LONGEST_MS)
    for level in (255, 0):  # the room's light may show what the projector's does not reach
        flash = Pattern(f"level {level}", np.full(projector.shape, level, np.uint8))
        seen, dictionary = markers_of_any_board(mean_of(projector, camera, flash, exposure_ms), camera.saturation)
        if seen >= LEAST_MARKERS:
            raise ImageError(
                f"{camera.name}: sees a calibration's board, {seen} markers of {dictionary}, where ink is to be seen; "
                f"take the board away"
            )


def bright_exposure_ms(
    projector: Projector, camera: CameraDevice, rule: ExposureRule, longest_ms: float = 1000.0
) -> float:
    """One with which level 255 is bright and not saturated, in whole periods of the projector's light."""
    period_ms = rule.period_ms or 0.0

    def whole(wanted_ms: float) -> CameraSettings:
        return CameraSettings(max(1, round(wanted_ms / period_ms)) * period_ms if period_ms else wanted_ms)

    full = Pattern("level 255", np.full(projector.shape, 255, np.uint8))
    exposure_ms = camera.configure(whole(20.0)).exposure_ms
    for _ in range(4):
        filled = float(np.quantile(mean_of(projector, camera, full, exposure_ms), 0.999)) / camera.saturation
        if 0.2 < filled < 0.9:
            break
        wanted_ms = exposure_ms * (0.2 if filled >= 0.9 else min(0.6 / max(filled, 0.01), 20.0))
        exposure_ms = camera.configure(whole(min(wanted_ms, longest_ms))).exposure_ms
    return exposure_ms


def mean_of(projector: Projector, camera: CameraDevice, pattern: Pattern, exposure_ms: float) -> Image:
    """(rows, columns) of two frames."""
    after_ns = projector.show(pattern).bound_ns
    first = camera.capture(after_ns, 2e-3 * exposure_ms + 5.0)
    second = camera.capture(first.exposure_start_ns, 2e-3 * exposure_ms + 5.0)
    return (first.pixels.astype(np.float64) + second.pixels) / 2.0


def _columns(projector: Projector, lit: NDArray[np.int_]) -> Pattern:
    pixels = np.broadcast_to((255 * lit).astype(np.uint8), projector.shape).copy()
    return Pattern("flash", pixels)
