"""Damage to a run's files is seen, named and contained: what is not damaged stays, and nothing is taken for another."""

import errno
import json
import os
import random
import shutil
from itertools import pairwise
from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import xarray
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from tankrig import StoreError
from tankrig.devices import Frame
from tankrig.errors import UndecidedError
from tankrig.live.exposures import replayed
from tankrig.pattern import Pattern
from tankrig.run.damage import Lost, read_lines
from tankrig.run.export import export_netcdf, export_tiff
from tankrig.run.folder import create_run
from tankrig.run.journal import Event, Moment
from tankrig.run.recovery import dose_doubt, recover
from tankrig.run.start import new_run, resumed_run
from tankrig.run.state import FinishReason
from tankrig.run.writer import RunWriter
from tankrig.sequence import Capture, Dose, Sequence
from ui.cli import main

from .memory_rig import memory_rig
from .test_store import SHAPE, frame, pixels

OLD_RUN = Path(__file__).parent / "data" / "stored" / "1" / "finished" / "run"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A run of two doses with ten frames after each, as a runner writes it."""
    path = tmp_path_factory.mktemp("recorded") / "run"
    create_run(path, SHAPE, "uint16", 20, {"name": "test"}, [Pattern("µ", np.zeros((3, 4), np.uint8))])
    with RunWriter(path) as writer:
        writer.put("session", program="test", tank_ul=0.0)
        for dose in range(2):
            total = 10.0 * (dose + 1)
            writer.put("step", step=2 * dose, state="begun", label=f"dose to {total} µl")
            writer.put("dose_intent", step=2 * dose, total_ul=total)
            done = {"delivered_ul": total, "delivered_low_ul": total, "delivered_high_ul": total}
            writer.put("dose_done", step=2 * dose, **done, complete=True)
            writer.put("step", step=2 * dose, state="done")
            writer.put("step", step=2 * dose + 1, state="begun", label="capture")
            writer.put("note", text="camera", exposure_ms=1.0, gain=1.0)
            for index in range(10 * dose, 10 * dose + 10):
                writer.put_frame(frame(index), step=2 * dose + 1, pattern_hash="p")
            writer.put("step", step=2 * dose + 1, state="done")
        writer.put("fit", sigma_s=0.02)
        writer.finish(reason="completed")
    return path


@pytest.fixture
def run_path(recorded, tmp_path) -> Path:
    shutil.copytree(recorded, tmp_path / "run")
    return tmp_path / "run"


def journal_of(path: Path) -> bytes:
    return (path / "journal.jsonl").read_bytes()


def flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def check_flip(data: bytes, bit: int) -> Lost:
    """One flipped bit of a journal: named where it is, and nothing lost beyond its line."""
    true = read_lines(data, checked=True).events
    found = read_lines(flipped(data, bit), checked=True)
    line = data.count(b"\n", 0, bit // 8)
    newline = data[bit // 8] == ord("\n")
    left = [event for event in true if newline or event.seq != line]
    assert list(found.events) == left
    (lost,) = found.lost
    assert lost.offset <= bit // 8 < lost.offset + lost.size
    assert lost.line <= line + 1 < lost.line + lost.lines
    assert lost.seqs == (None if newline else (line, line))
    assert (found.good, found.unverified) == (len(data), 0)
    assert found.next_seq >= len(true)
    if not newline and true[line].kind in ("session", "dose_intent", "dose_done"):
        assert lost.may_be_dose
    if not newline and true[line].kind == "frame":
        assert lost.frames == (true[line]["index"],)
        assert not lost.may_be_dose
    assert str(line + 1) in str(lost)
    return lost


@given(st.data())
@settings(max_examples=120, deadline=None)
def test_any_flipped_bit_of_a_journal_is_named_and_costs_its_line_only(recorded, data):
    whole = journal_of(recorded)
    check_flip(whole, data.draw(st.integers(0, 8 * len(whole) - 1)))


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_every_single_flipped_bit_of_a_journal_is_named(recorded, capsys):
    whole = journal_of(recorded)
    places = [check_flip(whole, bit) for bit in range(8 * len(whole))]
    asked = sum(lost.may_be_dose for lost in places)
    with capsys.disabled():
        print(
            f"\nall {len(places)} single-bit flips of the journal of 20 frames ({len(whole)} bytes): found and named, "
            f"no whole line lost; a person is asked about a dose after {asked} of them"
        )


def check_chunks(path: Path, flips: int, seed: int, checksums: bool = True) -> int:
    """Flipped bits of chunks: reading that frame says its number, all others are read, and `recover` names it.

    Without checksums a bit that the codec does not look at may be flipped unseen, the pixels being what they were; the
    number of those.
    """
    chance = random.Random(seed)
    run = tankrig.open_run(path)
    frames = run.events("frame")
    true = run.frames.values
    unseen = 0
    for number in range(flips):
        place = chance.randrange(len(frames))
        chunk = path / "frames" / f"c.{frames[place]['index']}.0.0"
        data = chunk.read_bytes()
        chunk.write_bytes(flipped(data, chance.randrange(8 * len(data))))
        damaged = tankrig.open_run(path).frames
        try:
            np.testing.assert_array_equal(damaged[place].values, true[place])
            readable = True
        except StoreError as error:
            assert f"frame {frames[place]['index']} is damaged" in str(error)  # noqa: PT017 - one of two ways
            readable = False
        unseen += readable
        other = chance.choice([i for i in range(len(frames)) if i != place])
        np.testing.assert_array_equal(damaged[other].values, true[other])
        if number % 50 == 0:
            assert recover(path).damaged == (() if readable else (frames[place]["index"],))
        chunk.write_bytes(data)
    assert not (checksums and unseen)
    return unseen


def test_flipped_bits_of_chunks_are_named(run_path):
    check_chunks(run_path, 25, seed=1)


def test_flipped_bits_of_chunks_without_checksums_are_named_by_their_sha256(tmp_path):
    shutil.copytree(OLD_RUN, tmp_path / "run")
    assert check_chunks(tmp_path / "run", 25, seed=2, checksums=False) < 5


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_thousand_flipped_bits_of_chunks_are_named(run_path, tmp_path, capsys):
    shutil.copytree(OLD_RUN, tmp_path / "old")
    check_chunks(run_path, 1000, seed=3)
    unseen = check_chunks(tmp_path / "old", 1000, seed=4, checksums=False)
    with capsys.disabled():
        print(
            f"\n1000 flipped bits of chunks with checksums (seed 3): all found and named; 1000 of chunks without "
            f"(seed 4): {1000 - unseen} named, {unseen} in bits that the codec ignores, the pixels being what they were"
        )


def test_any_zarr_reader_notices_a_flipped_bit(run_path):
    chunk = run_path / "frames" / "c.3.0.0"
    chunk.write_bytes(flipped(chunk.read_bytes(), 300))
    array = zarr.open_array(run_path / "frames", mode="r")
    np.testing.assert_array_equal(array[2], pixels(2))
    with pytest.raises(ValueError, match="checksum"):
        array[3]
    with pytest.raises(ValueError, match="checksum"):
        xarray.open_zarr(run_path).frames[3].load()


def test_another_program_can_check_a_line_in_a_few_lines(recorded):
    """As docs/runs.md says it."""
    for line in journal_of(recorded).splitlines():
        body, _, seal = line.rpartition(b',"crc32c":')
        assert seal == b'"%08x"}' % google_crc32c.value(body)
        assert json.loads(line)["crc32c"] == seal[1:9].decode()


# -- any damage, to any journal --------------------------------------------------------------------------------------


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[str, float, int, bytes]]:
    """What happens to a journal: where, in parts of its length, how long, and what is put there."""
    kinds = st.sampled_from(["flip", "overwrite", "cut", "insert", "repeat a line", "lose a line"])
    one = st.tuples(kinds, st.floats(0.0, 0.999), st.integers(1, 900), st.binary(max_size=40))
    return draw(st.lists(one, min_size=1, max_size=4))


def damaged(data: bytes, what: list[tuple[str, float, int, bytes]]) -> bytes:
    for kind, place, size, garbage in what:
        at = int(place * len(data))
        lines = data.splitlines(keepends=True)
        number = int(place * len(lines))
        if kind == "flip":
            data = flipped(data, 8 * at + size % 8)
        elif kind == "overwrite":
            filler = (garbage or b"\0") * size
            data = data[:at] + filler[: min(size, len(data) - at)] + data[at + size :]
        elif kind == "cut":
            data = data[:at] + data[at + size :]
        elif kind == "insert":
            data = data[:at] + garbage + data[at:]
        elif kind == "repeat a line":
            data = b"".join([*lines[: number + 1], *lines[number:]])
        else:
            data = b"".join([*lines[:number], *lines[number + 1 :]])
    return data


@given(damages())
@settings(max_examples=150, deadline=None)
def test_whatever_happens_to_a_journal_its_whole_lines_count_and_the_others_are_named(recorded, what):
    whole = journal_of(recorded)
    true = {event.seq: event for event in read_lines(whole, checked=True).events}
    changed = damaged(whole, what)
    found = read_lines(changed, checked=True)
    seqs = [event.seq for event in found.events]
    assert all(event == true[event.seq] for event in found.events)
    lines = whole.splitlines()
    assert set(seqs) >= {seq for seq, line in enumerate(lines) if line in changed}
    last = max(seqs, default=-1)
    assert found.next_seq > last
    if seqs == sorted(seqs):
        for seq in set(range(last)) - set(seqs):
            places = [lost for lost in found.lost if lost.seqs and lost.seqs[0] <= seq <= lost.seqs[1]]
            assert len(places) == 1
            if true[seq].kind in ("dose_intent", "dose_done"):
                assert places[0].may_be_dose
            if true[seq].kind == "frame" and places[0].kinds:
                assert true[seq]["index"] in places[0].frames
    for lost in found.lost:
        assert str(lost)


@given(damages())
@settings(max_examples=60, deadline=None)
def test_a_reopened_run_never_writes_over_a_frame(recorded, tmp_path_factory, what):
    """Whatever became of its journal: chunks stay as they are, whole events stay, and new frames have new numbers."""
    path = tmp_path_factory.mktemp("reopened") / "run"
    shutil.copytree(recorded, path)
    (path / "journal.jsonl").write_bytes(damaged(journal_of(recorded), what))
    chunks = {file.name: file.read_bytes() for file in (path / "frames").glob("c.*")}
    before = tankrig.open_run(path)
    with RunWriter(path) as writer:
        number = writer.put_frame(frame(77), step=9, pattern_hash="p")
        writer.put("note", text="on")
    assert number >= 20
    assert {file.name: file.read_bytes() for file in (path / "frames").glob("c.*")}.items() >= chunks.items()
    after = tankrig.open_run(path)
    assert [event for event in after.journal if event in before.journal] == list(before.journal)
    assert [event.kind for event in after.journal[-2:]] == ["frame", "note"]
    assert len({event.seq for event in after.journal}) == len(after.journal)
    assert after.unverified == 0
    np.testing.assert_array_equal(after.frames[-1].values, pixels(77))
    found = recover(path)
    assert (found.damaged, found.torn_bytes) == ((), 0)
    with RunWriter(path) as writer:
        assert writer.put_frame(frame(78), step=9, pattern_hash="p") == number + 1


# -- runs from before checksums --------------------------------------------------------------------------------------


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_an_old_journal_keeps_every_line_that_a_flipped_bit_has_not_touched(data):
    whole = journal_of(OLD_RUN)
    true = read_lines(whole, checked=False)
    assert (true.lost, true.unverified) == ((), len(true.events))
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    found = read_lines(flipped(whole, bit), checked=False)
    line = whole.count(b"\n", 0, bit // 8)
    untouched = [event for event in true.events if event.seq != line]
    assert [event for event in found.events if event in untouched] == untouched
    assert all(one.seq < two.seq for one, two in pairwise(found.events))
    assert len(found.events) <= len(true.events)
    if len(found.events) < len(true.events):
        assert [lost.seqs for lost in found.lost] == [(line, line)]


def test_an_old_run_goes_on_in_its_own_format_and_its_new_lines_have_checksums(tmp_path):
    path = tmp_path / "run"
    shutil.copytree(OLD_RUN, path)
    lines = journal_of(path).splitlines()
    shape = tankrig.open_run(path).frames.shape[1:]
    picture = np.arange(np.prod(shape), dtype=np.uint16).reshape(shape)
    with RunWriter(path) as writer:
        writer.put_frame(Frame(picture, 1, 1, 1, 1), step=9, pattern_hash="p")
    run = tankrig.open_run(path)
    np.testing.assert_array_equal(run.frames[-1].values, picture)
    np.testing.assert_array_equal(zarr.open_array(path / "frames", mode="r")[8], picture)
    assert journal_of(path).splitlines()[: len(lines)] == lines
    assert (recover(path).damaged, run.unverified, run.lost) == ((), len(lines), ())
    for bit in range(8 * len(b"\n".join(lines) + b"\n"), 8 * len(journal_of(path)) - 8):
        found = read_lines(flipped(journal_of(path), bit), checked=False)
        assert len(found.events) == len(lines)
        assert found.lost


# -- reading, exporting, recovering ----------------------------------------------------------------------------------


def test_a_missing_chunk_is_never_a_black_frame(run_path, tmp_path, capsys):
    (run_path / "frames" / "c.4.0.0").unlink()
    run = tankrig.open_run(run_path)
    said = r"run: frame 4 is missing; restore it from a copy of the run, or leave it out: tankrig recover .*--leave-out"
    frames = run.frames
    with pytest.raises(StoreError, match=said):
        frames.max().compute()
    with pytest.raises(StoreError, match=said):
        export_netcdf(run, tmp_path / "frames.nc")
    with pytest.raises(StoreError, match=said):
        export_tiff(run, tmp_path / "frames")
    assert not (tmp_path / "frames.nc").exists()
    assert not (tmp_path / "frames").exists()
    np.testing.assert_array_equal(frames[5].values, pixels(5))
    assert main(["recover", str(run_path), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["damaged"] == [4]
    assert main(["recover", str(run_path), "--leave-out"]) == 0
    assert "left out, being damaged: frames 4" in capsys.readouterr().out
    left = tankrig.open_run(run_path)
    assert [event["index"] for event in left.events("frame")] == [i for i in range(20) if i != 4]
    np.testing.assert_array_equal(left.frames.values, [pixels(i) for i in range(20) if i != 4])
    assert left.end is not None
    export_netcdf(left, tmp_path / "frames.nc")
    assert xarray.open_dataset(tmp_path / "frames.nc").frames.missing == "frame 4 is left out, being damaged"
    assert main(["recover", str(run_path)]) == 0
    assert recover(run_path, leave_out=True).left_out == (4,)
    assert journal_of(run_path).count(b"left out") == 1


def test_recover_names_frames_lines_and_doses_and_changes_nothing_that_was_acknowledged(run_path, capsys):
    lines = journal_of(run_path).splitlines(keepends=True)
    lines[2] = lines[2].replace(b"total", b"tot@l")
    lines[9] = lines[9].replace(b"1", b"2", 1)
    del lines[15]
    (run_path / "journal.jsonl").write_bytes(b"".join(lines) + b'{"seq":99,"ki')
    before = {file: file.read_bytes() for file in run_path.rglob("*") if file.is_file()}
    assert main(["recover", str(run_path)]) == 1
    said = capsys.readouterr().out
    assert "18 frames are as they were recorded" in said
    assert "line 3 of the journal" in said
    assert "event 2 (dose_intent) is lost, which may have been about a dose" in said
    assert "event 9 (frame 2) is lost" in said
    assert "lines are missing: event 15 (frame 8) is lost" in said
    assert "frames that the journal does not speak of, and that do not count: 2, 8" in said
    assert "a torn end of 13 bytes" in said
    after = {file: file.read_bytes() for file in run_path.rglob("*") if file.is_file()}
    assert after.pop(run_path / "journal.jsonl.torn") == b'{"seq":99,"ki'
    assert after.pop(run_path / "journal.jsonl") == b"".join(lines)
    assert after == {file: data for file, data in before.items() if file.name != "journal.jsonl"}
    assert main(["recover", str(run_path)]) == 1
    assert capsys.readouterr().out == said.replace(
        "a torn end of 13 bytes, never acknowledged, is set aside in journal.jsonl.torn\n", ""
    )


def test_a_flipped_last_newline_is_no_torn_end(run_path):
    data = journal_of(run_path)
    for end in (data[:-1], data[:-1] + b"\x0b", data[:-1] + b"\r\n"):
        (run_path / "journal.jsonl").write_bytes(end)
        assert (recover(run_path).torn_bytes, recover(run_path).finished) == (0, True)
        with RunWriter(run_path) as writer:
            writer.put("note", text="on")
        run = tankrig.open_run(run_path)
        assert len(run.journal) == data.count(b"\n") + 1
        assert journal_of(run_path).startswith(end)


@pytest.mark.parametrize(
    "name", ["journal.jsonl", "journal.jsonl.torn", "frames", "frames/c.3.0.0", "frames/zarr.json"]
)
def test_nothing_is_written_through_a_symbolic_link(run_path, tmp_path, name):
    outside, part = tmp_path / "outside", run_path / name
    if part.exists():
        shutil.move(part, outside)
    else:
        outside.write_bytes(b"precious")
    part.symlink_to(outside)
    if name != "journal.jsonl":
        (run_path / "journal.jsonl").write_bytes(journal_of(run_path) + b"torn")
    held = outside.read_bytes() if outside.is_file() else None
    for attempt in (recover, RunWriter):
        with pytest.raises(StoreError, match=rf"its {name} is a symbolic link"):
            attempt(run_path)
    assert held == (outside.read_bytes() if outside.is_file() else None)


def test_a_run_on_a_read_only_disk_is_checked_and_that_is_said(run_path, monkeypatch, capsys):
    (run_path / "journal.jsonl").write_bytes(journal_of(run_path) + b'{"seq":')
    (run_path / "frames" / "c.6.0.0").unlink()
    real = os.open

    def read_only(path, flags, *more, **others):
        if flags & (os.O_WRONLY | os.O_RDWR) and str(path).startswith(str(run_path)):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return real(path, flags, *more, **others)

    monkeypatch.setattr(os, "open", read_only)
    assert main(["recover", str(run_path)]) == 1
    said = capsys.readouterr().out
    assert "damaged or missing frames: 6" in said
    assert "a torn end of 7 bytes, never acknowledged, stays where it is" in said
    assert "the run cannot be written here, so nothing was put right" in said
    with pytest.raises(StoreError, match="no frame can be left out"):
        recover(run_path, leave_out=True)


def test_damaged_metadata_are_said_and_mended_where_their_copy_is_whole(run_path, capsys):
    file = run_path / "frames" / "zarr.json"
    whole = file.read_bytes()
    for text in (b"", whole[:100], whole.replace(b'"shape"', b'"shbpe"')):
        file.write_bytes(text)
        with pytest.raises(StoreError, match=r"frames/zarr\.json, which tells how frames are stored, is missing or"):
            tankrig.open_run(run_path).frames  # noqa: B018
        with pytest.raises(StoreError, match=r"tankrig recover"):
            RunWriter(run_path)
        assert recover(run_path).mended == ("frames/zarr.json, from its copy in zarr.json",)
        assert json.loads(file.read_bytes()) == json.loads(whole)
        assert recover(run_path).mended == ()
    table = json.loads(whole)
    table["shape"][1] += 1
    file.write_text(json.dumps(table))
    with pytest.raises(StoreError, match=r"say different things of how frames are stored"):
        tankrig.open_run(run_path).frames  # noqa: B018
    with pytest.raises(StoreError, match=r"say different things"):
        recover(run_path)
    file.write_bytes(whole)
    group = run_path / "zarr.json"
    group.write_bytes(group.read_bytes()[:200])
    for attempt in (tankrig.open_run, recover, RunWriter):
        with pytest.raises(StoreError, match="journal and frames lie beside it untouched: restore zarr"):
            attempt(run_path)
    assert main(["recover", str(run_path)]) == 2
    assert "untouched" in capsys.readouterr().err


def test_no_flipped_bit_of_the_metadata_ends_in_a_traceback_or_in_other_pixels(run_path):
    """Settings have no checksum; what tells how frames are stored has a copy."""
    true = np.array([pixels(index) for index in range(20)])
    chance = random.Random(5)
    for file in (run_path / "frames" / "zarr.json", run_path / "zarr.json"):
        whole = file.read_bytes()
        for _ in range(150):
            file.write_bytes(flipped(whole, chance.randrange(8 * len(whole))))
            try:
                frames = tankrig.open_run(run_path).frames
                np.testing.assert_array_equal(frames.values, true)
            except StoreError:
                pass
        file.write_bytes(whole)


# -- doses -----------------------------------------------------------------------------------------------------------


def test_a_damaged_dose_line_asks_a_person_once(tmp_path):
    """The answer is written down, and asked for no more."""
    rig = memory_rig(tmp_path)
    path = tmp_path / "run"
    sequence = Sequence("doses", (Dose(10.0), Capture("full", frames=2), Dose(20.0), Capture("full", frames=2)))
    assert new_run(sequence, rig, path).run().reason is FinishReason.COMPLETED
    lines = journal_of(path).splitlines(keepends=True)
    kinds = [json.loads(line)["kind"] for line in lines]
    cut = max(i for i, kind in enumerate(kinds) if kind == "dose_done") + 1
    for place in [i for i, kind in enumerate(kinds[:cut]) if kind == "dose_done"][-1:]:
        left = [*lines[:place], lines[place].replace(b"delivered", b"delivefed"), *lines[place + 1 : cut + 2]]
        left = [line for line in left if b'"kind":"dose_intent"' not in line or b'"total_ul":20' not in line]
        (path / "journal.jsonl").write_bytes(b"".join(left))
    run = tankrig.open_run(path)
    assert "may have been about a dose" in str(dose_doubt(run))
    with pytest.raises(UndecidedError, match=r"may have been about a dose; .* say how much it is in all"):
        resumed_run(path, memory_rig(tmp_path))
    rig = memory_rig(tmp_path)
    assert resumed_run(path, rig, delivered_ul=20.0).run().reason is FinishReason.COMPLETED
    assert rig.doser.count_ul == 20
    assert dose_doubt(tankrig.open_run(path)) is None


def test_frames_after_a_lost_dose_are_not_given_the_dose_before(run_path):
    """A frame whose dose nobody knows is not fitted as one of another dose."""
    lines = journal_of(run_path).splitlines(keepends=True)
    kinds = [json.loads(line)["kind"] for line in lines]
    second = [i for i, kind in enumerate(kinds) if kind == "dose_done"][1]
    (run_path / "journal.jsonl").write_bytes(b"".join([*lines[: second - 1], *lines[second + 1 :]]))
    run = tankrig.open_run(run_path)
    assert run.unsure_doses == frozenset(range(10, 20))
    np.testing.assert_array_equal(run.frames.delivered_ul.values, [10.0] * 10 + [np.nan] * 10)
    assert [pixels is None for event, pixels in replayed(run) if event.kind == "frame"] == [False] * 10 + [True] * 10
    assert recover(run_path).unsure_doses == tuple(range(10, 20))


def test_a_lost_frame_asks_nothing_about_doses(recorded):
    """Between two lines of one step in which frames were taken nothing is dosed, whatever a line said."""
    data = journal_of(recorded)
    lines = data.splitlines(keepends=True)
    lines[9] = b"\xff" * (len(lines[9]) - 1) + b"\n"
    (lost,) = read_lines(b"".join(lines), checked=True).lost
    assert (lost.frames, lost.kinds, lost.may_be_dose) == ((2,), (), False)
    lines = data.splitlines(keepends=True)
    del lines[2:4]
    (lost,) = read_lines(b"".join(lines), checked=True).lost
    assert (lost.seqs, lost.frames, lost.may_be_dose) == ((2, 3), (), True)


def test_an_event_survives_any_words_a_person_writes():
    @given(st.dictionaries(st.text(st.characters(codec="utf-8")), st.text(st.characters(codec="utf-8"))))
    @settings(max_examples=200, deadline=None)
    def check(fields):
        names = {f"_{key}": value for key, value in fields.items()}
        event = Event(3, "note", Moment("2026-11-20T10:00:00+00:00", 1, "b"), names)
        found = read_lines(event.line(), checked=True)
        assert found.events == (event,)
        assert found.lost == (Lost(1, 0, 0, 0, (0, 2), (), (), -1, True),)

    check()
