"""Figures of the frame path and of the runner; each test prints them (`pytest -m long -s tests/test_run_speed.py`)."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

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
