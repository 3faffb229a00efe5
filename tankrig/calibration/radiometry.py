"""A camera's radiometric calibration, put to use: raw frames become proportional to radiance, with their variance."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
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
_SETTINGS_KEPT = 8


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
            f"the camera was calibrated at gain {measured} and not at {gain:g}; set one of those, or calibrate the "
            f"radiometry anew with the gains {measured}, {gain:g}"
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
        one, dark, scale = self._maps(settings)
        light: Array = one.curve.linear(pixels - dark)
        light *= scale
        return light

    def _maps(self, settings: CameraSettings) -> tuple[Amplified, Array, Array]:
        """Dark and scale of each pixel, in single precision, which is far below any noise; kept for frames to come."""
        if settings not in self._kept:
            one = self.at(settings.gain)
            scale = 1.0 / (self.flat * self._per_ms(one, settings))
            while len(self._kept) >= _SETTINGS_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[settings] = one, self._dark(one, settings).astype(np.float32), scale.astype(np.float32)
        return self._kept[settings]

    @cached_property
    def _kept(self) -> dict[CameraSettings, tuple[Amplified, Array, Array]]:
        return {}

    def mended(self, image: Array) -> Array:
        """Hot pixels replaced by the median of those of their eight neighbours that are not hot."""
        hot, around, known = self._hot_and_around
        if hot.size:
            mended = image.copy()
            values = np.where(known, image.ravel()[around], np.nan)
            mended.ravel()[hot] = np.nanmedian(values, axis=1)
            return mended
        return image

    @cached_property
    def _hot_and_around(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
        """(hot,) hot pixels that have good neighbours, (hot, 9) all those, and which of them are good."""
        rows, columns = self.hot.shape
        row, column = (place[:, None] for place in np.nonzero(self.hot))
        down, right = (step.ravel() for step in np.mgrid[-1:2, -1:2])
        inside = (row + down >= 0) & (row + down < rows) & (column + right >= 0) & (column + right < columns)
        around = np.clip(row + down, 0, rows - 1) * columns + np.clip(column + right, 0, columns - 1)
        known = inside & ~self.hot.ravel()[around]
        mendable = known.any(axis=1)
        return (row * columns + column)[mendable, 0], around[mendable], known[mendable]

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
        except (KeyError, TypeError, ValueError) as error:
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
