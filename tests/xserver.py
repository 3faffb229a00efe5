"""A real X server with two named outputs, the second of which can be unplugged, and what is on its screens."""

import ctypes
import ctypes.util
import itertools
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

CONFIGURATION = """
Section "ServerFlags"
  Option "AutoAddDevices" "false"
EndSection
Section "Device"
  Identifier "card"
  Driver "dummy"
  VideoRam 65536
EndSection
Section "Monitor"
  Identifier "operator"
  HorizSync 5-1000
  VertRefresh 5-500
  Modeline "800x600" 40.0 800 840 968 1056 600 601 605 628
EndSection
Section "Screen"
  Identifier "screen"
  Device "card"
  Monitor "operator"
  DefaultDepth 24
  SubSection "Display"
    Depth 24
    Virtual 1600 1200
    Modes "800x600"
  EndSubSection
EndSection
"""
OPERATOR, PROJECTOR = "DUMMY0", "DUMMY1"
_ARGUMENTS = "-novtswitch -sharevts -nolisten tcp -ac".split()  # noqa: SIM905
# Numbers of this worker's own: of two servers that look for a free one at a time, one that ends takes the other's
# socket away.
_NUMBERS = itertools.count(100 + 200 * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")))


def start_x_server(program: str, *arguments: str | Path) -> tuple[subprocess.Popen, str]:
    """The server's process, and its display's name; the name is empty if it doesn't start."""
    for number in itertools.islice(_NUMBERS, 20):
        if Path(f"/tmp/.X{number}-lock").exists():
            continue
        reader, writer = os.pipe()
        # A server that starts anew when its last client leaves refuses whoever comes in that moment.
        command = [program, f":{number}", "-noreset", "-displayfd", str(writer), *arguments]
        server = subprocess.Popen(command, pass_fds=(writer,), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(writer)
        with os.fdopen(reader) as ready:
            if ready.readline().strip():
                return server, f":{number}"
        stop_x_server(server)
    return server, ""


def stop_x_server(server: subprocess.Popen) -> None:
    server.terminate()
    server.wait(10.0)


class XServer:
    """Outputs DUMMY0 (800×600, the operator's) and DUMMY1 (320×240 at 60 Hz, to its right, the projector's)."""

    def __init__(self, folder: Path) -> None:
        if not (shutil.which("Xorg") and shutil.which("xrandr")):
            pytest.skip("needs Xorg with its dummy driver, and xrandr")
        (folder / "xorg.conf").write_text(CONFIGURATION)
        files = "-config", folder / "xorg.conf", "-logfile", folder / "xorg.log"
        self._process, self.display = start_x_server("Xorg", *files, *_ARGUMENTS)
        if not self.display:
            pytest.skip(f"Xorg does not start here; see {folder}/xorg.log")
        self.environment = {**os.environ, "DISPLAY": self.display, "QT_QPA_PLATFORM": "xcb"}
        timing = map(str, (320, 328, 360, 400, 240, 242, 244, 250))
        self.xrandr("--newmode", "projector", "6.0", *timing)
        self.xrandr("--addmode", PROJECTOR, "projector")
        self.plug_in()

    def xrandr(self, *arguments: str) -> None:
        subprocess.run(["xrandr", *arguments], env=self.environment, check=True, capture_output=True, timeout=20.0)

    def plug_in(self) -> None:
        self.xrandr("--output", PROJECTOR, "--mode", "projector", "--pos", "800x0")

    def unplug(self) -> None:
        self.xrandr("--output", PROJECTOR, "--off")

    def identify(self, serial: str, model: str) -> None:
        """Give the projector's output an EDID."""
        with _Display(self.display) as display:
            display.set_edid(PROJECTOR, edid(serial, model))
        # Screens are described anew when outputs change.
        self.unplug()
        self.plug_in()

    def seen(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        """(rows, columns, 3) red, green, blue that are in the frame buffer there."""
        with _Display(self.display) as display:
            return display.image(x, y, width, height)

    def blanked(self) -> bool:
        """Whether the screen saver is on."""
        with _Display(self.display) as display:
            return display.screen_saver_is_on()

    def mix_colours(self, numbers: tuple[int, ...]) -> None:
        """Give the projector's output a colour matrix, as night light does: words of 32 bits."""
        words = (ctypes.c_ulong * len(numbers))(*numbers)  # what Xlib takes for 32 bits
        with _Display(self.display) as display:
            display.set_property(PROJECTOR, b"CTM", 32, words, len(numbers))

    @contextmanager
    def window(self, x: int, y: int, width: int, height: int, title: str = "another window") -> Iterator[None]:
        """Another program's window, above all others."""
        with _Display(self.display) as display:
            display.open_window(x, y, width, height, title)
            yield

    @contextmanager
    def insisting_window(self, x: int, y: int, width: int, height: int) -> Iterator[None]:
        """A window that comes back above all others every few milliseconds, whoever is above it meanwhile."""
        done = threading.Event()

        def insist() -> None:
            with _Display(self.display) as display:
                window = display.open_window(x, y, width, height, "the first of all")
                while not done.wait(0.005):
                    display.raise_window(window)

        insisting = threading.Thread(target=insist)
        insisting.start()
        try:
            yield
        finally:
            done.set()
            insisting.join(10.0)

    @contextmanager
    def compositor(self) -> Iterator[None]:
        """A program that has all windows drawn into memory, from which the server makes the picture."""
        with _Display(self.display) as display:
            display.redirect()
            yield

    def unmap(self, title: str) -> None:
        command = ["xdotool", "search", "--onlyvisible", "--name", title, "windowunmap"]
        subprocess.run(command, env=self.environment, check=True, timeout=20.0)

    def close(self) -> None:
        stop_x_server(self._process)


def until(condition, timeout_s: float = 10.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def edid(serial: str, model: str) -> bytes:
    """What a screen says of itself; made by "TRG"."""
    block = bytearray(128)
    block[:20] = bytes.fromhex("00ffffffffffff005247341200000000011e0103")
    block[8:10] = sum((ord(c) - 64) << (10 - 5 * i) for i, c in enumerate("TRG")).to_bytes(2, "big")
    for start, kind, text in ((72, 0xFF, serial), (90, 0xFC, model)):
        block[start : start + 18] = bytes([0, 0, 0, kind, 0]) + f"{text}\n".ljust(13).encode()
    block[127] = -sum(block) % 256
    return bytes(block)


class _XImage(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_int) for name in ("width", "height", "xoffset", "format")),
        ("data", ctypes.POINTER(ctypes.c_ubyte)),
        *((name, ctypes.c_int) for name in ("byte_order", "unit", "bit_order", "pad", "depth", "bytes_per_line")),
    ]


class _Display:
    """As much of Xlib as this needs."""

    def __init__(self, name: str) -> None:
        self._x11 = ctypes.CDLL(ctypes.util.find_library("X11"))
        for function in ("XOpenDisplay", "XGetImage", "XDefaultRootWindow", "XInternAtom"):
            getattr(self._x11, function).restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x11.XOpenDisplay(name.encode()))
        assert self._display, f"no X server at {name}"
        self._root = ctypes.c_void_p(self._x11.XDefaultRootWindow(self._display))

    def __enter__(self) -> "_Display":
        return self

    def __exit__(self, *_: object) -> None:
        self._x11.XCloseDisplay(self._display)

    def image(self, x: int, y: int, width: int, height: int) -> np.ndarray:
        address = self._x11.XGetImage(self._display, self._root, x, y, width, height, ctypes.c_ulong(0xFFFFFF), 2)
        image = ctypes.cast(address, ctypes.POINTER(_XImage)).contents
        raw = np.ctypeslib.as_array(image.data, (height, image.bytes_per_line)).copy()
        self._x11.XFree(image.data)
        return raw[:, : 4 * width].reshape(height, width, 4)[..., 2::-1]

    def open_window(self, x: int, y: int, width: int, height: int, title: str) -> ctypes.c_ulong:
        self._x11.XCreateSimpleWindow.restype = ctypes.c_ulong
        window = ctypes.c_ulong(
            self._x11.XCreateSimpleWindow(
                self._display, self._root, x, y, width, height, 0, ctypes.c_ulong(0), ctypes.c_ulong(0)
            )
        )
        self._x11.XStoreName(self._display, window, title.encode())
        self._x11.XMapRaised(self._display, window)
        self._x11.XSync(self._display, 0)
        return window

    def raise_window(self, window: ctypes.c_ulong) -> None:
        self._x11.XRaiseWindow(self._display, window)
        self._x11.XSync(self._display, 0)

    def redirect(self) -> None:
        composite = ctypes.CDLL(ctypes.util.find_library("Xcomposite"))
        composite.XCompositeRedirectSubwindows(self._display, self._root, 0)
        self._x11.XSync(self._display, 0)

    def screen_saver_is_on(self) -> bool:
        saver = ctypes.CDLL(ctypes.util.find_library("Xss"))
        facts = (ctypes.c_ulong * 8)()  # Window, int state, …
        saver.XScreenSaverQueryInfo(self._display, self._root, ctypes.byref(facts))
        return int(facts[1]) & 0xFFFFFFFF == 1

    def set_edid(self, output: str, block: bytes) -> None:
        self.set_property(output, b"EDID", 8, block, len(block))

    def set_property(self, output: str, name: bytes, bits: int, data: object, count: int) -> None:
        xrandr = ctypes.CDLL(ctypes.util.find_library("Xrandr"))
        xrandr.XRRGetScreenResources.restype = ctypes.c_void_p
        resources = xrandr.XRRGetScreenResources(self._display, self._root)
        # struct: Time, Time, int ncrtc, RRCrtc *, int noutput, RROutput *
        words = ctypes.cast(resources, ctypes.POINTER(ctypes.c_ulong))
        outputs = ctypes.cast(words[5], ctypes.POINTER(ctypes.c_ulong))
        number = int(output.removeprefix("DUMMY"))
        atom = ctypes.c_ulong(self._x11.XInternAtom(self._display, name, 0))
        xrandr.XRRChangeOutputProperty(
            self._display, ctypes.c_ulong(outputs[number]), atom, ctypes.c_ulong(19), bits, 0, data, count
        )
        self._x11.XSync(self._display, 0)
