"""The pumps' stand-ins as processes of their own: they outlive the programs that use them, with the truth."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.emulation.truth import read_truth
from drivers.registry import open_device
from tankrig.devices import Doser

SCALE = 0.3
CLIENT = (
    "import sys, json; from drivers.registry import open_device; driver, settings, total = json.loads(sys.argv[1])\n"
)
CLIENT += "doser = open_device(driver, settings); print('open', flush=True); doser.dose_to(total)"
PUMPS = {
    "new-era": ("drivers.new_era.emulator", 20.0, {"diameter_mm": 12.0, "rate_ml_per_min": 6.0}),
    "cavro": ("drivers.cavro.emulator", 24.0, {"syringe_ul": 1000.0, "speed_ul_per_s": 50.0}),
}


class Pump:
    """A stand-in's process, and programs that use it."""

    def __init__(self, driver: str, folder: Path) -> None:
        self.driver, self.folder, self._running = driver, folder, []
        self.module, self.steps_per_ul, settings = PUMPS[driver]
        paths = {"port": str(folder / "pump"), "count_file": str(folder / "count")}
        self.settings: dict[str, Any] = {**settings, **paths, "time_scale": SCALE}

    def start(self, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", self.module, "--link", str(self.folder / "pump")]
        command += ["--state", str(self.folder / "state"), "--time-scale", str(SCALE), *options]
        self._running.append(subprocess.Popen(command, stderr=subprocess.PIPE))
        until(lambda: (self.folder / "pump").is_symlink() or self._running[-1].poll() is not None)
        return self._running[-1]

    def dose(self, total_ul: float) -> subprocess.Popen[bytes]:
        import json

        what = json.dumps([self.driver, self.settings, total_ul])
        self._running.append(subprocess.Popen([sys.executable, "-c", CLIENT, what], stderr=subprocess.PIPE))
        return self._running[-1]

    def open(self) -> Doser:
        return open_device(self.driver, self.settings)

    @property
    def true_ul(self) -> float:
        return read_truth(self.folder / "state").steps / self.steps_per_ul

    def rests(self) -> bool:
        before = self.true_ul
        time.sleep(0.2)
        return self.true_ul == before

    def end(self) -> None:
        for process in self._running:
            process.kill()
            process.communicate()


def until(holds: Callable[[], bool], timeout_s: float = 30.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.fixture(params=list(PUMPS))
def pump(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Pump]:
    pump = Pump(request.param, tmp_path)
    pump.start(*(["--ready"] if request.param == "cavro" else []))
    yield pump
    pump.end()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_a_program_that_is_gone_stops_the_dose_and_the_next_one_knows_the_count(
    pump: Pump, how: signal.Signals
) -> None:
    """kill -9, or a hang, in mid-dose: nobody dosed on, the target was not reached, and the next program can tell."""
    program = pump.dose(800.0)
    until(lambda: pump.true_ul > 20.0)
    os.kill(program.pid, how)
    until(pump.rests)
    left_ul = pump.true_ul
    assert 20.0 < left_ul < 700.0
    program.kill()
    program.wait()
    doser = pump.open()
    assert doser.stopped
    _, low_ul, high_ul = doser.delivered()
    assert low_ul - 1e-9 <= left_ul <= high_ul + 1e-9
    if doser.unknown:
        doser.resolve(left_ul)
    doser.clear_stop()
    time.sleep(0.1)
    assert pump.true_ul == left_ul, "it went on by itself"
    goal_ul = left_ul + 20.0
    doser.dose_to(goal_ul)
    assert goal_ul - 2.0 <= pump.true_ul <= goal_ul
    doser.close()


def test_a_second_stand_in_on_the_same_state_is_refused(pump: Pump) -> None:
    second = pump.start()
    assert second.wait(20) == 2
    assert b"another emulator" in second.stderr.read()
