"""The true pixels of an X11 output's video mode, which differ from what Qt tells where the X server scales."""

import re
import shutil
import subprocess


def mode_pixels(output: str) -> list[int] | None:
    """[rows, columns] of the mode that `output` is in, as xrandr tells; None where that program is missing."""
    if shutil.which("xrandr") is None:
        return None
    told = subprocess.run(["xrandr", "--query", "--verbose"], capture_output=True, text=True, timeout=5.0, check=False)
    return current_mode(told.stdout, output)


def current_mode(told: str, output: str) -> list[int] | None:
    """Find it in what `xrandr --verbose` prints.

    >>> current_mode('''HDMI-1 connected 1280x800+0+0 (0x4a) normal (normal left)
    ...   640x480 (0x4a) 25.175MHz -HSync *current
    ...         h: width   640 start  656 end  752 total  800 skew    0 clock  31.47KHz
    ...         v: height  480 start  490 end  492 total  525           clock  59.94Hz
    ... ''', "HDMI-1")
    [480, 640]
    """
    parts = re.split(r"^(\S+) (?:connected|disconnected)", told, flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    found = re.search(r"\*current.*\n\s+h: width\s+(\d+).*\n\s+v: height\s+(\d+)", sections.get(output, ""))
    return [int(found[2]), int(found[1])] if found else None
