"""The camera's picture, in false colour, with what a person needs to judge it."""

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, Qt, QTimer, Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QHBoxLayout, QLabel, QPushButton, QSlider, QVBoxLayout, QWidget

from tankrig.devices import CameraSettings
from ui.window.fields import NumberField, with_name
from ui.window.flow import Flow
from ui.window.frame_renderer import FrameRenderer, FrameStatistics, Picture, ViewSettings
from ui.window.histogram import Histogram
from ui.window.live_curves import FocusCurve, LineProfile
from ui.window.observed_devices import LatestValue, SeenFrame
from ui.window.picture_regions import PictureRegions
from ui.window.radiometry import radiance_in_words
from ui.window.source import LIVE
from ui.window.tank_plot import TankPlot, pen
from ui.window.theme import set_role
from ui.window.tone import COLOURS, Tone

if TYPE_CHECKING:
    from tankrig.bench import Bench, KnownScenes
    from tankrig.scene.description import Camera
    from ui.window.shown import Shown


GAMMA_PERCENT = 20, 200
PICTURE_PX = 150
STANDING_S = 2.0
"""After so long without a new picture its rate is told no more."""
LEAST_OVER_PX = 150
POINT = "point at the picture to read counts and radiance"
NO_PICTURE = "the camera's picture will stand here"


class LiveView(QWidget):
    """Shows the newest frame of what puts frames into `source`: the camera, or a replay.

    Parameters
    ----------
    source
        Frames to show.
    """

    camera_asked = Signal(object)
    """CameraSettings that a person wants."""
    counted = Signal(object)
    """RegionNow of each region, a few times a second."""
    regions_asked = Signal()
    """A person wants to draw regions."""
    first_shown = Signal()

    def __init__(self, source: LatestValue[SeenFrame]) -> None:
        super().__init__()
        self._renderer = FrameRenderer(source, self._show)
        self._bench: Bench | KnownScenes | None = None
        self._picture: Picture | None = None
        self._levels = (0.0, 65535.0)
        self._asked = CameraSettings(20.0)
        self._rate_at = self._newest_at = 0.0
        self._outlined: NDArray[np.float64] | None = None
        self._cursor: QPointF | None = None
        self.displayed = 0
        self._displayed_before = 0
        self._source = LIVE
        self._shown: Shown | None = None
        self._trouble = ""
        self._free = False
        self._plot = TankPlot()
        self._histogram, self._focus_curve, self.profile = Histogram(), FocusCurve(), LineProfile(self._plot)
        self.profile.moved.connect(self._draw_profile)
        self._histogram.levels_moved.connect(self._set_levels)
        self._beams = pg.PlotDataItem(pen=pen("#39d0ff", 1.2, dashed=True), connect="finite")
        self._plot.plot.addItem(self._beams)
        self.regions = PictureRegions(self._plot)
        self.regions.moved.connect(self._set_view)
        self.regions.listed.connect(self._set_view)
        self._lay_out()
        self._plot.plot.getViewBox().sigTransformChanged.connect(self._set_view)
        self._plot.widget.scene().sigMouseMoved.connect(self._mouse_moved)
        self._standing = QTimer(self)
        self._standing.timeout.connect(self._tell_standing)
        self._standing.start(round(1000.0 * STANDING_S))

    # -- what is shown -------------------------------------------------------------------------------------------------

    def set_bench(self, bench: "Bench | KnownScenes") -> None:
        """Say where pixels lie, and where beams should be."""
        self._bench = bench
        self._set_view()

    def show_source(self, shown: "Shown") -> None:
        """Show frames of this source from now on; a picture that is of another one goes at once."""
        self._shown, self._source = shown, shown.source
        if self._picture is not None and self._picture.frame.run != self._source.recorded:
            self._forget_picture()
        self._say()
        self._show_settings()

    def _forget_picture(self) -> None:
        """What is shown is no longer what is looked at."""
        self._picture = None
        self._plot.clear()
        self._histogram.clear()
        self._beams.setData([], [])
        self._outlined = None
        self._focus_curve.begin()
        self._draw_profile()
        for label in (self._saturated, self._focus, self._rate):
            label.clear()

    def set_camera(self, settings: CameraSettings, free: bool) -> None:
        """What the camera is asked to be set to, and whether a person may change it."""
        self._asked, self._free = settings, free
        self._show_settings()

    def _show_settings(self) -> None:
        """Exposure and gain of the picture; between runs, what a person has asked for."""
        live = self._source.recorded is None
        settings = self._asked if (live and self._free) or self.frame is None else self.frame.settings
        for field, value in ((self._exposure, settings.exposure_ms), (self._gain, settings.gain)):
            field.setEnabled(live and self._free)
            if not field.hasFocus() or not field.isEnabled():
                field.set_value(value)

    @property
    def frame(self) -> SeenFrame | None:
        """The one that is shown."""
        return self._picture.frame if self._picture else None

    def say_trouble(self, words: str) -> None:
        """Why no picture comes from the camera; empty where nothing is wrong."""
        began, self._trouble = bool(words) and not self._trouble, words
        if began and self._source.recorded is None:
            self._forget_picture()  # the last one from a camera that is gone looks like a picture of now
        self._say()

    def say_over(self, words: str) -> None:
        """Say something over the camera's picture; nothing over a recorded one."""
        live = self._source.recorded is None
        self._over.setText(words if live else "")
        self._over.setVisible(bool(words) and live)
        if self._over.isVisible():
            self._over.setFixedWidth(max(LEAST_OVER_PX, self._plot.widget.width() - 2 * self._over.x()))
            self._over.adjustSize()

    def _say(self) -> None:
        """What stands below the picture, or in its place."""
        if self._picture is not None and self._cursor is not None:
            self._read(self._cursor)
        elif self._picture is not None:
            self._read_out.setText(POINT)
        else:
            self._read_out.setText(self._trouble if self._source.recorded is None and self._trouble else NO_PICTURE)

    def close_view(self) -> None:
        """Look at no more frames."""
        self._renderer.close()

    def _show(self) -> None:
        picture = self._renderer.pictures.take()
        if picture is None or self._bench is None or picture.frame.run != self._source.recorded:
            return
        if self._trouble and self._source.recorded is None:  # seen before the rig failed
            return
        before, self._picture = self._picture, picture
        self._plot.show_indices(picture.indices, picture.palette)
        self._plot.place(self._bench.tank, self._camera)
        if before is None:
            self._say()
        if before is None or before.frame.pixels.shape != picture.frame.pixels.shape:
            self._set_view()  # regions lie elsewhere in a picture of another size
        if before is None or before.frame.settings != picture.frame.settings:
            self._show_settings()
        self.displayed += 1
        self._newest_at = time.monotonic()
        if self.displayed == 1:
            self.first_shown.emit()
        if picture.statistics is not None:
            self._tell(picture.statistics)
            self._histogram.show_counts(picture.statistics.often, picture.frame.saturation, picture.tone)

    def _tell_standing(self) -> None:
        """That no picture has come for some time: a rate of before would say that this one is of now."""
        stands_s = time.monotonic() - self._newest_at
        if self._picture is not None and stands_s > STANDING_S:
            live = self._source.recorded is None
            self._rate.setText(f"no new picture for {stands_s:.0f} s" if live else "")

    def _tell(self, statistics: FrameStatistics) -> None:
        """What follows at a slower pace."""
        now = time.monotonic()
        if now - self._rate_at >= 1.0:
            rate = (self.displayed - self._displayed_before) / (now - self._rate_at)
            self._rate_at, self._displayed_before = now, self.displayed
            self._rate.setText(f"{rate:.0f} pictures/s")
        self._saturated.setText(
            f"saturated {statistics.saturated:.2%}" if statistics.saturated else "nothing saturated"
        )
        set_role(self._saturated, "wrong" if statistics.saturated > 0.001 else "faint")
        if statistics.focus is not None:
            self._focus_curve.add(statistics.focus)
            self._focus.setText(f"focus {statistics.focus:.3f}, best {self._focus_curve.best:.3f}")
        self._draw_profile()
        self.counted.emit(statistics.regions)
        if statistics.dark is not None and self._shown is not None:
            self._shown.dark = statistics.dark
        if statistics.outlines is not self._outlined:
            self._outlined = statistics.outlines
            self._beams.setData(statistics.outlines[:, 0], statistics.outlines[:, 1])
        if self._cursor is not None:
            self._read(self._cursor)

    # -- what a person does --------------------------------------------------------------------------------------------

    def _set_view(self) -> None:
        """Have pictures as the boxes say."""
        colours, gamma = self._colours.currentText(), self._gamma.value() / 100.0
        self._gamma_words.setText(f"γ {gamma:.2f}")
        bench = self._bench if self._overlay.isChecked() else None
        every = max(1, int(self._plot.dot_mm / self._bench.camera.pixel_mm)) if self._bench else 1
        self._renderer.render_as(
            ViewSettings(
                Tone(*self._levels, gamma=gamma, colours=colours),
                self._automatic.isChecked(),
                self._saturation.isChecked(),
                self.regions.in_pixels(self._camera, self._bench.tank) if self._bench is not None else (),
                bench,
                every,
            )
        )

    def _set_levels(self, low: float, high: float) -> None:
        self._automatic.setChecked(False)
        self._levels = low, max(high, low + 1.0)
        self._set_view()

    def _keep_levels(self, automatic: bool) -> None:
        """Levels that followed the picture stay as they are when they no longer do."""
        if not automatic and self._picture is not None:
            self._levels = self._picture.tone.low, self._picture.tone.high
        self._set_view()

    def _show_focus(self, shown: bool) -> None:
        self._focus_curve.begin()
        self._focus_curve.widget.setVisible(shown)
        self._focus.setVisible(shown)

    def _show_profile(self, shown: bool) -> None:
        self.profile.show(shown)
        self._draw_profile()

    def _draw_profile(self) -> None:
        self.profile.draw(self.frame.pixels if self.frame is not None else None)

    @property
    def _camera(self) -> "Camera":
        """As the bench has it, with as many pixels as the picture."""
        assert self._bench is not None
        camera = self._bench.camera
        if self.frame is None or self.frame.pixels.shape == camera.shape:
            return camera
        return replace(camera, shape=self.frame.pixels.shape)

    def _mouse_moved(self, at: QPointF) -> None:
        self._cursor = self._plot.plot.getViewBox().mapSceneToView(at)
        self._read(self._cursor)

    def _read(self, at: QPointF) -> None:
        if self.frame is None or self._bench is None:
            return
        rows, columns = self.frame.pixels.shape
        row, column = (int(one // 1) for one in self._plot.pixel_at(at.x(), at.y()))
        if not (0 <= row < rows and 0 <= column < columns):
            self._read_out.setText(POINT)
            return
        counts = int(self.frame.pixels[row, column])
        newest, dark = (self._shown.newest, self._shown.dark) if self._shown is not None else (None, None)
        radiance = radiance_in_words(counts, self.frame.settings, newest.gain if newest is not None else None, dark)
        self._read_out.setText(f"x {at.x():.1f} mm, y {at.y():.1f} mm: {counts} counts, {radiance}")

    def _ask_camera(self) -> None:
        exposure_ms, gain = self._exposure.value, self._gain.value
        if exposure_ms is not None and gain is not None:
            self.camera_asked.emit(CameraSettings(exposure_ms, gain))

    def _lay_out(self) -> None:
        self._colours = QComboBox()
        self._colours.addItems(list(COLOURS))
        self._colours.setToolTip("false colour as in the figures, or grey")
        self._gamma, self._gamma_words = QSlider(Qt.Orientation.Horizontal), QLabel()
        self._gamma.setRange(*GAMMA_PERCENT)
        self._gamma.setValue(50)
        self._gamma.setFixedWidth(70)
        self._gamma.setAccessibleName("gamma of the colours, in percent")
        self._gamma.setToolTip(
            "brightness as this power of the counts: 1 is linear; 0.5, the square root, shows faint light beside beams"
        )
        self._gamma.valueChanged.connect(self._set_view)
        self._automatic, self._saturation = QCheckBox("auto levels"), QCheckBox("saturation")
        self._overlay, regions = QCheckBox("beams"), QPushButton("Regions")
        self._automatic.setToolTip("levels follow the picture; drag the histogram's edges to set them")
        self._saturation.setToolTip("saturated pixels in bright blue")
        self._overlay.setToolTip("dashed: where each beam should be, by the calibration")
        regions.setToolTip("rectangles to drag, and what is counted in them over time (Ctrl+9)")
        regions.clicked.connect(self.regions_asked)
        for box in (self._automatic, self._saturation, self._overlay):
            box.setChecked(True)
        self._colours.currentTextChanged.connect(self._set_view)
        focus, profile = QCheckBox("focus"), QCheckBox("line")
        focus.setToolTip("sharpness over the last minute, with its best held; tick anew to begin anew")
        profile.setToolTip("counts along a line: drag its ends on the picture")
        focus.toggled.connect(self._show_focus)
        profile.toggled.connect(self._show_profile)
        self._overlay.toggled.connect(self._set_view)
        self._saturation.toggled.connect(self._set_view)
        self._automatic.toggled.connect(self._keep_levels)
        whole = QPushButton("Whole")
        whole.setToolTip("show the whole picture again (wheel: zoom, drag: move)")
        whole.clicked.connect(self._plot.fit)
        self._exposure = NumberField("ms", 0.001, 100_000.0, what="exposure of a frame, outside of runs")
        self._gain = NumberField("×", 0.01, 1000.0, what="gain of the camera, outside of runs")
        for field in (self._exposure, self._gain):
            field.edit.setFixedWidth(70)
        self._exposure.committed.connect(self._ask_camera)
        self._gain.committed.connect(self._ask_camera)
        rows = Flow(
            self._colours, with_name(self._gamma_words, self._gamma), whole, regions,
            with_name("exposure", self._exposure), with_name("gain", self._gain), self._automatic, self._saturation,
            self._overlay, focus, profile,
        )  # fmt: skip
        self._read_out = QLabel(NO_PICTURE)
        self._saturated, self._focus, self._rate = QLabel(), QLabel(), QLabel()
        self._focus.hide()
        self._focus.setToolTip("fine structure over brightness; turn the lens until it is largest")
        third = QHBoxLayout()
        for label in (self._saturated, self._focus):
            third.addWidget(label)
        third.addStretch(1)
        third.addWidget(self._rate)
        self._over = QLabel(self._plot.widget)
        self._over.setWordWrap(True)
        self._over.setObjectName("over")
        self._over.move(60, 12)
        self._over.hide()
        column = QVBoxLayout(self)
        column.setContentsMargins(8, 6, 8, 4)
        column.addLayout(rows)
        self._plot.widget.setMinimumHeight(PICTURE_PX)
        column.addWidget(self._plot.widget, 1)
        curves = QHBoxLayout()
        curves.addWidget(self._focus_curve.widget, 1)
        curves.addWidget(self.profile.widget, 1)
        column.addLayout(curves)
        column.addWidget(self._histogram.widget)
        column.addWidget(self._read_out)
        column.addLayout(third)
