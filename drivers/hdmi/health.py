"""Which screens are connected, and whether the projector among them is fit."""

import shutil
from collections.abc import Iterator, Mapping
from statistics import median
from typing import Any

from drivers.check import Check
from drivers.health import Found

from .link import Screen, list_screens


def find() -> Iterator[Found]:
    """Screens, by what they say of themselves."""
    for screen in list_screens():
        yield Found(f"screen {screen}{', the main one' if screen.primary else ''}", _lines(screen))


def checks(settings: Mapping[str, Any], device: Any) -> Iterator[Check]:
    """That it swaps as it should, is not the operator's, and stays awake."""
    screen = settings.get("screen")
    stable = isinstance(screen, dict) and bool(screen.get("serial") or screen.get("model"))
    yield Check(
        "projector is named by its identity", stable or None, str(screen),
        "give projector.screen its serial or model (tankrig devices lists them), if it says them",
    )  # fmt: skip
    if device is None:
        return
    yield Check("projector swaps steadily", True, f"every {median(device.swap_ms):.2f} ms")
    yield Check(
        "the screen is kept from blanking", device.kept_awake or None, "asked the desktop and the X server",
        "switch the screen saver and power saving off",
    )  # fmt: skip
    yield Check(
        "the video mode can be told from scaling", bool(shutil.which("xrandr")) or None, "by xrandr",
        "run: sudo apt install x11-xserver-utils",
    )  # fmt: skip


def _lines(screen: Screen) -> str:
    said = [f'{key} = "{value}"' for key in ("serial", "model") if (value := getattr(screen, key))]
    identity = ", ".join(said) or f'output = "{screen.output}"'
    return (
        f'[projector]\ndriver = "hdmi-projector"\nscreen = {{ {identity} }}\nshape = {list(screen.shape)}\n'
        f"refresh_hz = {screen.refresh_hz:.2f}\nlatency_ms = 50.0  # tankrig doctor measures it"
    )
