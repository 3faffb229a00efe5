"""The store keeps what it has acknowledged: through crashes, power cuts, full disks and foreign folders."""

import errno
import hashlib
import json
import os
import random
import shutil
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray
import zarr

import tankrig
from tankrig import StoreError
from tankrig.devices import Frame
from tankrig.pattern import Pattern
from tankrig.run.folder import create_run
from tankrig.run.recovery import recover
from tankrig.run.writer import RunWriter

from .power_cut import after_power_cut, failing, recording

SHAPE = (6, 8)


def pixels(index: int, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Frame `index`; every fifth is dark."""
    if index % 5 == 4:
        return np.zeros(shape, np.uint16)
    return np.random.default_rng(index).integers(0, 4096, shape, np.uint16)


def frame(index: int, shape: tuple[int, int] = SHAPE) -> Frame:
    return Frame(pixels(index, shape), 1000 + index, 5000 + index, 2000 + index, index)


def sha(index: int, shape: tuple[int, int] = SHAPE) -> str:
    return hashlib.sha256(pixels(index, shape).tobytes()).hexdigest()


def new_run(folder: Path, frames: int = 20) -> Path:
    path = folder / "run"
    create_run(path, SHAPE, "uint16", frames, {"name": "test"}, [Pattern("dark", np.zeros((3, 4), np.uint8))])
    return path


def record(path: Path, count: int, **options: object) -> None:
    with RunWriter(path, **options) as writer:
        for index in range(count):
            writer.put_frame(frame(index), step=index // 2, pattern_hash="p")


def test_what_is_recorded_is_read_back_bit_by_bit_dark_frames_too(tmp_path):
    path = new_run(tmp_path)
    with RunWriter(path) as writer:
        writer.put("session", program="test")
        for index in range(10):
            if index == 6:
                writer.put("dose_intent", total_ul=30.0)
                writer.put("dose_done", total_ul=30.0, delivered_ul=30.1, delivered_low_ul=29.9, delivered_high_ul=30.2)
            writer.put_frame(frame(index), step=index // 2, pattern_hash="p")
        writer.put("fit", sigma_s=0.02)
        writer.finish(reason="completed")
    run = tankrig.open_run(path)
    assert run.frames.dims == ("frame", "y", "x")
    np.testing.assert_array_equal(run.frames.values, [pixels(index) for index in range(10)])
    assert run.frames.step.values.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert run.frames.delivered_ul.values.tolist() == [0.0] * 6 + [30.1] * 4
    assert [event["sigma_s"] for event in run.fits] == [0.02]
    assert [event.seq for event in run.journal] == list(range(len(run.journal)))
    assert run.end is not None
    assert run.end["reason"] == "completed"
    assert run.settings == {"name": "test"}
    assert [pattern.name for pattern in run.patterns.values()] == ["dark"]
    line = json.loads((path / "journal.jsonl").read_text().splitlines()[1])
    times = {"exposure_start_ns": 1000, "device_ns": 5000}
    assert line == line | {"kind": "frame", "index": 0, "step": 0, "pattern_hash": "p", "sha256": sha(0)} | times


def test_a_run_opens_directly_in_xarray_and_dask_without_a_warning(tmp_path):
    """A lab reads its data without tankrig: trimmed to the frames there are, one chunk a frame, in one folder."""
    path = new_run(tmp_path, frames=20)
    with RunWriter(path) as writer:
        for index in range(7):
            writer.put_frame(frame(index), step=0, pattern_hash="p")
        writer.finish(reason="completed")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = xarray.open_zarr(path)
    assert data.frames.shape == (7, *SHAPE)
    assert data.frames.data.chunksize == (1, *SHAPE)
    np.testing.assert_array_equal(data.frames[4].values, pixels(4))
    assert sorted(file.name for file in (path / "frames").iterdir()) == sorted(
        [f"c.{index}.0.0" for index in range(7)] + ["zarr.json"]
    )


@pytest.mark.parametrize("index", [0, 4], ids=["light", "dark"])
def test_chunks_are_those_that_zarr_would_write(tmp_path, index):
    """Frames are encoded without Zarr; the folder must be the one that Zarr would have made."""
    path = new_run(tmp_path)
    record(path, index + 1)
    chunk = path / "frames" / f"c.{index}.0.0"
    ours = chunk.read_bytes()
    zarr.open_array(path, path="frames", mode="r+").with_config({"write_empty_chunks": True})[index] = pixels(index)
    assert chunk.read_bytes() == ours


def test_more_frames_than_planned_find_room(tmp_path):
    path = new_run(tmp_path, frames=2)
    record(path, 9)
    np.testing.assert_array_equal(tankrig.open_run(path).frames.values, [pixels(index) for index in range(9)])


def test_recording_goes_on_where_it_stopped(tmp_path):
    path = new_run(tmp_path)
    record(path, 3)
    with RunWriter(path) as writer:
        assert [event["index"] for event in writer.events] == [0, 1, 2]
        writer.put_frame(frame(3), step=9, pattern_hash="p")
    run = tankrig.open_run(path)
    assert [event.seq for event in run.journal] == [0, 1, 2, 3]
    np.testing.assert_array_equal(run.frames.values, [pixels(index) for index in range(4)])


@pytest.mark.parametrize("torn", [0, 37])
def test_a_power_cut_at_any_moment_loses_no_acknowledged_frame(tmp_path, torn):
    """Replay of all that went to the disk, cut after every call; what was not synced is gone but for a torn end."""
    lab = tmp_path / "lab"
    lab.mkdir()
    with recording(lab) as log:
        path = new_run(lab, frames=4)
        with RunWriter(path, announce=lambda event, _: log.mark(event)) as writer:
            writer.put("session")
            writer.put_frame(frame(0), step=0, pattern_hash="p")
            writer.flush()
            for index in range(1, 6):
                writer.put_frame(frame(index), step=0, pattern_hash="p")
                if index >= 4:  # beyond the planned frames: the array grows for each
                    writer.flush()
            writer.put("dose_intent", total_ul=1.0)
            writer.finish(reason="completed")
    assert sum(call[0] == "mark" for call in log.calls) == 9
    acknowledged = []
    for calls in range(1, len(log.calls) + 1):
        kind, *what = log.calls[calls - 1]
        if kind == "mark":
            acknowledged.append(what[0])
        left = tmp_path / f"left{calls}"
        after_power_cut(log, calls, left, torn)
        if not (left / "run").exists():
            assert not acknowledged
            continue
        run = tankrig.open_run(left / "run")
        assert run.journal[: len(acknowledged)] == tuple(acknowledged)
        assert all(event["sha256"] == sha(event["index"]) for event in run.events("frame"))
        found = recover(left / "run")  # compares each frame's pixels with its checksum
        assert found.damaged == ()
        with RunWriter(left / "run") as writer:
            writer.put_frame(frame(found.frames), step=0, pattern_hash="p")
        assert len(tankrig.open_run(left / "run").frames) == found.frames + 1


@pytest.mark.parametrize(("error", "lasting"), [(errno.EIO, False), (errno.ENOSPC, True)])
def test_an_error_of_the_disk_at_any_call_leaves_what_was_acknowledged(tmp_path, error, lasting):
    """Once, or from then on; the run that is left goes on as if nothing had been."""
    first, failed, empty = 0, True, new_run(tmp_path, frames=2)
    while failed:
        first += 1
        path, acknowledged = tmp_path / str(first), []
        shutil.copytree(empty, path)
        with failing(path, first, error, lasting) as calls:
            writer = None
            try:
                writer = RunWriter(path, announce=lambda event, _, seen=acknowledged: seen.append(event))
                writer.put("session")
                for index in range(3):  # beyond the two that were planned
                    writer.put_frame(frame(index), step=0, pattern_hash="p")
                    writer.flush()
                writer.put("dose_intent", total_ul=1.0)
                writer.finish(reason="completed")
            except StoreError as told:
                assert os.strerror(error) in str(told)  # noqa: PT017 - not every call that fails matters
            finally:
                if writer is not None:
                    writer.close()
        failed = calls[0] >= first
        run = tankrig.open_run(path)
        assert run.journal[: len(acknowledged)] == tuple(acknowledged)
        found = recover(path)
        assert (found.damaged, found.lost) == ((), ())
        with RunWriter(path) as writer:
            number = writer.put_frame(frame(9), step=0, pattern_hash="p")
        assert number >= sum(event.kind == "frame" for event in acknowledged)
        np.testing.assert_array_equal(tankrig.open_run(path).frames[-1].values, pixels(9))
        assert recover(path).damaged == ()
    assert first > 30


RECORDER = """
import os, sys
from pathlib import Path
import numpy as np
from tankrig.devices import Frame
from tankrig.run.writer import RunWriter

def announce(event, pixels):
    os.write(1, b"%d %s\\n" % (event["index"], event["sha256"].encode()))

with RunWriter(Path(sys.argv[1]), announce) as writer:
    os.write(1, b"ready\\n")
    index = sum(event.kind == "frame" for event in writer.events)
    while True:
        pixels = np.random.default_rng(index).integers(0, 4096, (64, 80), np.uint16)
        writer.put_frame(Frame(pixels, index, index, index, index), 0, "p")
        index += 1
"""


def kill_while_recording(path: Path, kills: int, seed: int) -> int:
    """Kill a recorder at random moments; check that every acknowledged frame is there; the number of them."""
    chance = random.Random(seed)
    acknowledged: dict[int, str] = {}
    for _ in range(kills):
        program = subprocess.Popen([sys.executable, "-c", RECORDER, str(path)], stdout=subprocess.PIPE)
        assert program.stdout is not None
        assert program.stdout.readline() == b"ready\n"
        killer = threading.Timer(chance.uniform(0.0, 0.3), program.kill)
        killer.start()
        lines = program.stdout.read().split(b"\n")[:-1]  # what follows the last newline is torn
        program.wait()
        killer.join()
        acknowledged |= {int(line.split()[0]): line.split()[1].decode() for line in lines}
        run = tankrig.open_run(path)
        recorded = {event["index"]: event["sha256"] for event in run.events("frame")}
        assert acknowledged.items() <= recorded.items()
        assert recover(path).damaged == ()
    return len(acknowledged)


def test_a_killed_recorder_loses_no_acknowledged_frame(tmp_path):
    path = tmp_path / "run"
    create_run(path, (64, 80), "uint16", 1000, {})
    assert kill_while_recording(path, 2, seed=1) > 0


@pytest.mark.long
def test_forty_kills_lose_no_acknowledged_frame(tmp_path):
    path = tmp_path / "run"
    create_run(path, (64, 80), "uint16", 1000, {})
    assert kill_while_recording(path, 40, seed=2) > 100


def test_a_full_disk_is_said_in_one_sentence_and_what_was_acknowledged_stays(tmp_path, monkeypatch):
    path = new_run(tmp_path)
    writer = RunWriter(path)
    for index in range(3):
        writer.put_frame(frame(index), step=0, pattern_hash="p")
    writer.flush()
    real = os.write

    def full(handle: int, data: object) -> int:
        if len(data) > 20:
            return real(handle, data[:10])  # a short write, as a disk that fills up makes it
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        writer.put("note", text="x" * 100)
        with pytest.raises(StoreError, match=r"run: could not record \(No space left on device\); free some space"):
            writer.flush()
        with pytest.raises(StoreError, match="No space left"):
            writer.put_frame(frame(3), step=0, pattern_hash="p")
    writer.close()
    assert recover(path).torn_bytes == 0
    record_more = RunWriter(path)
    record_more.put_frame(frame(3), step=0, pattern_hash="p")
    record_more.close()
    np.testing.assert_array_equal(tankrig.open_run(path).frames.values, [pixels(index) for index in range(4)])


def test_a_file_size_limit_of_the_system_is_an_error_not_a_crash(tmp_path):
    """A real error of the kernel in the middle of a chunk, not an imitated one."""
    path = tmp_path / "run"
    create_run(path, (64, 80), "uint16", 10, {})
    program = RECORDER.replace(
        "with RunWriter", "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\nwith RunWriter"
    )
    result = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert "StoreError" in result.stderr
    assert "could not record a frame (File too large)" in result.stderr
    assert len(tankrig.open_run(path).frames) == 0


def test_a_folder_that_cannot_be_made_leaves_nothing_half_written(tmp_path, monkeypatch):
    def fail(_: int) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StoreError, match=r"could not make the run's folder \(Read-only file system\); give a folder"):
        new_run(tmp_path)
    assert not (tmp_path / "run").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="could not make the run's folder"):
        new_run(tmp_path / "file")


def test_an_existing_folder_is_never_overwritten(tmp_path):
    path = new_run(tmp_path)
    record(path, 2)
    with pytest.raises(StoreError, match="exists already"):
        new_run(tmp_path)
    assert len(tankrig.open_run(path).frames) == 2


def test_folders_that_are_no_runs_are_refused_with_a_remedy(tmp_path):
    for place, reason in [("nowhere", "does not exist"), ("empty", "is not a run"), ("file", "is not a run")]:
        (tmp_path / "empty").mkdir(exist_ok=True)
        (tmp_path / "file").write_text("x")
        with pytest.raises(StoreError, match=reason):
            tankrig.open_run(tmp_path / place)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    with pytest.raises(StoreError, match="is not a run"):
        tankrig.open_run(foreign)
    path = new_run(tmp_path)
    (path / "journal.jsonl").unlink()
    with pytest.raises(StoreError, match=r"its journal\.jsonl cannot be read"):
        tankrig.open_run(path)


def test_a_run_of_a_newer_tankrig_is_refused(tmp_path):
    path = new_run(tmp_path)
    table = json.loads((path / "zarr.json").read_text())
    table["attributes"]["tankrig"] |= {"format": 99, "version": "9.9"}
    (path / "zarr.json").write_text(json.dumps(table))
    with pytest.raises(StoreError, match=r"recorded by tankrig 9\.9 in layout 99.*update tankrig"):
        tankrig.open_run(path)
    with pytest.raises(StoreError, match="update tankrig"):
        RunWriter(path)


def test_two_programs_cannot_record_into_one_run(tmp_path):
    path = new_run(tmp_path)
    with RunWriter(path), pytest.raises(StoreError, match="another program is recording"):
        RunWriter(path)
    with RunWriter(path):
        pass


def test_recover_tells_damaged_frames_and_keeps_a_torn_end_aside(tmp_path):
    path = new_run(tmp_path)
    record(path, 6)
    chunk = path / "frames" / "c.2.0.0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"\x00")
    (path / "frames" / "c.4.0.0").unlink()  # a dark frame, which Zarr would read as zeros from nothing
    with (path / "journal.jsonl").open("ab") as journal:
        journal.write(b'{"seq":6,"kind":"fra')
    assert len(tankrig.open_run(path).frames) == 6
    found = recover(path)
    assert (found.frames, found.damaged, found.torn_bytes, found.finished) == (4, (2, 4), 20, False)
    assert (path / "journal.jsonl.torn").read_bytes() == b'{"seq":6,"kind":"fra'
    assert recover(path).torn_bytes == 0


def test_a_frame_of_another_format_is_refused_and_the_run_goes_on(tmp_path):
    path = new_run(tmp_path)
    with RunWriter(path) as writer:
        with pytest.raises(StoreError, match="does not fit the run"):
            writer.put_frame(frame(0, (3, 3)), step=0, pattern_hash="p")
        with pytest.raises(TypeError, match="cannot stand in a journal"):
            writer.put("note", text=object())
        with pytest.raises(ValueError, match="not JSON"):
            writer.put("fit", sigma_s=float("nan"))
        writer.put_frame(frame(0), step=0, pattern_hash="p")
    assert [event.seq for event in tankrig.open_run(path).journal] == [0]


def test_a_slow_disk_holds_the_experiment_back_and_drops_nothing(tmp_path, monkeypatch):
    """With room for two frames and a disk that answers late, putting waits."""
    monkeypatch.setattr("tankrig.run.writer.QUEUE_BYTES", 0)
    gate = threading.Event()
    real = os.fsync

    def slow(handle: int) -> None:
        gate.wait(10.0)
        real(handle)

    path = new_run(tmp_path)
    writer = RunWriter(path)
    monkeypatch.setattr(os, "fsync", slow)
    done = threading.Thread(target=lambda: [writer.put_frame(frame(i), step=0, pattern_hash="p") for i in range(12)])
    done.start()
    done.join(0.2)
    assert done.is_alive()
    gate.set()
    done.join(10.0)
    writer.close()
    np.testing.assert_array_equal(tankrig.open_run(path).frames.values, [pixels(index) for index in range(12)])
