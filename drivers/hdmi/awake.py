"""Keeps the screen from blanking while the window is open; whoever holds it off is forgotten when this process ends."""

import ctypes
import ctypes.util

from PySide6.QtDBus import QDBusConnection, QDBusInterface, QDBusMessage
from PySide6.QtGui import QGuiApplication

_SERVICE, _PATH = "org.freedesktop.ScreenSaver", "/org/freedesktop/ScreenSaver"


def keep_awake() -> list[object]:
    """Ask the desktop (D-Bus) and the X server not to blank; returns what must be kept, empty if neither listened."""
    return [hold for hold in (_ask_desktop(), _ask_x_server()) if hold is not None]


def _ask_desktop() -> object | None:
    bus = QDBusConnection.sessionBus()
    if not bus.isConnected():
        return None
    saver = QDBusInterface(_SERVICE, _PATH, _SERVICE, bus)
    reply = saver.call("Inhibit", "tankrig", "a projector shows patterns")
    return None if reply.type() == QDBusMessage.MessageType.ErrorMessage else saver


def _ask_x_server() -> object | None:
    """XScreenSaverSuspend holds off the screen saver and DPMS until its connection ends."""
    names = [ctypes.util.find_library(name) for name in ("X11", "Xss")]
    if QGuiApplication.platformName() != "xcb" or not all(names):
        return None
    x11, saver = (ctypes.CDLL(name) for name in names)
    x11.XOpenDisplay.restype = ctypes.c_void_p
    display = ctypes.c_void_p(x11.XOpenDisplay(None))
    if not display:
        return None
    saver.XScreenSaverSuspend(display, 1)
    x11.XForceScreenSaver(display, 0)  # it may be on already
    x11.XSync(display, 0)
    return display
