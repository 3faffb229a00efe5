"""What the window shows, taken along: as a file, or through the clipboard."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QWidget

from tankrig.errors import TankrigError
from ui.window.as_python import as_python
from ui.window.docks import Docks
from ui.window.figure import FIGURE_KINDS, FRAME_KINDS, pixmap_of, save_figure, write_counts
from ui.window.files import ask_where_to_save
from ui.window.live_view import LiveView

if TYPE_CHECKING:
    from ui.window.on_screen import OnScreen
    from ui.window.reader import Reader


class Saving:
    """Asks where to, and saves; what comes of it is told.

    Parameters
    ----------
    window
        Whose picture is saved, and over which questions stand.
    live
        Whose frame is saved.
    docks
        Of which the page in front is saved.
    on_screen
        Says what the pages show.
    reader
        Writes frames, so that the window does not wait for a disk.
    tell
        Says a sentence to the person.
    """

    def __init__(
        self, window: QWidget, live: LiveView, docks: Docks, on_screen: "OnScreen", reader: "Reader",
        tell: Callable[[str], object],
    ) -> None:  # fmt: skip
        self._window, self._live, self._docks = window, live, docks
        self._on_screen, self._reader, self._tell = on_screen, reader, tell

    def save_screenshot(self) -> None:
        """Ask where to, and save what the window shows now."""
        picture = self._window.grab()
        name = f"tankrig-{_now()}.png"

        def save(path: Path) -> None:
            if not picture.save(str(path)):
                self._tell(f"{path}: cannot be written; choose another place")

        ask_where_to_save(self._window, "Save a picture of the window", Path.cwd() / name, "Pictures (*.png)", save)

    def save_frame(self) -> None:
        """Ask where to, and save the counts of the frame on screen as they are: 16 or 8 bits, one channel."""
        frame = self._live.frame
        if frame is None:
            self._tell("there is no picture to save; wait for one, then save it")
            return
        pixels = frame.pixels
        of = frame.run.name if frame.run is not None else f"camera-{_now()}"
        name = f"{of}-{frame.pattern.name if frame.pattern is not None else 'frame'}.tif".replace(" ", "-")

        def save(path: Path) -> None:
            told = f"the frame is saved as {path}"
            self._reader.run(write_counts, path, pixels, then=lambda _: self._tell(told), failed=self._tell)

        ask_where_to_save(self._window, "Save this frame", Path.cwd() / name, FRAME_KINDS, save)

    def save_figure(self) -> None:
        """Ask where to, and save what the page in front shows, as a picture or as a PDF that can be enlarged."""
        title, page = self._docks.in_front()
        source = "-".join(self._on_screen.source.title.replace(":", "").replace(",", "").split()[:4])
        name = f"{title.lower()}-{source}.pdf"

        def save(path: Path) -> None:
            try:
                save_figure(page, path)
            except TankrigError as error:
                self._tell(str(error))
            else:
                self._tell(f"the figure is saved as {path}")

        ask_where_to_save(self._window, f"Save the {title} page as a figure", Path.cwd() / name, FIGURE_KINDS, save)

    def copy_figure(self) -> None:
        """What the page in front shows goes to the clipboard as a picture."""
        QGuiApplication.clipboard().setPixmap(pixmap_of(self._docks.in_front()[1]))

    def copy_as_python(self) -> None:
        """Lines that get the numbers on screen go to the clipboard."""
        text = as_python(self._on_screen.source)
        if text:
            QGuiApplication.clipboard().setText(text)
        else:
            self._tell("there is no run on screen; open one, then copy it as Python")


def _now() -> str:
    return f"{datetime.now():%Y-%m-%dT%H-%M-%S}"
