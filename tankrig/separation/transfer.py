"""How a wave reaches the picture when its light is scattered once: where its crests lie, and how far they are blurred.

Of order 1 all of this is geometry: the camera's pixels, parallax over the sheet's thickness, the projector's columns,
and the blur of both lenses. The quotient

    T = M₁ / S₁

of order 1 under the wave and under the sheet hardly depends on the liquid (it cancels), so it is calculated by single
scattering in any liquid that is thin enough to be seen through. M/T is then order 1 itself, and what of the higher
orders still follows the wave.
"""

from dataclasses import dataclass, replace

import numpy as np

from tankrig.bench import Bench
from tankrig.errors import ImageError
from tankrig.image.bins import Bins
from tankrig.pattern.kinds import Sheet, Wave, draw
from tankrig.scene.description import Camera, Medium, Projector
from tankrig.separation.waves import Array, Complex, Mask, demodulated

LIQUID = Medium(0.0, 0.01, 0.5)
"""In which order 1 is calculated: between thin and medium."""
LEAST = 0.15
"""Of the modulus of T: below it nothing is left of the wave that noise and blur's uncertainty would not drown."""
LIT = 0.7
"""Of the brightest order 1 in the column of pixels: what is fainter is not all in the sheet."""
BINS_A_PERIOD = 4
PIXEL_MM = 2.0
"""Sides of bins at most."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """Of one wave.

    Parameters
    ----------
    wave
        As it was asked for.
    factor
        (rows, columns) complex T; 0 where order 1 of the sheet is not seen, or the wave is blurred away.
    blurred
        What the lenses leave of T's modulus, 1 for all of it; in the middle of the sheet.
    """

    wave: Wave
    factor: Complex
    blurred: float = 1.0

    @property
    def seen(self) -> Mask:
        """(rows, columns) whether the wave can be told there."""
        return np.asarray(np.abs(self.factor) > 0.0)


def bins_for_waves(camera: Camera, periods_mm: tuple[float, ...]) -> Bins:
    """Bins of `PIXEL_MM` at most, and of a quarter of the finest period at most, across it."""
    tall, wide = camera.sides_mm
    by = max(1, int(min(PIXEL_MM, min(periods_mm) / BINS_A_PERIOD) / tall))
    return Bins(by, max(1, int(PIXEL_MM / wide)))


def transfer_of(wave: Wave, bench: Bench, camera: Camera, shifts: int = 4) -> Transfer:
    """How a wave reaches a camera's picture by order 1.

    Parameters
    ----------
    wave
        Its shift does not matter.
    bench
        Its wall is what the wave is drawn on, its medium is not needed.
    camera
        As the pictures are binned.
    shifts
        In which it is shown.

    Raises
    ------
    ImageError
        When the blur of the lenses leaves nothing of it, or the camera sees nothing of its sheet.
    """
    from tankrig.light.entering import through_lens
    from tankrig.light.single import single_scattering

    seen = replace(bench, camera=camera)

    def order_1(kind: Wave | Sheet) -> Array:
        scene = seen.scene(draw(kind, bench.wall), LIQUID)  # a wide lens is two pinholes, of its variance
        parts = [share * single_scattering(one) for share, one in through_lens(scene, fine=False)]
        return np.asarray(np.sum(parts, axis=0))

    pictures = np.stack([order_1(replace(wave, shift=number / shifts)) for number in range(shifts)])
    waves = demodulated(pictures, np.zeros((shifts, 1, 1)))
    sheet = waves.sheet
    lit = sheet > LIT * sheet.max(axis=0, keepdims=True)
    if not sheet.any():
        raise ImageError(f"the camera sees nothing of the sheet at z = {wave.z_mm[0]:g}…{wave.z_mm[1]:g} mm; move it")
    factor = np.where(lit, waves.wave / np.where(lit, sheet, 1.0), 0.0)
    blur = _blur(factor, wave, bench, camera)
    blurred = float(np.median(blur[lit]))
    factor = np.where(np.abs(factor * blur) > LEAST, factor * blur, 0.0)
    if not np.any(factor):
        raise ImageError(
            f"period_mm = {wave.period_mm:g}: pixels and lenses leave {100.0 * blurred:.2g} % of a wave so fine, and "
            "nothing to measure; make it longer, or focus"
        )
    return Transfer(wave, factor, blurred)


def _blur(factor: Complex, wave: Wave, bench: Bench, camera: Camera) -> Array:
    """(rows, columns) what blurs of camera and projector, both Gaussian, leave of a wave: exp(−2π²σ²f²)."""
    on_wall = (_of_lens_mm(bench.projector) if bench.projector is not None else 0.0) / wave.period_mm
    turn = float(np.angle(np.sum(factor[1:] * np.conj(factor[:-1]))))
    per_mm = abs(turn) / (2.0 * np.pi * camera.sides_mm[0])
    in_picture = _of_lens_mm(camera) * per_mm
    return np.full(factor.shape, np.exp(-2.0 * np.pi**2 * (on_wall**2 + in_picture**2)))


def _of_lens_mm(device: Camera | Projector) -> float:
    """Standard deviation of a lens's blur: as models have it, or where they have none, as far as fits look away."""
    return device.blur.sigma_mm or device.blur_mm or 0.0
