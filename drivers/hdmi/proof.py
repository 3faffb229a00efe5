"""What an X server can prove of a window's picture on its way out; what it cannot is refused, in a sentence each."""

from functools import lru_cache

from drivers.hdmi.xlib import IDENTITY, Crtc, Rectangle, XDisplay

_ONE_LEVEL = 257
"""Of 256 levels, in a ramp's 65536. A ramp that is off by less leaves the upper eight bits as they are."""
_CTM_ONE = 1 << 32
_CTM_IDENTITY = tuple(_CTM_ONE if one else 0 for one in IDENTITY)


class Proof:
    """Watches over a window on an output.

    Parameters
    ----------
    window
        Its number.
    output
        Of the graphics card, by name.
    accept_compositor
        Whether a person has accepted that another program makes the picture.

    Raises
    ------
    OSError
        When a library is missing or there is no X server.
    """

    def __init__(self, window: int, output: str, accept_compositor: bool) -> None:
        self._window, self._output, self._accept_compositor = window, output, accept_compositor
        self._display = XDisplay()
        self._overlay: int | None = None
        self._visible, self._covered_since = True, False
        self._display.watch_visibility(window)

    def begin(self) -> None:
        """A picture has just been shown: what covered the window before no longer counts."""
        self._look()
        self._covered_since = not self._visible

    def output_is_on(self) -> bool:
        """Whether the output shows a part of the desktop: not once its cable is pulled or it was switched off."""
        return any(self._output in crtc.outputs for crtc in self._display.crtcs())

    def doubt(self) -> str:
        """Why what was shown may not be what has left the output since; empty where everything could be proved."""
        self._look()
        display, window = self._display, self._window
        if display.has_extension("XWAYLAND"):
            return unproved("Wayland")
        place = display.place(window)
        if place is None:
            return "its window is not on the screen; do not minimise it, and stay on its workspace"
        crtcs = display.crtcs()
        return (
            output_doubt(crtcs, self._output, place)
            or colour_doubt(display.property(self._output, "CTM"))
            or self._compositor_doubt()
            or self._cover_doubt(place)
        )

    def _look(self) -> None:
        for visible in self._display.visibilities():
            self._visible = visible
            self._covered_since |= not visible

    def _compositor_doubt(self) -> str:
        if self._display.compositor():
            self._overlay = self._overlay or self._display.overlay()
        redirected = self._display.redirected(self._window)
        if redirected is None:
            redirected = self._display.compositor()
        if not redirected or self._accept_compositor:
            return ""
        return (
            "a compositor makes the screen's picture out of its windows, and may change or delay it; let it leave "
            "full-screen windows alone, end it, or accept it: accept_compositor = true in [projector]"
        )

    def _cover_doubt(self, place: Rectangle) -> str:
        for other in self._display.above(self._window):
            if other.window != self._overlay and overlap(other.place, place):
                what = f'the window "{other.title}"' if other.title else "a window without a name"
                return f"{what} covers its picture, or a part of it; move that to another screen"
        if self._covered_since:
            return "something has covered its picture for a while since it was shown; keep that screen free"
        return ""


def unproved(platform: str) -> str:
    """The refusal where nothing can be proved."""
    return (
        f"{platform} does not tell what becomes of a picture on its way to the screen; log in to an X11 (Xorg) session"
    )


def output_doubt(crtcs: tuple[Crtc, ...], output: str, window: Rectangle) -> str:
    """What the graphics card does to the picture besides sending it to one output pixel by pixel; empty: nothing."""
    own = next((crtc for crtc in crtcs if output in crtc.outputs), None)
    if own is None:
        return f"{output} is switched off; switch it on in the desktop's display settings"
    others = [name for crtc in crtcs if crtc is not own and overlap(crtc.place, own.place) for name in crtc.outputs]
    others += [name for name in own.outputs if name != output]
    if others:
        return (
            f"{output} shows the same part of the desktop as {others[0]} (mirrored); place it beside the other screens "
            f"in the desktop's display settings"
        )
    if not own.upright:
        return f"{output} is turned or mirrored; set its rotation to normal (xrandr --output {output} --rotate normal)"
    if any(abs(one - as_it_is) > 1e-4 for one, as_it_is in zip(own.transform, IDENTITY, strict=True)):
        return f"{output} is scaled or transformed; undo that (xrandr --output {output} --transform none --scale 1x1)"
    if window != own.place:
        return (
            "its window was moved or its video mode changed, so that it does not fill its screen; set the mode that "
            "the rig file says, and leave the window alone"
        )
    for ramp in own.ramps:
        if not unchanged(ramp):
            return (
                f"the brightness or gamma of {output} is changed (night light, calibration, xrandr --brightness); undo "
                f"that (xrandr --output {output} --gamma 1:1:1 --brightness 1)"
            )
    return ""


def colour_doubt(words: tuple[int, ...]) -> str:
    """What the output's colour matrix (CTM: nine numbers of 31.32 bits, low word first) does; empty: nothing."""
    numbers = tuple(low | high << 32 for low, high in zip(words[::2], words[1::2], strict=False))
    if not numbers or all(number == 0 for number in numbers) or numbers == _CTM_IDENTITY:
        return ""
    return "its colours are mixed by a colour matrix (CTM); switch night light and colour management off"


@lru_cache(maxsize=16)  # asked again after each exposure
def unchanged(ramp: tuple[int, ...]) -> bool:
    """Whether a table of what each level becomes leaves all 256 levels of a picture as they are.

    >>> unchanged(tuple(257 * level for level in range(256)))
    True
    >>> unchanged(tuple(256 * level for level in range(256)))  # as some drivers have it
    True
    >>> unchanged(tuple(int(0.98 * 257 * level) for level in range(256)))
    False
    """
    if len(ramp) < 2:
        return True
    step = 65535.0 / (len(ramp) - 1)
    return max(abs(value - step * level) for level, value in enumerate(ramp)) < _ONE_LEVEL


def overlap(one: Rectangle, other: Rectangle) -> bool:
    """Whether two rectangles have a pixel in common.

    >>> overlap((0, 0, 800, 600), (800, 0, 320, 240)), overlap((0, 0, 800, 600), (799, 599, 320, 240))
    (False, True)
    """
    return all(one[axis] < other[axis] + other[axis + 2] and other[axis] < one[axis] + one[axis + 2] for axis in (0, 1))
