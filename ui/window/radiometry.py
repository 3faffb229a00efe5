"""From counts to radiance, as far as the last fit and the last dark frame of a source allow."""

from tankrig.devices import CameraSettings


def radiance_in_words(counts: int, settings: CameraSettings, gain: float | None, dark: float | None) -> str:
    """The radiance of a pixel in words.

    Parameters
    ----------
    counts
        Of the pixel.
    settings
        Of the camera.
    gain
        Counts per ms and W/mm²/sr, by the last fit; None before there is one.
    dark
        Counts without light, by the last dark frame; None before there is one.

    Examples
    --------
    >>> radiance_in_words(1100, CameraSettings(10.0), 2000.0, 100.0)
    '0.05 W/mm²/sr'
    """
    if gain is None:
        return "radiance after the first fit"
    if dark is None:
        return "radiance after the first dark frame"
    per_ms = (counts - dark) / (settings.exposure_ms * settings.gain or 1.0)
    return f"{per_ms / gain:.3g} W/mm²/sr"
