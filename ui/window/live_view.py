"""The camera's picture, in false colour, with what a person needs to judge it."""

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from tankrig.devices import CameraSettings
from tankrig.errors import SceneError, SequenceError
from tankrig.image.focus import sharpness
from tankrig.scene.outline import beam_outlines
from ui.window.fields import NumberField
from ui.window.histogram import Histogram
from ui.window.radiometry import Radiometry
from ui.window.tank_plot import TankPlot, pen
from ui.window.tone import COLOURS, Tone, automatic
from ui.window.watched import Newest, SeenFrame

if TYPE_CHECKING:
    from tankrig.bench import Bench

SLOW_S = 0.2
"""Histogram, focus and read-outs follow the picture at this pace."""
FOCUS_PX = 512


class LiveView(QWidget):
    """Shows the newest frame of what puts frames into `source`: the camera, or a replay.

    Parameters
    ----------
    source
        Frames to show.
    """

    camera_asked = Signal(object)
    """CameraSettings that a person wants."""

    def __init__(self, source: Newest[SeenFrame]) -> None:
        super().__init__()
        self._source = source
        source.arrived.connect(self._show)
        self._bench: Bench | None = None
        self._frame: SeenFrame | None = None
        self._tone = Tone()
        self._table, self._palette = self._tone.table(), self._tone.palette()
        self._slow_at = self._rate_at = 0.0
        self._outlined = ""
        self._cursor: QPointF | None = None
        self.displayed = 0
        self._displayed_before = 0
        self.radiometry = Radiometry()
        self._picture = TankPlot()
        self._histogram = Histogram()
        self._histogram.levels_moved.connect(self._set_levels)
        self._beams = pg.PlotDataItem(pen=pen("#39d0ff", 1.2, dashed=True), connect="finite")
        self._picture.plot.addItem(self._beams)
        self._roi = pg.RectROI((60, -20), (60, 40), pen=pen("#9cff57", 2.0))
        self._roi.hide()
        self._picture.plot.addItem(self._roi)
        self._lay_out()
        self._picture.widget.scene().sigMouseMoved.connect(self._mouse_moved)
        self._show()  # what came before there was a view

    # -- what is shown -------------------------------------------------------------------------------------------------

    def set_bench(self, bench: "Bench") -> None:
        """Say where pixels lie, and where beams should be."""
        self._bench, self._outlined = bench, ""

    def set_camera(self, settings: CameraSettings, free: bool) -> None:
        """What the camera is set to, and whether a person may change it."""
        for field, value in ((self._exposure, settings.exposure_ms), (self._gain, settings.gain)):
            field.setEnabled(free)
            if not field.hasFocus():
                field.set_value(value)

    @property
    def frame(self) -> SeenFrame | None:
        """The one that is shown."""
        return self._frame

    def say_empty(self, words: str) -> None:
        """What to say where there is no picture."""
        if self._frame is None:
            self._read_out.setText(words)

    def _show(self) -> None:
        frame = self._source.take()
        if frame is None or self._bench is None:
            return
        self._frame = frame
        now = time.monotonic()
        slow = now - self._slow_at > SLOW_S
        if slow:
            self._slow_at = now
            self._judge(frame)
        camera = self._bench.camera
        if frame.pixels.shape != camera.shape:
            camera = replace(camera, shape=frame.pixels.shape)
        self._picture.show_indices(self._table[frame.pixels], self._palette)
        self._picture.place(self._bench.tank, camera)
        self.displayed += 1

    def _judge(self, frame: SeenFrame) -> None:
        """What follows at a slower pace: levels, histogram, focus, numbers."""
        if self._automatic.isChecked():
            self._use(self._tone.between(*automatic(frame.pixels)))
        if self._saturation.isChecked() != (self._tone.saturation is not None):
            self._use(replace(self._tone, saturation=frame.saturation if self._saturation.isChecked() else None))
        self.radiometry.see(frame)
        self._histogram.show_counts(frame.pixels, frame.saturation, self._tone)
        self._outline(frame)
        self._tell(frame)

    def _tell(self, frame: SeenFrame) -> None:
        part = float((frame.pixels >= frame.saturation).mean())
        now = time.monotonic()
        if now - self._rate_at >= 1.0:
            rate = (self.displayed - self._displayed_before) / (now - self._rate_at)
            self._rate_at, self._displayed_before = now, self.displayed
            self._rate.setText(f"{rate:.0f} pictures/s")
        self._saturated.setText(f"saturated {part:.2%}" if part else "nothing saturated")
        self._saturated.setProperty("role", "wrong" if part > 0.001 else "faint")
        self._saturated.style().polish(self._saturated)
        self._focus.setText(f"focus {sharpness(self._looked_at(frame)):.3f}")
        if self._roi.isVisible():
            inside = self._looked_at(frame)
            self._roi_text.setText(f"region {inside.mean():.1f} ± {inside.std():.1f} counts")
        if self._cursor is not None:
            self._read(self._cursor)

    def _looked_at(self, frame: SeenFrame) -> NDArray[np.unsignedinteger]:
        """The region of interest, or the middle of the picture."""
        rows, columns = frame.pixels.shape
        if self._roi.isVisible() and self._bench is not None:
            pixel_mm, low = self._bench.camera.pixel_mm, -self._bench.tank.size_mm[1] / 2
            at, size = self._roi.pos(), self._roi.size()
            left, right = (int(np.clip(edge / pixel_mm, 0, columns)) for edge in (at.x(), at.x() + size.x()))
            bottom, top = (int(np.clip((edge - low) / pixel_mm, 0, rows)) for edge in (at.y(), at.y() + size.y()))
            if right - left > 2 and top - bottom > 2:
                return frame.pixels[bottom:top, left:right]
        half = FOCUS_PX // 2
        middle = (
            slice(max(0, rows // 2 - half), rows // 2 + half),
            slice(max(0, columns // 2 - half), columns // 2 + half),
        )
        return frame.pixels[middle]

    def _outline(self, frame: SeenFrame) -> None:
        """Where the beams of the pattern that is shown should be."""
        from tankrig.live.exposures import ANY

        wanted = frame.pattern.hash if frame.pattern is not None and self._overlay.isChecked() else "none"
        if wanted == self._outlined or self._bench is None:
            return
        self._outlined = wanted
        lines: list[NDArray[np.float64]] = []
        if frame.pattern is not None and wanted != "none":
            try:
                outlines = beam_outlines(self._bench.scene(frame.pattern, ANY))
            except (SceneError, SequenceError):
                outlines = []  # a dark pattern has no beams
            for outline in outlines if len(outlines) <= 200 else []:
                lines += [np.vstack([outline, outline[:1], np.full((1, 2), np.nan)])]
        points = np.vstack(lines) if lines else np.empty((0, 2))
        self._beams.setData(points[:, 0], points[:, 1])

    # -- what a person does --------------------------------------------------------------------------------------------

    def _use(self, tone: Tone) -> None:
        if tone != self._tone:
            self._tone = tone
            self._table, self._palette = tone.table(), tone.palette()

    def _set_levels(self, low: float, high: float) -> None:
        self._automatic.setChecked(False)
        self._use(self._tone.between(low, high))
        self._redraw()

    def _set_tone(self) -> None:
        colours, root = self._colours.currentText(), self._scale.currentText() == "square root"
        self._use(replace(self._tone, colours=colours, root=root))
        self._redraw()

    def _redraw(self) -> None:
        if self._frame is not None:
            self._picture.show_indices(self._table[self._frame.pixels], self._palette)
            self._judge(self._frame)

    def _mouse_moved(self, at: QPointF) -> None:
        self._cursor = self._picture.plot.getViewBox().mapSceneToView(at)
        self._read(self._cursor)

    def _read(self, at: QPointF) -> None:
        if self._frame is None or self._bench is None:
            return
        pixel_mm, low = self._bench.camera.pixel_mm, -self._bench.tank.size_mm[1] / 2
        rows, columns = self._frame.pixels.shape
        row, column = int((at.y() - low) // pixel_mm), int(at.x() // pixel_mm)
        if not (0 <= row < rows and 0 <= column < columns):
            self._read_out.setText("point at the picture to read counts and radiance")
            return
        counts = int(self._frame.pixels[row, column])
        radiance = self.radiometry.words(counts, self._frame)
        self._read_out.setText(f"x {at.x():.1f} mm, y {at.y():.1f} mm: {counts} counts, {radiance}")

    def _ask_camera(self) -> None:
        exposure_ms, gain = self._exposure.value, self._gain.value
        if exposure_ms is not None and gain is not None:
            self.camera_asked.emit(CameraSettings(exposure_ms, gain))

    def _lay_out(self) -> None:
        self._colours, self._scale = QComboBox(), QComboBox()
        self._colours.addItems(list(COLOURS))
        self._colours.setToolTip("false colour as in the figures, or grey")
        self._scale.addItems(["square root", "linear"])
        self._scale.setToolTip("square root: faint scattered light shows beside beams")
        self._automatic, self._saturation = QCheckBox("auto levels"), QCheckBox("saturation")
        self._overlay, region = QCheckBox("beams"), QCheckBox("region")
        self._automatic.setToolTip("levels follow the picture; drag the histogram's edges to set them")
        self._saturation.setToolTip("saturated pixels in bright blue")
        self._overlay.setToolTip("dashed: where each beam should be, by the calibration")
        region.setToolTip("a rectangle to drag; mean and focus are those of what is inside")
        for box in (self._automatic, self._saturation, self._overlay):
            box.setChecked(True)
        for combo in (self._colours, self._scale):
            combo.currentTextChanged.connect(self._set_tone)
        region.toggled.connect(self._roi.setVisible)
        self._overlay.toggled.connect(self._redraw)
        self._saturation.toggled.connect(self._redraw)
        whole = QPushButton("Whole")
        whole.setToolTip("show the whole picture again (wheel: zoom, drag: move)")
        whole.clicked.connect(self._picture.fit)
        self._exposure = NumberField("ms", 0.001, 100_000.0, what="exposure of a frame, outside of runs")
        self._gain = NumberField("×", 0.01, 1000.0, what="gain of the camera, outside of runs")
        self._exposure.committed.connect(self._ask_camera)
        self._gain.committed.connect(self._ask_camera)
        first = QHBoxLayout()
        for widget in (
            self._colours,
            self._scale,
            whole,
            QLabel("exposure"),
            self._exposure,
            QLabel("gain"),
            self._gain,
        ):
            first.addWidget(widget)
        first.addStretch(1)
        second = QHBoxLayout()
        for box in (self._automatic, self._saturation, self._overlay, region):
            second.addWidget(box)
        second.addStretch(1)
        self._read_out = QLabel("point at the picture to read counts and radiance")
        self._saturated, self._focus, self._rate, self._roi_text = QLabel(), QLabel(), QLabel(), QLabel()
        self._focus.setToolTip("fine structure over brightness; turn the lens until it is largest")
        third = QHBoxLayout()
        for label in (self._saturated, self._focus, self._roi_text):
            third.addWidget(label)
        third.addStretch(1)
        third.addWidget(self._rate)
        column = QVBoxLayout(self)
        column.setContentsMargins(8, 6, 8, 4)
        column.addLayout(first)
        column.addLayout(second)
        column.addWidget(self._picture.widget, 1)
        column.addWidget(self._histogram.widget)
        column.addWidget(self._read_out)
        column.addLayout(third)
