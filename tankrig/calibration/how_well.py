"""How well something was calibrated, in words: the figures of a calibration's file have names for programs."""

from collections.abc import Mapping

_WORDS = {
    "rms_px": "corners off by {:.2g} px (rms)",
    "coverage": "{:.0f} % of the picture covered",
    "views": "{:.0f} views of the board",
    "camera tilt_deg": "views of the board up to {:.0f}° apart",
    "tank tilt_deg": "water's surface leans by {:.2g}°",
    "tilt_sd_deg": "which is known to {:.2g}°",
    "light_scatter_percent": "light unlike a smooth one by {:.2g} %",
    "blur_scatter_percent": "blur over depth off by {:.2g} %",
    "scatter_percent": "left over, with noise, {:.2g} % of the card's light",
    "misfit_percent": "{:.2g} % of the light beside the card is neither halo nor veil",
    "drift_percent": "light drifted by {:.2g} %",
    "median_sd_ms": "median known to {:.2g} ms",
    "flips": "{:.0f} changes of light",
    "linearity_error_percent": "not linear by {:.2g} %",
    "response_error_percent": "response off by {:.2g} %",
    "dn_per_e_sd_percent": "counts per electron known to {:.2g} %",
    "read_noise_sd_percent": "read noise known to {:.2g} %",
}
_SHARES = ("coverage",)
_UNITS = {"percent": "%", "px": "px", "mm": "mm", "ms": "ms", "deg": "°"}


def how_well(kind: str, figures: Mapping[str, float]) -> str:
    """The figures of the quality of a calibration of a kind, the first being the one by which two are compared.

    >>> how_well("camera", {"rms_px": 0.2, "coverage": 0.75})
    'corners off by 0.2 px (rms), 75 % of the picture covered'
    """
    return ", ".join(figure(kind, name, value) for name, value in figures.items())


def figure(kind: str, name: str, value: float) -> str:
    """One of them; one that is not known here, by its name and the unit that this ends in.

    >>> figure("tank", "tilt_deg", 0.0123), figure("tank", "lost_light_percent", 0.1234)
    ("water's surface leans by 0.012°", 'lost light 0.12 %')
    """
    words = _WORDS.get(f"{kind} {name}") or _WORDS.get(name)
    if words is not None:
        return words.format(100.0 * value if name in _SHARES else value)
    what, _, unit = name.rpartition("_")
    if unit not in _UNITS:
        return f"{name.replace('_', ' ')} {value:.3g}"
    return f"{what.replace('_', ' ')} {value:.2g} {_UNITS[unit]}"
