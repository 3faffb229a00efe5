"""From frames to pictures, in a thread of its own: the window's thread has only to paint them."""

import threading
import time
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt

from tankrig.errors import SceneError, SequenceError
from tankrig.image.focus import sharpness
from ui.window.threads import OwnedThread
from ui.window.tone import Tone, automatic, how_often
from ui.window.watched import Newest, SeenFrame

if TYPE_CHECKING:
    from tankrig.bench import Bench, KnownScenes
    from tankrig.pattern import Pattern

SLOW_S = 0.2
"""What is judged of frames follows them at this pace."""
FOCUS_PX = 512
MOST_OUTLINES = 200
END_S = 5.0


@dataclass(frozen=True)
class Wishes:
    """How a person wants to see frames.

    Parameters
    ----------
    tone
        How counts become colours.
    automatic
        Whether its ends follow the picture.
    saturation
        Whether saturated pixels have a colour of their own.
    region
        Rows and columns that mean and focus are taken of; None for the middle.
    bench
        Where beams should be; None where they are not to be outlined.
    every
        Of so many rows and columns one is shown: the screen has no more.
    """

    tone: Tone = field(default_factory=Tone)
    automatic: bool = True
    saturation: bool = True
    region: tuple[slice, slice] | None = None
    bench: "Bench | KnownScenes | None" = None
    every: int = 1


@dataclass(frozen=True, eq=False)
class Judgement:
    """What can be said of a frame.

    Parameters
    ----------
    often
        How often each count occurs in every fourth row and column.
    saturated
        Part of the pixels.
    focus
        Sharpness of the region.
    mean, sd
        Of the region, counts.
    dark
        Median of a frame without light, counts.
    outlines
        (points, 2) x and y in mm of where beams should be, with NaN between them.
    """

    often: NDArray[np.intp]
    saturated: float
    focus: float
    mean: float
    sd: float
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
        Into `palette`, of the rows and columns that were wished.
    palette
        (256, 3) colours.
    tone
        Which made them.
    judgement
        A few times a second.
    """

    frame: SeenFrame
    indices: NDArray[np.uint8]
    palette: NDArray[np.uint8]
    tone: Tone
    judgement: Judgement | None


class Darkroom:
    """Makes the newest frame of `source` a picture; older ones are let go.

    Attributes
    ----------
    pictures
        Where they come out.
    """

    def __init__(self, source: Newest[SeenFrame]) -> None:
        self.pictures: Newest[Picture] = Newest()
        self._source = source
        self._wishes, self._wished = Wishes(), False
        self._frame: SeenFrame | None = None
        self._judged_s = 0.0
        self._wake = threading.Event()
        source.arrived.connect(self._wake.set, Qt.ConnectionType.DirectConnection)
        self._thread = OwnedThread("darkroom", self._work, END_S)
        self._wake.set()  # for what came before

    def wish(self, wishes: Wishes) -> None:
        """Have pictures like this from now on, the one that is shown included."""
        if wishes != self._wishes:
            self._wishes, self._wished = wishes, True
            self._wake.set()

    def close(self) -> None:
        """End the thread."""
        self._source.arrived.disconnect(self._wake.set)
        self._thread.ending.set()
        self._wake.set()
        self._thread.close()

    def _work(self, ending: threading.Event) -> None:
        tone: Tone | None = None
        while self._wake.wait() and not ending.is_set():
            self._wake.clear()
            wished, self._wished = self._wished, False
            new = self._source.take()
            self._frame = frame = new or self._frame
            if frame is None or not (new or wished):
                continue
            wishes, judgement = self._wishes, None
            if wished or time.monotonic() - self._judged_s > SLOW_S:
                self._judged_s = time.monotonic()
                judgement = judge(frame, wishes)
            tone = _tone(wishes, frame, tone, judgement)
            table, palette = _developed(tone)
            indices = np.take(table, frame.pixels[:: wishes.every, :: wishes.every], mode="clip")
            self.pictures.put(Picture(frame, indices, palette, tone, judgement))


def judge(frame: SeenFrame, wishes: Wishes) -> Judgement:
    """What a person needs to judge a frame by."""
    pixels = frame.pixels
    region = pixels[wishes.region or _middle(pixels.shape)]
    dark = frame.pattern is not None and not frame.pattern.pixels.any()
    return Judgement(
        how_often(pixels),
        np.count_nonzero(pixels >= frame.saturation) / pixels.size,
        sharpness(region),
        float(region.mean()),
        float(region.std()),
        float(np.median(pixels[::4, ::4])) if dark else None,
        _outlines(wishes.bench, frame.pattern),
    )


def _tone(wishes: Wishes, frame: SeenFrame, before: Tone | None, judgement: Judgement | None) -> Tone:
    """As wished; automatic ends stay where they were until they are off by more than one can see."""
    tone = replace(wishes.tone, saturation=frame.saturation if wishes.saturation else None)
    if not wishes.automatic:
        return tone
    if before is not None:
        tone = tone.between(before.low, before.high)
    if judgement is None:
        return tone
    low, high = automatic(judgement.often)
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
        outlines = beam_outlines(bench.scene(pattern, water)) if bench and pattern else []
    except (SceneError, SequenceError):
        outlines = []  # a dark pattern has no beams
    apart = np.full((1, 2), np.nan)
    lines = [np.vstack([one, one[:1], apart]) for one in outlines if len(outlines) <= MOST_OUTLINES]
    return np.vstack(lines) if lines else np.empty((0, 2))


def _middle(shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (slice(max(0, (side - FOCUS_PX) // 2), (side + FOCUS_PX) // 2) for side in shape)
    return rows, columns
