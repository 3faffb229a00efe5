"""Numbers and sentences as a person at the bench reads them."""

import math
import re


def capitalised(sentence: str) -> str:
    """A sentence with its first letter large, unless it begins with the name of a file or with a symbol.

    >>> capitalised("the rig is not ready"), capitalised("rigs/nothere.toml: cannot be read"), capitalised("σs is 1")
    ('The rig is not ready', 'rigs/nothere.toml: cannot be read', 'σs is 1')
    """
    first = sentence.split(" ", 1)[0]
    as_it_is = re.search(r"[./\\]\w", first) or not first[:1].isascii()
    return sentence if as_it_is else sentence[:1].upper() + sentence[1:]


def duration(seconds: float) -> str:
    """A time in words.

    >>> duration(4.2), duration(95.0), duration(7300.0)
    ('4 s', '1 min 35 s', '2 h 01 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def calibrated(kind: str) -> str:
    """What a kind of calibration is called.

    >>> calibrated("stray"), calibrated("camera")
    ('stray light', 'camera')
    """
    return "stray light" if kind == "stray" else kind


def volume(volume_ul: float) -> str:
    """A volume of ink.

    >>> volume(0.0), volume(12.5), volume(1600.0), volume(float("inf"))
    ('0 µl', '12.5 µl', '1.6 ml', 'an unknown volume')
    """
    if not math.isfinite(volume_ul):
        return "an unknown volume"
    return f"{volume_ul / 1000.0:.4g} ml" if volume_ul >= 1000.0 else f"{volume_ul:.4g} µl"


def size(count_bytes: float) -> str:
    """An amount of data.

    >>> size(5e4), size(3.2e6), size(2.3e10)
    ('0.1 MB', '3.2 MB', '23 GB')
    """
    return f"{count_bytes / 1e9:.3g} GB" if count_bytes >= 1e9 else f"{count_bytes / 1e6:.1f} MB"
