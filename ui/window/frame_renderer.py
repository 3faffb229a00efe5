"""From frames to pictures, in a thread of its own: the window's thread has only to paint them."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt

from tankrig.errors import SceneError, SequenceError
from tankrig.image.focus import sharpness
from tankrig.run.regions import Region
from ui.window.observed_devices import LatestValue, SeenFrame
from ui.window.threads import OwnedThread
from ui.window.tone import Tone, automatic, how_often

if TYPE_CHECKING:
    from tankrig.bench import Bench, KnownScenes
    from tankrig.pattern import Pattern
    from tankrig.scene import Beam, Projector, Scene

SLOW_S = 0.2
"""Statistics of frames follow them at this pace."""
FOCUS_PX = 512
TOUCHING_MM = 1e-6
LEAST_PX = 2
"""A region with sides no longer than this has no focus."""
MOST_OUTLINES = 200
END_S = 5.0


@dataclass(frozen=True)
class ViewSettings:
    """How a person has chosen to see frames.

    Parameters
    ----------
    tone
        How counts become colours.
    automatic
        Whether its ends follow the picture.
    saturation
        Whether saturated pixels have a colour of their own.
    regions
        Rectangles that are counted in; focus is taken of the first, and of the middle where there is none.
    bench
        Where beams should be; None where they are not to be outlined.
    every
        Of so many rows and columns one is shown: the screen has no more.
    """

    tone: Tone = field(default_factory=Tone)
    automatic: bool = True
    saturation: bool = True
    regions: tuple[Region, ...] = ()
    bench: "Bench | KnownScenes | None" = None
    every: int = 1


@dataclass(frozen=True)
class RegionNow:
    """Mean and standard deviation of the counts in a region of one frame."""

    region: Region
    mean: float
    sd: float


@dataclass(frozen=True, eq=False)
class FrameStatistics:
    """What can be said of a frame.

    Parameters
    ----------
    often
        How often each count occurs in every fourth row and column.
    saturated
        Part of the pixels.
    focus
        Sharpness of the first region, or of the middle; None of the very first frame, whose picture does not wait for
        OpenCV to be imported.
    regions
        What is counted in each region.
    dark
        Median of a frame without light, counts.
    outlines
        (points, 2) x and y in mm of where beams should be, with NaN between them.
    """

    often: NDArray[np.intp]
    saturated: float
    focus: float | None
    regions: tuple[RegionNow, ...]
    dark: float | None
    outlines: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Picture:
    """A frame, ready to be painted.

    Parameters
    ----------
    frame
        What it is of.
    indices
        Into `palette`, of every so many rows and columns.
    palette
        (256, 3) colours.
    tone
        Which made them.
    statistics
        A few times a second, and of the last frame, however soon it came after another.
    """

    frame: SeenFrame
    indices: NDArray[np.uint8]
    palette: NDArray[np.uint8]
    tone: Tone
    statistics: FrameStatistics | None


class FrameRenderer:
    """Makes the newest frame of `source` a picture; older ones are let go.

    Parameters
    ----------
    source
        Of frames.
    shown
        Called for pictures that wait to be taken, in the thread of its owner; known before there is any, since one that
        nobody was told of would be the last.

    Attributes
    ----------
    pictures
        Where they come out.
    """

    def __init__(self, source: LatestValue[SeenFrame], shown: Callable[[], object]) -> None:
        self.pictures: LatestValue[Picture] = LatestValue()
        self.pictures.arrived.connect(shown)
        self._source = source
        self._view, self._view_changed = ViewSettings(), False
        self._frame: SeenFrame | None = None
        self._statistics_s = 0.0
        self._wake = threading.Event()
        source.arrived.connect(self._wake.set, Qt.ConnectionType.DirectConnection)
        self._thread = OwnedThread("frame-renderer", self._work, END_S)
        self._wake.set()  # for what came before

    def render_as(self, view: ViewSettings) -> None:
        """Have pictures like this from now on, the one that is shown included."""
        if view != self._view:
            self._view, self._view_changed = view, True
            self._wake.set()

    def close(self) -> None:
        """End the thread."""
        self._source.arrived.disconnect(self._wake.set)
        self._thread.ending.set()
        self._wake.set()
        self._thread.close()

    def _work(self, ending: threading.Event) -> None:
        tone: Tone | None = None
        first, behind = True, False
        while not ending.is_set():
            self._wake.wait(SLOW_S if behind else None)
            self._wake.clear()
            changed, self._view_changed = self._view_changed, False
            new = self._source.take()
            self._frame = frame = new or self._frame
            due = changed or time.monotonic() - self._statistics_s > SLOW_S
            if ending.is_set() or frame is None or not (new or changed or (behind and due)):
                continue
            view, statistics = self._view, None
            behind = not due
            if due:
                self._statistics_s = time.monotonic()
                statistics = statistics_of(frame, view, focus=not first)
                first = False
            tone = _tone(view, frame, tone, statistics)
            table, palette = _developed(tone)
            indices = np.take(table, frame.pixels[:: view.every, :: view.every], mode="clip")
            self.pictures.put(Picture(frame, indices, palette, tone, statistics))


def statistics_of(frame: SeenFrame, view: ViewSettings, focus: bool = True) -> FrameStatistics:
    """Levels, saturation, focus and what is counted in the regions of a frame."""
    pixels = frame.pixels
    parts = [region.of(pixels) for region in view.regions]
    sharp = next((part for part in parts if min(part.shape) > LEAST_PX), pixels[_middle(pixels.shape)])
    dark = frame.pattern is not None and not frame.pattern.pixels.any()
    return FrameStatistics(
        how_often(pixels),
        np.count_nonzero(pixels >= frame.saturation) / pixels.size,
        sharpness(sharp) if focus else None,
        tuple(
            RegionNow(region, float(part.mean()), float(part.std()))
            for region, part in zip(view.regions, parts, strict=True)
            if part.size
        ),
        float(np.median(pixels[::4, ::4])) if dark else None,
        _outlines(view.bench, frame.pattern),
    )


def _tone(view: ViewSettings, frame: SeenFrame, before: Tone | None, statistics: FrameStatistics | None) -> Tone:
    """As chosen; automatic ends stay where they were until they are off by more than one can see."""
    tone = replace(view.tone, saturation=frame.saturation if view.saturation else None)
    if not view.automatic:
        return tone
    if before is not None:
        tone = tone.between(before.low, before.high)
    if statistics is None:
        return tone
    low, high = automatic(statistics.often)
    off = max(abs(low - tone.low), abs(high - tone.high))
    return tone.between(low, high) if off > 0.02 * (high - low) else tone


@lru_cache(8)
def _developed(tone: Tone) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return tone.table(), tone.palette()


@lru_cache(8)
def _outlines(bench: "Bench | KnownScenes | None", pattern: "Pattern | None") -> NDArray[np.float64]:
    """Where the beams of the pattern that is shown should be."""
    from tankrig.scene.description import Medium
    from tankrig.scene.outline import beam_outlines

    water = Medium(0.0, 0.01, 0.0)  # any will do
    try:
        scene = bench.scene(pattern, water) if bench and pattern else None
        lit = None if scene is None else replace(scene, projector=_put_together(scene.projector))
        outlines = [] if lit is None else [_on_water(one, lit) for one in beam_outlines(lit)]
    except (SceneError, SequenceError):
        outlines = []  # a dark pattern has no beams
    apart = np.full((1, 2), np.nan)
    lines = [np.vstack([one, one[:1], apart]) for one in outlines if len(outlines) <= MOST_OUTLINES]
    return np.vstack(lines) if lines else np.empty((0, 2))


def _put_together(projector: "Projector") -> "Projector":
    """The same light with one beam for those that touch side by side: of a smooth wave each column is one."""
    beams: list[Beam] = []
    for beam in sorted(projector.beams, key=lambda one: (one.z_mm, one.y_mm)):
        last = beams[-1] if beams else None
        if last is not None and last.z_mm == beam.z_mm and abs(last.y_mm[1] - beam.y_mm[0]) < TOUCHING_MM:
            beams[-1] = replace(last, y_mm=(last.y_mm[0], beam.y_mm[1]))
        else:
            beams.append(beam)
    return replace(projector, beams=tuple(beams))


def _on_water(outline: NDArray[np.float64], scene: "Scene") -> NDArray[np.float64]:
    """From a calibrated camera's own picture, in which outlines are told, to x and y of the water, on which it lies."""
    from ui.window.tank_plot import pixels_to_mm

    tall, wide = scene.camera.sides_mm
    to_mm = pixels_to_mm(scene.camera, scene.tank)
    pixels = (outline + np.array([0.0, 0.5 * scene.tank.size_mm[1]])) / np.array([wide, tall])
    return np.array([to_mm.map(column, row) for column, row in pixels.tolist()])


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (slice(max(0, (side - FOCUS_PX) // 2), (side + FOCUS_PX) // 2) for side in shape)
    return rows, columns
