"""A run that is killed loses no acknowledged frame and repeats no dose, whenever it happens."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import tankrig
from drivers.emulation.truth import read_truth
from tankrig.run.recovery import recover

from .killed_run import STEPS_PER_UL, killed_sequence, seen_ul

PROGRAM = Path(__file__).with_name("killed_run.py")


def true_ul(folder: Path) -> float:
    """What the doser has really delivered, once it has stopped: its watchdog ends a dose that nobody feeds."""
    steps = -1
    while steps != (steps := read_truth(folder / "doser" / "state").steps):
        time.sleep(0.3)
    return steps / STEPS_PER_UL


def end_emulator(folder: Path) -> None:
    """The emulator outlives the programs on purpose; it is this folder's, and ends with the test."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                command = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if b"drivers.rig_doser.emulator" in command and str(folder).encode() in command:
                os.kill(int(entry.name), signal.SIGTERM)


def run_through_kills(folder: Path, doses: int, kills: int, seed: int) -> Counter[str]:
    """Kill the run at random moments and resume it, checking what is on disk; what it was doing when killed."""
    chance, doing, words = random.Random(seed), Counter[str](), []
    acknowledged: dict[int, str] = {}
    while True:
        program = subprocess.Popen(
            [sys.executable, PROGRAM, folder, str(doses), *words], stdout=subprocess.PIPE, text=True
        )
        assert program.stdout is not None
        killer = None
        lines = []
        for line in program.stdout:
            if line == "ready\n" and doing.total() - doing["asked"] < kills:
                killer = threading.Timer(chance.uniform(0.0, 0.5), program.kill)
                killer.start()
            lines.append(line)
        status = program.wait(60)
        if killer:
            killer.cancel()
            killer.join()
        whole = [line.split() for line in lines if line.startswith("frame") and line.endswith("\n")]
        acknowledged |= {int(index): sha for _, index, sha in whole}
        words = []
        if status == 3:
            doing["asked"] += 1
            words = [f"{true_ul(folder):g}"]
            continue
        run = tankrig.open_run(folder / "run")
        assert acknowledged.items() <= {event["index"]: event["sha256"] for event in run.events("frame")}.items()
        if status == 0:
            return doing
        assert status == -signal.SIGKILL, "".join(lines)
        wanted_ul = max((event["total_ul"] for event in run.events("dose_intent")), default=0.0)
        assert read_truth(folder / "doser" / "state").steps <= STEPS_PER_UL * wanted_ul
        doing[run.journal[-1].kind if run.journal else "nothing"] += 1
        found = recover(folder / "run")
        assert (found.damaged, found.lost, found.unverified_lines) == ((), (), 0)


def check(folder: Path, doses: int, kills: int, seed: int) -> Counter[str]:
    try:
        doing = run_through_kills(folder, doses, kills, seed)
        assert true_ul(folder) == 10.0 * doses
    finally:
        end_emulator(folder)
    run = tankrig.open_run(folder / "run")
    labels = run.frames.delivered_ul.values
    np.testing.assert_allclose(labels, [seen_ul(pixels) for pixels in run.frames.values], rtol=0.0, atol=1e-9)
    assert len(run.frames) == killed_sequence(doses).frames
    assert run.frames.pattern.values.tolist() == (["dark"] * 3 + ["full"] * 10) * doses
    # A dose that a kill cut in two is a sum of two volumes, which need not round to the whole one.
    np.testing.assert_allclose(labels, np.repeat(10.0 * np.arange(1, doses + 1), 13), rtol=0.0, atol=1e-9)
    assert recover(folder / "run").damaged == ()
    return doing


def test_a_run_killed_now_and_then_is_the_run_it_would_have_been(tmp_path):
    check(tmp_path, doses=4, kills=2, seed=5)


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(1, 26))
def test_forty_kills_lose_alter_and_mislabel_no_frame_and_repeat_no_dose(tmp_path, seed):
    """One of 25 runs; `pytest -m long -n 2 -rP` shares them out over two processors, and prints what they say."""
    begun = time.perf_counter()
    doing = check(tmp_path, doses=80, kills=40, seed=seed)
    kills = doing.total() - doing["asked"]
    assert kills == 40
    assert doing["asked"] >= 1
    print(
        f"seed {seed}: {kills} kills in {time.perf_counter() - begun:.0f} s, by the last thing in the journal: "
        f"{dict(doing)}"
    )
