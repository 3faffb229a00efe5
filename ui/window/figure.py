"""What a page shows as a figure for a report, and a frame as a file of its counts."""

from pathlib import Path

from PySide6.QtCore import QMarginsF, QPoint, QSizeF
from PySide6.QtGui import QPageSize, QPainter, QPdfWriter, QPixmap
from PySide6.QtWidgets import QWidget

from tankrig.devices import Pixels
from tankrig.errors import StoreError

FIGURE_KINDS = "Figures (*.pdf *.png)"
FRAME_KINDS = "Pictures of counts (*.tif *.tiff *.png)"
FINER = 2.0
"""Dots of a picture for each dot of the screen."""
DPI = 96


def pixmap_of(widget: QWidget) -> QPixmap:
    """A widget as a picture, twice as fine as on screen."""
    picture = QPixmap(widget.size() * FINER)
    picture.setDevicePixelRatio(FINER)
    picture.fill(widget.palette().window().color())
    widget.render(picture)
    return picture


def save_figure(widget: QWidget, path: Path) -> None:
    """Save a widget as it is on screen: as a PDF, whose lines and letters can be enlarged, or as a picture.

    Raises
    ------
    StoreError
        When the file cannot be written.
    """
    if path.suffix.lower() != ".pdf":
        if not pixmap_of(widget).save(str(path)):
            raise StoreError(f"{path}: cannot be written; choose another place, or a name that ends in .pdf or .png")
        return
    writer = QPdfWriter(str(path))
    inches = QSizeF(widget.width() / DPI, widget.height() / DPI)
    writer.setPageSize(QPageSize(inches, QPageSize.Unit.Inch))
    writer.setPageMargins(QMarginsF())
    writer.setResolution(DPI)
    writer.setTitle(path.stem)
    painter = QPainter()
    if not painter.begin(writer):
        raise StoreError(f"{path}: cannot be written; choose another place")
    painter.fillRect(widget.rect(), widget.palette().window())
    widget.render(painter, QPoint())
    if not painter.end():
        raise StoreError(f"{path}: cannot be written to its end; free some space, or choose another place")


def write_counts(path: Path, pixels: Pixels) -> Path:
    """Write a frame's counts as they are, without colours or scaling.

    Raises
    ------
    StoreError
        When the file cannot be written.
    """
    import cv2

    from tankrig.files import whole_file

    suffix = path.suffix.lower() if path.suffix.lower() in (".tif", ".tiff", ".png") else ".tif"
    made, data = cv2.imencode(suffix, pixels)
    if not made:
        raise StoreError(f"{path}: this frame cannot be written as {suffix}; choose .tif")
    try:
        with whole_file(path) as unfinished:
            unfinished.write_bytes(data.tobytes())
    except OSError as error:
        raise StoreError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    return path
