"""The projector's window, in a process of its own: `python -m drivers.hdmi.window` (see `drivers.hdmi.link`).

It is told by lines of JSON what to do, on the socket whose descriptor is its first argument, and ends when the other
side does. The picture's pixels are in the shared memory whose descriptor is its second argument. Without arguments it
lists the screens.
"""

import json
import mmap
import socket
import sys
import time
from typing import Any

from PySide6.QtCore import QObject, QRect, QSocketNotifier, Qt
from PySide6.QtGui import (
    QGuiApplication,
    QImage,
    QPainter,
    QScreen,
    QSurfaceFormat,
)
from PySide6.QtOpenGL import QOpenGLWindow

from drivers.hdmi.awake import keep_awake
from drivers.hdmi.modes import mode_pixels
from drivers.hdmi.proof import Proof, unproved


def described(screen: QScreen) -> dict[str, Any]:
    """What tells this screen from others, and its mode."""
    geometry = screen.geometry()
    return {
        "output": screen.name(),
        "serial": screen.serialNumber(),
        "model": screen.model(),
        "manufacturer": screen.manufacturer(),
        "shape": [geometry.height(), geometry.width()],
        "refresh_hz": screen.refreshRate(),
        "pixel_ratio": screen.devicePixelRatio(),
        "mode_shape": mode_pixels(screen.name()) if QGuiApplication.platformName() == "xcb" else None,
        "primary": screen is QGuiApplication.primaryScreen(),
    }


class PictureWindow(QOpenGLWindow):
    """Shows `picture`, one of its pixels on one of the screen's."""

    def __init__(self, screen: QScreen, picture: QImage) -> None:
        super().__init__()
        self.picture = picture
        self.painted: int | None = None
        self.asked: int | None = None
        self.setFlags(
            Qt.WindowType.FramelessWindowHint
            | Qt.WindowType.WindowStaysOnTopHint
            | Qt.WindowType.WindowDoesNotAcceptFocus
        )
        self.setCursor(Qt.CursorShape.BlankCursor)
        self.setTitle("tankrig projector")
        self.setScreen(screen)
        self.setGeometry(screen.geometry())
        self.setWindowStates(Qt.WindowState.WindowFullScreen)
        self.show()  # showFullScreen would also ask for the keyboard

    def paintGL(self) -> None:  # noqa: N802
        """Draw all of it, whatever was there before."""
        painter = QPainter(self)
        painter.setCompositionMode(QPainter.CompositionMode.CompositionMode_Source)
        painter.drawImage(0, 0, self.picture)
        painter.end()
        self.painted = self.asked


class Projection(QObject):
    """Carries out what is asked for on `connection`, on the screen that is `wanted`."""

    def __init__(self, connection: socket.socket, memory: int) -> None:
        super().__init__()
        self._connection, self._memory = connection, memory
        self._unread = b""
        self._window: PictureWindow | None = None
        self._place = QRect()
        self._awake: object = None
        self._proof: Proof | None = None
        self._unproved = ""
        self._notifier = QSocketNotifier(connection.fileno(), QSocketNotifier.Type.Read, self)
        self._notifier.activated.connect(self._read)

    def _read(self) -> None:
        received = self._connection.recv(65536)
        if not received:
            QGuiApplication.quit()
            return
        *lines, self._unread = (self._unread + received).split(b"\n")
        for line in lines:
            asked = json.loads(line)
            getattr(self, f"_{asked['do']}")(asked)

    def _say(self, **facts: Any) -> None:
        self._connection.sendall(json.dumps(facts).encode() + b"\n")

    def _list(self, asked: dict[str, Any]) -> None:
        self._say(number=asked["number"], screens=[described(screen) for screen in QGuiApplication.screens()])

    def _open(self, asked: dict[str, Any]) -> None:
        output, (rows, columns) = asked["output"], asked["shape"]
        screen = next((s for s in QGuiApplication.screens() if s.name() == output), None)
        if screen is None:
            self._say(gone="its screen is gone")
            return
        pixels = mmap.mmap(self._memory, rows * columns)
        self._picture = QImage(memoryview(pixels), columns, rows, columns, QImage.Format.Format_Indexed8)
        self._picture.setColorTable(asked["colours"])
        self._place = screen.geometry()
        self._screen = screen
        self._window = PictureWindow(screen, self._picture)
        self._window.frameSwapped.connect(self._swapped)
        self._window.screenChanged.connect(self._moved)
        for change in (self._window.xChanged, self._window.yChanged, screen.geometryChanged):
            change.connect(self._moved)
        QGuiApplication.instance().screenRemoved.connect(self._removed)  # type: ignore[union-attr]
        self._awake = keep_awake()
        self._prove(output, asked["accept_compositor"])
        self._say(number=asked["number"], awake=bool(self._awake))

    def _prove(self, output: str, accept_compositor: bool) -> None:
        if QGuiApplication.platformName() != "xcb" or self._window is None:
            self._unproved = unproved(QGuiApplication.platformName().capitalize())
            return
        try:
            self._proof = Proof(int(self._window.winId()), output, accept_compositor)
        except OSError as error:
            self._unproved = f"the X server cannot be asked ({error}); run: sudo apt install libx11-6 libxrandr2"

    def _show(self, asked: dict[str, Any]) -> None:
        if self._window is not None:
            self._window.asked = asked["number"]
            self._window.picture = self._picture.copy()  # else Qt may take an old texture for it
            self._window.update()

    def _check(self, asked: dict[str, Any]) -> None:
        if self._window is None:
            return
        if self._proof is not None and not self._proof.output_is_on():
            self._leave("its screen is gone")  # the X server may know before Qt has heard of it
            return
        self._say(number=asked["number"], doubt=self._proof.doubt() if self._proof else self._unproved)

    def _swapped(self) -> None:
        now_ns = time.monotonic_ns()
        window = self._window
        if window is not None and window.asked is not None and window.painted == window.asked:
            number, window.asked = window.asked, None
            if self._proof is not None:
                self._proof.begin()
            self._say(number=number, swapped_ns=now_ns)

    def _moved(self, *_: object) -> None:
        window = self._window
        if window is not None and (window.screen() is not self._screen or window.geometry() != self._place):
            self._leave("its window was moved, or its video mode changed")
        elif self._screen.geometry() != self._place:
            self._leave("its video mode changed")

    def _removed(self, screen: QScreen) -> None:
        if screen is self._screen:
            self._leave("its screen is gone")

    def _leave(self, reason: str) -> None:
        """Hide before the picture appears on the operator's screen."""
        if self._window is not None:
            self._window.hide()
            self._window.destroy()
            self._window = None
            self._say(gone=reason)


def main(arguments: list[str]) -> int:
    """Be the window until the other side ends."""
    form = QSurfaceFormat()
    form.setSwapInterval(1)
    QSurfaceFormat.setDefaultFormat(form)
    QGuiApplication.setQuitOnLastWindowClosed(False)
    application = QGuiApplication(["tankrig projector"])
    connection = socket.socket(fileno=int(arguments[0]))
    projection = Projection(connection, int(arguments[1]))
    code = application.exec()
    del projection
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
