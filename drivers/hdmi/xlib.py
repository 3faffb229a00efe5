"""As much of Xlib, RandR and Composite as it takes to see what becomes of a window's picture before it goes out."""

import ctypes
import ctypes.util
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_char_p, c_int, c_long, c_uint, c_ulong, c_ushort, c_void_p
from dataclasses import dataclass
from typing import Any

Rectangle = tuple[int, int, int, int]
"""x, y, width, height; in pixels of the desktop."""


@dataclass(frozen=True)
class Crtc:
    """A part of the graphics card that sends one picture out, to one or several outputs.

    Parameters
    ----------
    place
        Of the desktop, which it sends.
    outputs
        That it sends to.
    upright
        Whether it neither turns nor mirrors.
    transform
        Nine numbers by which it scales and moves; 1, 0, 0, 0, 1, 0, 0, 0, 1 where it does not.
    ramps
        Red, green and blue that each level becomes, 0 to 65535; empty where it has no such table.
    """

    place: Rectangle
    outputs: tuple[str, ...]
    upright: bool
    transform: tuple[float, ...]
    ramps: tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class WindowAbove:
    """A window that may be seen, above another in the stack."""

    window: int
    title: str
    place: Rectangle


class XDisplay:
    """A connection to the X server that DISPLAY names.

    Raises
    ------
    OSError
        When a library is missing or there is no server.
    """

    def __init__(self) -> None:
        self._x11, self._randr = _library("X11", _X11), _library("Xrandr", _RANDR)
        try:
            self._composite: ctypes.CDLL | None = _library("Xcomposite", _COMPOSITE)
        except OSError:
            self._composite = None
        self._names: dict[int, str] = {}
        self._failed = False
        self._handler = _ERROR_HANDLER(self._note_error)  # Xlib's own ends the program
        self._display = self._x11.XOpenDisplay(None)
        if not self._display:
            raise OSError("no X server")
        self._x11.XSetErrorHandler(self._handler)
        self._root = self._x11.XDefaultRootWindow(self._display)

    def close(self) -> None:
        """End the connection."""
        if self._display:
            self._x11.XCloseDisplay(self._display)
            self._display = None

    def has_extension(self, name: str) -> bool:
        """Whether the server has it."""
        numbers = (c_int(), c_int(), c_int())
        return bool(self._x11.XQueryExtension(self._display, name.encode(), *map(byref, numbers)))

    def watch_visibility(self, window: int) -> None:
        """Let the server tell when the window is covered."""
        self._x11.XSelectInput(self._display, window, _VISIBILITY_CHANGE_MASK)
        self._x11.XSync(self._display, 0)

    def visibilities(self) -> Iterator[bool]:
        """For each change since the last call, whether nothing covered any of the watched window then."""
        self._x11.XSync(self._display, 0)
        event = (c_long * 24)()
        while self._x11.XPending(self._display):
            self._x11.XNextEvent(self._display, event)
            told = ctypes.cast(event, POINTER(_VisibilityEvent)).contents
            if told.type == _VISIBILITY_NOTIFY:
                yield told.state == _UNOBSCURED

    def place(self, window: int) -> Rectangle | None:
        """Where on the desktop the window is; None where it cannot be seen (minimised, on another workspace, gone)."""
        attributes = self._attributes(window)
        if attributes is None or attributes.map_state != _VIEWABLE:
            return None
        x, y, child = c_int(), c_int(), c_ulong()
        self._x11.XTranslateCoordinates(
            self._display, window, self._root, 0, 0, byref(x), byref(y), byref(child)
        )  # fmt: skip
        return x.value, y.value, attributes.width, attributes.height

    def above(self, window: int) -> tuple[WindowAbove, ...]:
        """Windows that may be seen, above the one that holds `window`, the lowest first."""
        top = self.top_level(window)
        stack = self._children(self._root)
        found = []
        for other in stack[stack.index(top) + 1 :] if top in stack else ():
            attributes = self._attributes(other)
            if attributes and attributes.map_state == _VIEWABLE and attributes.window_class == _INPUT_OUTPUT:
                border = 2 * attributes.border_width
                place = (attributes.x, attributes.y, attributes.width + border, attributes.height + border)
                found.append(WindowAbove(other, self._title(other), place))
        return tuple(found)

    def top_level(self, window: int) -> int:
        """The window right below the root that holds `window`: a window manager's frame, or itself."""
        while True:
            parent = self._parent(window)
            if not parent or parent == self._root:
                return window
            window = parent

    def crtcs(self) -> tuple[Crtc, ...]:
        """All that are on."""
        with self._resources() as resources:
            found = (self._crtc(resources, resources.crtcs[i]) for i in range(resources.ncrtc))
            return tuple(crtc for crtc in found if crtc is not None)

    def property(self, output: str, name: str) -> tuple[int, ...]:
        """Numbers of 32 bits that an output has as a property; empty where it has no such."""
        with self._resources() as resources:
            for i in range(resources.noutput):
                if self._name(resources, resources.outputs[i]) == output:
                    return self._numbers(resources.outputs[i], name)
        return ()

    def compositor(self) -> bool:
        """Whether a program composes the desktop's windows into one picture."""
        return bool(self._x11.XGetSelectionOwner(self._display, self._atom("_NET_WM_CM_S0")))

    def redirected(self, window: int) -> bool | None:
        """Whether the window is drawn into memory, and another program makes the picture; None: cannot be told."""
        if self._composite is None:
            return None
        self._failed = False
        pixmap = self._composite.XCompositeNameWindowPixmap(self._display, self.top_level(window))
        self._x11.XSync(self._display, 0)
        if self._failed:  # BadMatch: it is drawn where it is
            return False
        self._x11.XFreePixmap(self._display, pixmap)
        return True

    def overlay(self) -> int | None:
        """The window above all others that compositors draw on; only to be asked for where there is a compositor."""
        if self._composite is None:
            return None
        window: int = self._composite.XCompositeGetOverlayWindow(self._display, self._root)
        self._composite.XCompositeReleaseOverlayWindow(self._display, self._root)
        return window

    def _note_error(self, _display: Any, _event: Any) -> int:
        self._failed = True
        return 0

    def _atom(self, name: str) -> int:
        atom: int = self._x11.XInternAtom(self._display, name.encode(), 0)
        return atom

    def _attributes(self, window: int) -> Any:
        attributes = _WindowAttributes()
        return attributes if self._x11.XGetWindowAttributes(self._display, window, byref(attributes)) else None

    def _tree(self, window: int) -> tuple[int | None, list[int]]:
        root, parent, children, count = c_ulong(), c_ulong(), POINTER(c_ulong)(), c_uint()
        found = self._x11.XQueryTree(
            self._display, window, byref(root), byref(parent), byref(children), byref(count)
        )  # fmt: skip
        if not found:
            return None, []
        listed = list(children[: count.value]) if count.value else []
        if children:
            self._x11.XFree(children)
        return parent.value, listed

    def _parent(self, window: int) -> int | None:
        return self._tree(window)[0]

    def _children(self, window: int) -> list[int]:
        """From the lowest to the highest."""
        return self._tree(window)[1]

    def _title(self, window: int) -> str:
        """Its own, or that of the window which a window manager's frame holds."""
        for one in (window, *self._children(window)):
            name = c_char_p()
            if self._x11.XFetchName(self._display, one, byref(name)) and name:
                title = (name.value or b"").decode(errors="replace")
                self._x11.XFree(name)
                return title
        return ""

    @contextmanager
    def _resources(self) -> Iterator[Any]:
        resources = self._randr.XRRGetScreenResourcesCurrent(self._display, self._root)
        try:
            yield resources.contents
        finally:
            self._randr.XRRFreeScreenResources(resources)

    def _name(self, resources: Any, output: int) -> str:
        """An output's number stands for the same name as long as the connection lasts."""
        if output not in self._names:
            self._names[output] = self._asked_name(resources, output)
        return self._names[output]

    def _asked_name(self, resources: Any, output: int) -> str:
        facts = self._randr.XRRGetOutputInfo(self._display, byref(resources), output)
        if not facts:
            return ""
        name = (facts.contents.name or b"").decode(errors="replace")
        self._randr.XRRFreeOutputInfo(facts)
        return name

    def _crtc(self, resources: Any, crtc: int) -> Crtc | None:
        facts = self._randr.XRRGetCrtcInfo(self._display, byref(resources), crtc)
        if not facts:
            return None
        try:
            one = facts.contents
            if not one.mode:
                return None
            outputs = tuple(self._name(resources, one.outputs[i]) for i in range(one.noutput))
            place = (one.x, one.y, one.width, one.height)
            return Crtc(place, outputs, one.rotation == _ROTATE_0, self._transform(crtc), self._ramps(crtc))
        finally:
            self._randr.XRRFreeCrtcInfo(facts)

    def _transform(self, crtc: int) -> tuple[float, ...]:
        attributes = POINTER(_TransformAttributes)()
        if not self._randr.XRRGetCrtcTransform(self._display, crtc, byref(attributes)) or not attributes:
            return IDENTITY
        numbers = tuple(number / 65536.0 for number in attributes.contents.current)
        self._x11.XFree(attributes)
        return numbers

    def _ramps(self, crtc: int) -> tuple[tuple[int, ...], ...]:
        if not self._randr.XRRGetCrtcGammaSize(self._display, crtc):
            return ()
        gamma = self._randr.XRRGetCrtcGamma(self._display, crtc)
        if not gamma:
            return ()
        one = gamma.contents
        ramps = tuple(tuple(ramp[: one.size]) for ramp in (one.red, one.green, one.blue))
        self._randr.XRRFreeGamma(gamma)
        return ramps

    def _numbers(self, output: int, name: str) -> tuple[int, ...]:
        kind, bits, count, rest, data = c_ulong(), c_int(), c_ulong(), c_ulong(), c_void_p()
        self._randr.XRRGetOutputProperty(
            self._display, output, self._atom(name), 0, 64, 0, 0, 0,
            byref(kind), byref(bits), byref(count), byref(rest), byref(data),
        )  # fmt: skip
        if not data:
            return ()
        words = ctypes.cast(data, POINTER(c_ulong))[: count.value] if bits.value == 32 else []  # Xlib's "32" is a long
        self._x11.XFree(data)
        return tuple(word & 0xFFFFFFFF for word in words)


IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

_VISIBILITY_NOTIFY, _UNOBSCURED, _VISIBILITY_CHANGE_MASK = 15, 0, 1 << 16
_VIEWABLE, _INPUT_OUTPUT, _ROTATE_0 = 2, 1, 1


class _VisibilityEvent(ctypes.Structure):
    _fields_ = (
        ("type", c_int), ("serial", c_ulong), ("send_event", c_int), ("display", c_void_p), ("window", c_ulong),
        ("state", c_int),
    )  # fmt: skip


class _WindowAttributes(ctypes.Structure):
    _fields_ = (
        *((name, c_int) for name in ("x", "y", "width", "height", "border_width", "depth")),
        ("visual", c_void_p), ("root", c_ulong),
        *((name, c_int) for name in ("window_class", "bit_gravity", "win_gravity", "backing_store")),
        ("backing_planes", c_ulong), ("backing_pixel", c_ulong), ("save_under", c_int), ("colormap", c_ulong),
        ("map_installed", c_int), ("map_state", c_int),
        *((name, c_long) for name in ("all_event_masks", "your_event_mask", "do_not_propagate_mask")),
        ("override_redirect", c_int), ("screen", c_void_p),
    )  # fmt: skip


class _Resources(ctypes.Structure):
    _fields_ = (
        ("timestamp", c_ulong), ("config_timestamp", c_ulong), ("ncrtc", c_int), ("crtcs", POINTER(c_ulong)),
        ("noutput", c_int), ("outputs", POINTER(c_ulong)), ("nmode", c_int), ("modes", c_void_p),
    )  # fmt: skip


class _CrtcInfo(ctypes.Structure):
    _fields_ = (
        ("timestamp", c_ulong), ("x", c_int), ("y", c_int), ("width", c_uint), ("height", c_uint), ("mode", c_ulong),
        ("rotation", c_ushort), ("noutput", c_int), ("outputs", POINTER(c_ulong)), ("rotations", c_ushort),
        ("npossible", c_int), ("possible", POINTER(c_ulong)),
    )  # fmt: skip


class _OutputInfo(ctypes.Structure):
    _fields_ = (("timestamp", c_ulong), ("crtc", c_ulong), ("name", c_char_p), ("name_length", c_int))
    """Its beginning."""


class _Gamma(ctypes.Structure):
    _fields_ = (("size", c_int), *((name, POINTER(c_ushort)) for name in ("red", "green", "blue")))


class _TransformAttributes(ctypes.Structure):
    _fields_ = (
        ("pending", c_int * 9), ("pending_filter", c_char_p), ("pending_count", c_int), ("pending_numbers", c_void_p),
        ("current", c_int * 9), ("current_filter", c_char_p), ("current_count", c_int), ("current_numbers", c_void_p),
    )  # fmt: skip


_ERROR_HANDLER = ctypes.CFUNCTYPE(c_int, c_void_p, c_void_p)
_D, _W = c_void_p, c_ulong
_X11 = {
    "XOpenDisplay": (_D, c_char_p),
    "XCloseDisplay": (c_int, _D),
    "XDefaultRootWindow": (_W, _D),
    "XSetErrorHandler": (c_void_p, _ERROR_HANDLER),
    "XQueryExtension": (c_int, _D, c_char_p, c_void_p, c_void_p, c_void_p),
    "XSelectInput": (c_int, _D, _W, c_long),
    "XSync": (c_int, _D, c_int),
    "XPending": (c_int, _D),
    "XNextEvent": (c_int, _D, c_void_p),
    "XTranslateCoordinates": (c_int, _D, _W, _W, c_int, c_int, c_void_p, c_void_p, c_void_p),
    "XGetWindowAttributes": (c_int, _D, _W, c_void_p),
    "XQueryTree": (c_int, _D, _W, c_void_p, c_void_p, c_void_p, c_void_p),
    "XFetchName": (c_int, _D, _W, c_void_p),
    "XFree": (c_int, c_void_p),
    "XFreePixmap": (c_int, _D, _W),
    "XInternAtom": (_W, _D, c_char_p, c_int),
    "XGetSelectionOwner": (_W, _D, _W),
}
_RANDR = {
    "XRRGetScreenResourcesCurrent": (POINTER(_Resources), _D, _W),
    "XRRFreeScreenResources": (None, c_void_p),
    "XRRGetOutputInfo": (POINTER(_OutputInfo), _D, c_void_p, _W),
    "XRRFreeOutputInfo": (None, c_void_p),
    "XRRGetCrtcInfo": (POINTER(_CrtcInfo), _D, c_void_p, _W),
    "XRRFreeCrtcInfo": (None, c_void_p),
    "XRRGetCrtcTransform": (c_int, _D, _W, c_void_p),
    "XRRGetCrtcGammaSize": (c_int, _D, _W),
    "XRRGetCrtcGamma": (POINTER(_Gamma), _D, _W),
    "XRRFreeGamma": (None, c_void_p),
    "XRRGetOutputProperty": (
        c_int, _D, _W, _W, c_long, c_long, c_int, c_int, _W, c_void_p, c_void_p, c_void_p, c_void_p, c_void_p,
    ),
}  # fmt: skip
_COMPOSITE = {
    "XCompositeNameWindowPixmap": (_W, _D, _W),
    "XCompositeGetOverlayWindow": (_W, _D, _W),
    "XCompositeReleaseOverlayWindow": (None, _D, _W),
}


def _library(name: str, functions: dict[str, Any]) -> ctypes.CDLL:
    """A shared library with the types of its functions: result, then arguments."""
    found = ctypes.util.find_library(name)
    if found is None:
        raise OSError(f"lib{name} is missing")
    library = ctypes.CDLL(found)
    for function, (result, *arguments) in functions.items():
        getattr(library, function).restype = result
        getattr(library, function).argtypes = arguments
    return library
