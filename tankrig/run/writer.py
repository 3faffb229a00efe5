"""The thread that puts a run on disk: frames and events go in, and come back out once they are safe."""

import fcntl
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from tankrig.devices import Frame, Pixels
from tankrig.errors import StoreError
from tankrig.run import disk
from tankrig.run.damage import JournalText
from tankrig.run.folder import (
    chunk_numbers,
    frames_for_writing,
    has_checksums,
    require_no_links,
    resize_frames,
    storing,
    write_frame,
)
from tankrig.run.journal import Event, Kind, Moment
from tankrig.run.journal_io import JOURNAL, read_journal, read_settings
from tankrig.run.reading import digest

Announce = Callable[[Event, Pixels | None], object]

QUEUE_BYTES = 64 * 2**20
_FRAMES_PER_COMMIT = 8
_THREADS = 3
"""One takes checksums while the others write, and wait for the disk."""
_NICENESS = 5
_TIMEOUT_S = 30.0


@dataclass(frozen=True, eq=False)
class _Entry:
    event: Event
    pixels: Pixels | None = None


class RunWriter:
    """Records into the run at `path`, one owner at a time; several threads may put.

    A frame or an event is *acknowledged* when `announce` is called with it: chunk, folder, journal line, each synced.
    What is put keeps its order. When the disk is slower than the experiment, putting waits; nothing is dropped.

    Parameters
    ----------
    path
        A run's folder, new or interrupted. A torn end of its journal is set aside; damaged lines stay where they are,
        and numbers of events and frames go on beyond all that may have had one: no frame is ever written over.
    announce
        Called in the writer's thread with each acknowledged event, and the pixels of a frame; must not wait.
    planned_frames
        Of the whole run, to lay out again what was trimmed.

    Raises
    ------
    StoreError
        When the folder is no run, is being recorded by another program, or cannot be written. An error of the disk
        while recording is raised by the next call.
    """

    def __init__(self, path: Path, announce: Announce | None = None, planned_frames: int = 0) -> None:
        read_settings(path)
        self.path = path
        self._announce = announce or (lambda *_: None)
        with storing(path, "open it for recording"):
            require_no_links(path)
            self._lock = lock_journal(path)
            try:
                text = read_journal(path)
                set_torn_end_aside(path, text)
                if not text.ended:
                    disk.append(path / JOURNAL, b"\n")
                self._frames = frames_for_writing(path)
                self._index = _next_index(path, text)
                if planned_frames > self._frames.shape[0]:
                    resize_frames(path, self._frames, planned_frames)
            except BaseException:
                os.close(self._lock)
                raise
        self.events = text.events
        self._seq = text.next_seq
        self._checksums = has_checksums(self._frames)
        frame_bytes = int(np.prod(self._frames.shape[1:])) * self._frames.dtype.itemsize
        self._room = max(2, QUEUE_BYTES // frame_bytes)
        self._waiting: deque[_Entry] = deque()
        self._change = threading.Condition()
        self._busy = False
        self._closing = False
        self._error: Exception | None = None
        self._pool = ThreadPoolExecutor(_THREADS, "run-frames", _give_way)
        self._thread = threading.Thread(target=self._work, name="run-writer", daemon=True)
        self._thread.start()

    def put(self, kind: Kind, /, **fields: Any) -> None:
        """Record an event; returns before it is acknowledged."""
        self._put(kind, fields, None)

    def put_frame(self, frame: Frame, step: int, pattern_hash: str, **fields: Any) -> int:
        """Record a frame; gives its number before it is acknowledged, and waits where the disk lags behind."""
        if frame.pixels.shape != self._frames.shape[1:] or frame.pixels.dtype != self._frames.dtype:
            raise StoreError(
                f"{self.path}: a frame of {frame.pixels.shape} {frame.pixels.dtype} does not fit the run's "
                f"{self._frames.shape[1:]} {self._frames.dtype}; keep the camera's format during a run"
            )
        times = {"exposure_start_ns": frame.exposure_start_ns, "device_ns": frame.device_ns, "host_ns": frame.host_ns}
        fields = {"step": step, "pattern_hash": pattern_hash, **times, "sequence": frame.sequence, **fields}
        return int(self._put("frame", fields, frame.pixels)["index"])

    def _put(self, kind: str, fields: Mapping[str, Any], pixels: Pixels | None) -> Event:
        moment = Moment.now()
        with self._change:
            room = self._change.wait_for(lambda: self._error or len(self._waiting) < self._room, _TIMEOUT_S)
            self._raise_error()
            if self._closing:
                raise StoreError(f"{self.path}: the run has ended, so nothing more can be recorded; start another")
            if not room:
                raise StoreError(
                    f"{self.path}: the disk has taken nothing for {_TIMEOUT_S:g} s; check it, then resume the run"
                )
            if pixels is not None:
                fields = {"index": self._index, **fields}
            event = Event(self._seq, kind, moment, fields)
            event.line()  # what JSON cannot say is the caller's mistake, and must not stop the writer
            self._seq += 1
            self._index += pixels is not None
            self._waiting.append(_Entry(event, pixels))
            self._change.notify_all()
        return event

    def flush(self) -> None:
        """Wait until all that was put is acknowledged."""
        with self._change:
            done = self._change.wait_for(lambda: self._error or not (self._waiting or self._busy), _TIMEOUT_S)
            self._raise_error()
            if not done:
                raise StoreError(
                    f"{self.path}: the disk has confirmed nothing for {_TIMEOUT_S:g} s; check it, then resume the run"
                )

    def finish(self, **fields: Any) -> None:
        """Trim the array to the frames there are and record the end of the run."""
        self.flush()
        try:
            with storing(self.path, "trim the finished run"):
                resize_frames(self.path, self._frames, self._index)
        finally:  # a run that cannot be trimmed has come to its end all the same
            self.put("end", **fields)
            self.flush()

    def close(self) -> None:
        """Put what is waiting on disk and let go of the run; may be called any number of times."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        self._thread.join(_TIMEOUT_S)
        self._pool.shutdown(wait=False)
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise StoreError(str(self._error)) from self._error

    def _work(self) -> None:
        while batch := self._next_batch():
            try:
                with storing(self.path, "record a frame" if any(e.pixels is not None for e in batch) else "record"):
                    batch = self._commit(batch)
            except Exception as error:  # whatever it was, whoever puts next has to know
                with self._change:
                    self._error = error
                    self._waiting.clear()
                    self._change.notify_all()
                return
            for entry in batch:
                self._announce(entry.event, entry.pixels)
            with self._change:
                self._busy = False
                self._change.notify_all()

    def _next_batch(self) -> list[_Entry]:
        """Wait for entries and take up to a commit's worth; none when closing."""
        with self._change:
            self._change.wait_for(lambda: self._waiting or self._closing)
            batch: list[_Entry] = []
            frames = 0
            while self._waiting and frames < _FRAMES_PER_COMMIT:
                batch.append(self._waiting.popleft())
                frames += batch[-1].pixels is not None
            self._busy = bool(batch)
            self._change.notify_all()
            return batch

    def _commit(self, batch: list[_Entry]) -> list[_Entry]:
        """Chunks, their folder, then the journal's lines: no line speaks of a frame that is not there."""
        frames = {entry.event["index"]: entry.pixels for entry in batch if entry.pixels is not None}
        if frames:
            end = max(frames) + 1
            if end > self._frames.shape[0]:
                resize_frames(self.path, self._frames, end)
            digests = self._pool.map(digest, frames.values())
            list(self._pool.map(partial(write_frame, self.path, self._checksums), frames, frames.values()))
            disk.sync_folder(self.path / "frames")
            batch = [entry if entry.pixels is None else _signed(entry, next(digests)) for entry in batch]
        disk.append(self.path / JOURNAL, b"".join(entry.event.line() for entry in batch))
        return batch


def _give_way() -> None:
    """Encoding has a second's time, a window or a camera's thread has not: where threads have priorities, theirs is
    lowered."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


def _signed(entry: _Entry, digest: str) -> _Entry:
    event = entry.event
    return _Entry(replace(event, fields={**event.fields, "sha256": digest}), entry.pixels)


def _next_index(path: Path, text: JournalText) -> int:
    """A number that no frame has had: none of the journal, no lost one, and none whose line was never written."""
    listed = {int(event["index"]) for event in text.events if event.kind == "frame"}
    lost = {index for one in text.lost for index in one.frames}
    return 1 + max(listed | lost | chunk_numbers(path), default=-1)


def lock_journal(path: Path, change: bool = True) -> int:
    """Take the journal for this program; the lock ends with the program, however that ends.

    Raises
    ------
    StoreError
        When another program has it.
    """
    handle = os.open(path / JOURNAL, (os.O_RDWR if change else os.O_RDONLY) | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(handle)
        raise StoreError(f"{path}: another program is recording into it; let that end first") from error
    return handle


def set_torn_end_aside(path: Path, text: JournalText) -> int:
    """Cut a torn end off the journal and keep it in a file beside it; the bytes set aside."""
    if text.good == text.size:
        return 0
    torn = (path / JOURNAL).read_bytes()[text.good :]
    aside = path / f"{JOURNAL}.torn"
    before = aside.read_bytes() if aside.exists() else b""
    if not before.endswith(torn):  # it was set aside, and then the power went
        disk.replace(aside, before + torn)
    disk.truncate(path / JOURNAL, text.good)
    return len(torn)
