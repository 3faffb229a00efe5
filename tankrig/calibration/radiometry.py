"""A camera's radiometric calibration, put to use: raw frames become proportional to radiance, with their variance."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.exposed import Array
from tankrig.calibration.file import Calibration
from tankrig.calibration.linearity import Linearity
from tankrig.calibration.response import Response
from tankrig.checked_toml import checked
from tankrig.devices import CameraSettings, Pixels
from tankrig.errors import ImageError, StoreError

_SAME_GAIN = 1e-3


@dataclass(frozen=True)
class Amplified:
    """A camera at one gain.

    Parameters
    ----------
    gain
        As it is set.
    black_dn, dark_dn_per_ms
        Counts without light and exposure, and per ms in the dark: medians of the pixels.
    dn_per_e, read_noise_e
        Counts of one electron, and standard deviation of reading out.
    full_dn
        Counts above the dark up to which it is linear after correction.
    linearity
        Coefficients of `tankrig.calibration.linearity.Linearity`.
    """

    gain: float
    black_dn: float
    dark_dn_per_ms: float
    dn_per_e: float
    read_noise_e: float
    full_dn: float
    linearity: tuple[float, ...]

    @property
    def curve(self) -> Linearity:
        """To correct with."""
        return Linearity(self.full_dn, self.linearity, (), 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Radiometry:
    """A camera, and the projector's levels, as measured.

    Parameters
    ----------
    amplified
        One for each gain that was calibrated, the lowest first.
    flat
        (rows, columns) response of the pixels, that of the middle being 1.
    dark_excess
        (rows, columns) dark current above the median, counts per ms at the first gain.
    black_excess
        (rows, columns) counts above the median black.
    hot
        (rows, columns) pixels that are not to be believed.
    response
        Of the projector.
    """

    amplified: tuple[Amplified, ...]
    flat: Array
    dark_excess: Array
    black_excess: Array
    hot: NDArray[np.bool_]
    response: Response

    def knows(self, gain: float) -> bool:
        """Whether it was measured at a gain."""
        return any(abs(one.gain / gain - 1.0) < _SAME_GAIN for one in self.amplified)

    def at(self, gain: float) -> Amplified:
        """What was measured at a gain.

        Raises
        ------
        StoreError
            When nothing was.
        """
        for one in self.amplified:
            if abs(one.gain / gain - 1.0) < _SAME_GAIN:
                return one
        measured = ", ".join(f"{one.gain:g}" for one in self.amplified)
        raise StoreError(
            f"the camera was calibrated at gain {measured} and not at {gain:g}; set one of those, or calibrate anew "
            f"(tankrig calibrate radiometry --gains {measured},{gain:g})"
        )

    def corrected(self, pixels: Pixels, settings: CameraSettings) -> Array:
        """(rows, columns) linear counts per ms at the first gain: proportional to radiance, the dark subtracted.

        Hot pixels get the median of their neighbours. Where a frame is saturated, so is this.

        Parameters
        ----------
        pixels
            A raw frame.
        settings
            It was taken with, as read back.

        Raises
        ------
        ImageError
            When the frame has another shape than was calibrated.
        StoreError
            When its gain was not calibrated.
        """
        return self.mended(self.light(pixels, settings))

    def light(self, pixels: Pixels, settings: CameraSettings) -> Array:
        """`corrected`, but for the hot pixels."""
        if pixels.shape != self.flat.shape:
            raise ImageError(
                f"a frame of {list(pixels.shape)} pixels (rows, columns) cannot be corrected by a calibration of "
                f"{list(self.flat.shape)}; calibrate anew (tankrig calibrate radiometry)"
            )
        one = self.at(settings.gain)
        light: Array = one.curve.linear(pixels - self._dark(one, settings)) / self.flat / self._per_ms(one, settings)
        return light

    def mended(self, image: Array) -> Array:
        """Hot pixels replaced by the median of those of their eight neighbours that are not hot."""
        if not self.hot.any():
            return image
        padded = np.pad(np.where(self.hot, np.nan, image), 1, constant_values=np.nan)
        rows, columns = np.nonzero(self.hot)
        around = np.stack([padded[rows + dy, columns + dx] for dy in range(3) for dx in range(3)])
        known = ~np.isnan(around).all(axis=0)
        mended = image.copy()
        mended[rows[known], columns[known]] = np.nanmedian(around[:, known], axis=0)
        return mended

    def variance(self, light: Array, settings: CameraSettings) -> Array:
        """Variance that photons and reading out give to a corrected pixel of the mean `light`."""
        one, per_ms = self.at(settings.gain), self._per_ms(self.at(settings.gain), settings)
        counts = np.maximum(light, 0.0) * self.flat * per_ms + one.dark_dn_per_ms * settings.exposure_ms
        variance: Array = (one.dn_per_e * (counts + one.dn_per_e * one.read_noise_e**2) + 1.0 / 12.0) / (
            self.flat * per_ms
        ) ** 2
        return variance

    def filled(self, light: Array, settings: CameraSettings) -> Array:
        """How far towards saturation a corrected pixel of the mean `light` is."""
        one = self.at(settings.gain)
        linear_full = float(one.curve.linear(np.array(one.full_dn)))
        return light * self.flat * self._per_ms(one, settings) / linear_full

    def saturated(self, pixels: Pixels, settings: CameraSettings) -> NDArray[np.bool_]:
        """(rows, columns) pixels beyond what was found to be linear."""
        one = self.at(settings.gain)
        return np.asarray(pixels - self._dark(one, settings) > 1.01 * one.full_dn)

    def _dark(self, one: Amplified, settings: CameraSettings) -> Array:
        current = one.dark_dn_per_ms + self.dark_excess * (one.dn_per_e / self.amplified[0].dn_per_e)
        dark: Array = one.black_dn + self.black_excess + current * settings.exposure_ms
        return dark

    def _per_ms(self, one: Amplified, settings: CameraSettings) -> float:
        return settings.exposure_ms * one.dn_per_e / self.amplified[0].dn_per_e

    @classmethod
    def of(cls, calibration: Calibration) -> "Radiometry":
        """From its file.

        Raises
        ------
        StoreError
            When the file holds something else.
        """
        where, arrays = str(calibration.path), calibration.arrays
        try:
            curve, leak = calibration.result["projector"]["response"], calibration.result["projector"]["leak"]
            amplified = tuple(
                checked(Amplified, dict(one), where, StoreError) for one in calibration.result["amplified"]
            )
            response = Response(np.array(curve, float), np.array(calibration.sd["projector"]["response"]), float(leak))
            maps = (arrays["flat"], arrays["dark_excess"], arrays["black_excess"], arrays["hot"])
        except (KeyError, TypeError) as error:
            raise StoreError(
                f"{where}: is no radiometric calibration ({error}); give a file of tankrig calibrate radiometry"
            ) from error
        return cls(amplified, *maps, response)

    def table(self) -> tuple[Mapping[str, Any], Mapping[str, NDArray[Any]]]:
        """`result` and `arrays` of its file."""
        projector = {
            "leak": self.response.leak,
            "gamma": self.response.gamma(),
            "response": self.response.curve,
            "level_for_percent": self.response.levels_for(np.arange(101) / 100.0),
        }
        arrays = {name: getattr(self, name).astype(np.float32) for name in ("flat", "dark_excess", "black_excess")}
        return (
            {"amplified": [asdict(one) for one in self.amplified], "projector": projector},
            {**arrays, "hot": self.hot},
        )
