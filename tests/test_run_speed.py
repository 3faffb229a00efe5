"""Figures of the frame path and of the runner; each test prints them (`pytest -m long -s tests/test_run_speed.py`)."""

import json
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import xarray

import tankrig
from drivers.emulation.truth import read_truth
from drivers.registry import open_device
from tankrig.devices import Frame
from tankrig.run.folder import create_run
from tankrig.run.start import new_run
from tankrig.run.state import FinishReason
from tankrig.run.writer import RunWriter
from tankrig.sequence import Capture, Dose, Repeat, Sequence

from .memory_rig import memory_rig

FRAMES_PER_S, SECONDS, SHAPE = 30, 60, (1024, 1280)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_frames_are_acknowledged_at_the_cameras_pace_for_a_minute(tmp_path, capsys):
    """1280×1024 16-bit at 30/s: no frame waits for room, none is missing, and how long acknowledgements take."""
    chance = np.random.default_rng(0)
    light = 3000 * np.exp(-np.linspace(0, 3, SHAPE[1])) + 100
    pictures = [chance.poisson(np.broadcast_to(light, SHAPE)).astype(np.uint16) for _ in range(8)]
    count = FRAMES_PER_S * SECONDS
    create_run(tmp_path / "run", SHAPE, "uint16", count, {})
    put, blocked, acknowledged = np.zeros(count), np.zeros(count), np.zeros(count)

    def note(event, _):
        acknowledged[event["index"]] = time.perf_counter()

    with RunWriter(tmp_path / "run", note) as writer:
        start, cpu_start_s = time.perf_counter(), time.process_time()
        for index in range(count):
            time.sleep(max(0.0, start + index / FRAMES_PER_S - time.perf_counter()))
            put[index] = time.perf_counter()
            writer.put_frame(Frame(pictures[index % 8], index, index, index, index), 0, "p")
            blocked[index] = time.perf_counter() - put[index]
        writer.flush()
    cpu_s = time.process_time() - cpu_start_s
    rate = count / (acknowledged.max() - start)
    wait_ms = 1e3 * (acknowledged - put)
    late = int((put - start - np.arange(count) / FRAMES_PER_S > 1 / FRAMES_PER_S).sum())
    disk_mb = sum(file.stat().st_size for file in (tmp_path / "run" / "frames").iterdir()) / 1e6
    with capsys.disabled():
        print(
            f"\n{count} frames of 1280×1024, 16 bit: {rate:.1f}/s acknowledged, {late} taken late; acknowledgement "
            f"median {np.median(wait_ms):.1f} ms, worst {wait_ms.max():.0f} ms; "
            f"longest put {1e3 * blocked.max():.1f} ms; "
            f"{1e3 * cpu_s / count:.1f} ms of processor each; {disk_mb:.0f} MB on disk for {count * 2.62144:.0f} MB"
        )
    assert len(tankrig.open_run(tmp_path / "run").frames) == count
    assert rate > 0.99 * FRAMES_PER_S
    assert late == 0


def without_checksums(path: Path) -> None:
    """Make a new run one of layout 1, as it was before checksums."""
    for file in (path / "frames" / "zarr.json", path / "zarr.json"):
        table = json.loads(file.read_text())
        if file.parent == path:
            table["attributes"]["tankrig"]["format"] = 1
            arrays = [table["consolidated_metadata"]["metadata"]["frames"]]
        else:
            arrays = [table]
        for array in arrays:
            array["codecs"] = [codec for codec in array["codecs"] if codec["name"] != "crc32c"]
        file.write_text(json.dumps(table))


@pytest.mark.long
@pytest.mark.timeout(600)
def test_what_checksums_cost(tmp_path, capsys):
    """Frames as fast as the disk takes them, in turns into a run with checksums and one without; then both are read.

    Reading before is what tankrig did until then: the lines by json alone, the frames by xarray, nothing checked.
    """
    chance = np.random.default_rng(0)
    light = 3000 * np.exp(-np.linspace(0, 3, SHAPE[1])) + 100
    pictures = [chance.poisson(np.broadcast_to(light, SHAPE)).astype(np.uint16) for _ in range(8)]
    paths, block, rounds = [tmp_path / "with", tmp_path / "without"], 24, 6
    for path in paths:
        create_run(path, SHAPE, "uint16", block * rounds, {})
    without_checksums(paths[1])
    took_s: dict[str, list[float]] = {}

    def timed(name, action):
        begun = time.perf_counter()
        action()
        took_s.setdefault(name, []).append(time.perf_counter() - begun)

    def some(writer):
        for index in range(block):
            writer.put_frame(Frame(pictures[index % 8], index, index, index, index), 0, "p")
        writer.flush()

    with RunWriter(paths[0]) as first, RunWriter(paths[1]) as second:
        for number in range(rounds):
            turns = [("writing with", first), ("writing without", second)]
            for name, writer in turns if number % 2 else turns[::-1]:
                timed(name, partial(some, writer))

    def opened_before(path):
        lines = (path / "journal.jsonl").read_bytes().splitlines()
        assert all(json.loads(line)["kind"] for line in lines)

    def read_before(path):
        xarray.open_zarr(path, consolidated=True).frames.values.sum()

    for _ in range(3):
        timed("reading before", partial(read_before, paths[1]))
        timed("reading with", lambda: tankrig.open_run(paths[0]).frames.values.sum())
        timed("reading without", lambda: tankrig.open_run(paths[1]).frames.values.sum())
        for _ in range(5):
            timed("opening before", partial(opened_before, paths[0]))
            timed("opening with", partial(tankrig.open_run, paths[0]))
    s = {name: float(np.median(times)) for name, times in took_s.items()}
    count = block * rounds
    with capsys.disabled():
        print(
            f"\n{block / s['writing with']:.1f} frames/s with checksums, {block / s['writing without']:.1f} without "
            f"(ratio {s['writing without'] / s['writing with']:.3f}, {rounds} rounds in turns); {count} frames are "
            f"read in {s['reading with']:.2f} s, {s['reading without']:.2f} s where SHA-256 is checked instead, "
            f"{s['reading before']:.2f} s before, unchecked; the journal of {count} frames is opened in "
            f"{1e3 * s['opening with']:.1f} ms, its lines alone by json in {1e3 * s['opening before']:.1f} ms"
        )
    assert s["writing with"] < 1.15 * s["writing without"]


@pytest.mark.long
def test_a_step_costs_little_beyond_what_its_devices_take(tmp_path, capsys):
    """Projector and camera answer at once here, so the time from step to step is the runner's own."""
    rig = memory_rig(tmp_path)
    sequence = Sequence("steps", (Repeat(200, (Capture("full"), Capture("dark"))),), exposure_ms=1.0)
    in_devices = []

    def timed(real):
        def call(*arguments):
            begun = time.perf_counter()
            answer = real(*arguments)
            in_devices.append(time.perf_counter() - begun)
            return answer

        return call

    rig.projector.show, rig.camera.capture = timed(rig.projector.show), timed(rig.camera.capture)
    assert new_run(sequence, rig, tmp_path / "run").run().reason is FinishReason.COMPLETED
    begun = [e.moment.mono_ns for e in tankrig.open_run(tmp_path / "run").events("step") if e["state"] == "begun"]
    overhead_ms = np.diff(begun) / 1e6 - 1e3 * np.sum(np.reshape(in_devices[:800], (-1, 2)), axis=1)[:-1]
    with capsys.disabled():
        print(f"\nstep overhead: median {np.median(overhead_ms):.2f} ms, worst {overhead_ms.max():.1f} ms of 400 steps")
    assert np.median(overhead_ms) < 2.0


@pytest.mark.long
def test_an_abort_stops_the_motor_at_once(tmp_path, capsys):
    """From the call, in mid-dose, to the last step of the simulated doser's plunger, over its serial line."""
    waits_ms = []
    for number in range(10):
        folder = tmp_path / str(number)
        folder.mkdir()
        doser = open_device("simulated-doser", {"folder": str(folder / "doser"), "steps_per_ul": 10.0})
        runner = new_run(Sequence("dose", (Dose(400.0),)), replace(memory_rig(folder), doser=doser), folder / "run")
        thread = threading.Thread(target=runner.run)
        thread.start()
        while doser.true_ul() < 10.0 + 5.0 * number:
            time.sleep(0.001)
        called_ns = time.monotonic_ns()
        runner.abort()
        thread.join(20)
        truth = read_truth(folder / "doser" / "state")
        assert truth.steps < 4000
        waits_ms.append((truth.moved_ns - called_ns) / 1e6)
    with capsys.disabled():
        print(
            f"\nabort to the motor's last step: median {np.median(waits_ms):.1f} ms, worst {max(waits_ms):.1f} ms of 10"
        )
    assert max(waits_ms) < 20.0
