"""Fitting the run on screen anew: with which patterns, with what background; and the refits that there are of it."""

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QPushButton, QVBoxLayout, QWidget

from ui.window.flow import Flow
from ui.window.shown import Shown
from ui.window.source import RefitSettings, Source

RECORDED = "as it was recorded"


class RefitRow(QWidget):
    """Ticks for the patterns of the run that is on screen, and a list of its refits."""

    asked = Signal(object)
    """RefitSettings."""
    chosen = Signal(object)
    """Source of a refit that is to be shown, or None for the run as it was recorded."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: Shown | None = None
        self.boxes: list[QCheckBox] = []
        self._ticks = Flow()
        self._free, self.button, self.list = QCheckBox("fit the background"), QPushButton("Fit anew"), QComboBox()
        self._free.setToolTip("fit a constant background too, rather than trust that the dark frames took it out")
        self.button.setToolTip("fit the run on screen to the patterns that are ticked; the run keeps its own fits")
        self.button.clicked.connect(self.ask)
        self.list.setToolTip("which fit of this run is on screen")
        self.list.activated.connect(lambda row: self.chosen.emit(self.list.itemData(row)))
        self._free.toggled.connect(lambda _: self._able())
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(self._ticks)
        column.addLayout(Flow(self._free, self.button, self.list))

    @property
    def settings(self) -> RefitSettings:
        """As ticked, with the phase functions that the run's sequence asks for."""
        patterns = tuple(sorted(box.text() for box in self.boxes if box.isChecked()))
        reading = self._shown.reading if self._shown is not None else None
        return RefitSettings(patterns, self._free.isChecked(), "hg" if reading is None else reading.phase)

    def show_source(self, shown: Shown) -> None:
        """Whose patterns to tick."""
        if self._shown is not None:
            self._shown.read.disconnect(self._tick)
        self._shown = shown
        shown.read.connect(self._tick)
        self._tick()

    def list_refits(self, refits: list[Source], now: Source) -> None:
        """Those that there are, and which one is on screen."""
        self.list.clear()
        self.list.addItem(RECORDED, None)
        for source in refits:
            assert source.settings is not None
            self.list.addItem(f"refit: {source.settings.words}", source)
        self.list.setCurrentIndex(refits.index(now) + 1 if now in refits else 0)
        self.list.setEnabled(bool(refits))

    def ask(self) -> None:
        """Fit anew as ticked."""
        if self.settings.patterns:
            self.asked.emit(self.settings)

    def _tick(self) -> None:
        for box in self.boxes:
            self._ticks.removeWidget(box)
            box.deleteLater()
        shown = self._shown
        reading = shown.reading if shown is not None else None
        settings = shown.source.settings if shown is not None else None
        self.boxes = [QCheckBox(name) for name in (reading.patterns if reading is not None else ())]
        for box in self.boxes:
            box.setChecked(settings is None or box.text() in settings.patterns)
            box.toggled.connect(lambda _: self._able())
            self._ticks.addWidget(box)
        self._free.setChecked(settings is not None and settings.free_background)
        self._free.setEnabled(bool(self.boxes))
        self._able()

    def _able(self) -> None:
        self.button.setEnabled(bool(self.settings.patterns))
        self.button.setToolTip(
            "fit the run on screen to the patterns that are ticked; the run keeps its own fits"
            if self.settings.patterns
            else "open a run and tick at least one pattern to fit it to"
        )
