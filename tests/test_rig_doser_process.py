"""The emulator as a process of its own: it outlives its clients, and its state file outlives it."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.emulation.truth import read_truth
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.settings import RigDoserSettings
from tankrig.errors import DeviceError, UndecidedError

SCALE = 0.3
CLIENT = f"""
import sys
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.settings import RigDoserSettings
doser = RigDoser(RigDoserSettings(port=sys.argv[1], steps_per_ul=10.0, time_scale={SCALE}))
doser.dose_to(float(sys.argv[2]))
"""


class Emulators:
    """Emulator processes on one state file."""

    def __init__(self, folder: Path) -> None:
        self.folder, self._running = folder, []

    def start(self, *options: str) -> subprocess.Popen[bytes]:
        (self.folder / "doser").unlink(missing_ok=True)
        paths = [
            "--link",
            self.folder / "doser",
            "--state",
            self.folder / "state",
            "--control",
            self.folder / "control",
        ]
        command = [sys.executable, "-m", "drivers.rig_doser.emulator", *map(str, paths), "--time-scale", str(SCALE)]
        process = subprocess.Popen([*command, *options], stderr=subprocess.PIPE)
        self._running.append(process)
        until(lambda: (self.folder / "doser").is_symlink() or process.poll() is not None)
        return process

    def open(self) -> RigDoser:
        port = str(self.folder / "doser")
        return RigDoser(RigDoserSettings(port=port, steps_per_ul=10.0, time_scale=SCALE))

    def client(self, total_ul: float) -> subprocess.Popen[bytes]:
        process = subprocess.Popen([sys.executable, "-c", CLIENT, str(self.folder / "doser"), str(total_ul)])
        self._running.append(process)
        return process

    def steps(self) -> int:
        return read_truth(self.folder / "state").steps

    def end(self) -> None:
        for process in self._running:
            process.kill()
            process.communicate()


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < deadline, "waited for too long"
        time.sleep(0.002)


@pytest.fixture
def emulators(tmp_path: Path) -> Iterator[Emulators]:
    emulators = Emulators(tmp_path)
    yield emulators
    emulators.end()


def test_the_watchdog_stops_the_motor_of_a_killed_client(emulators: Emulators) -> None:
    """kill -9 in mid-dose: the doser lives on, stops by itself, and tells the next program what it delivered."""
    emulators.start()
    client = emulators.client(4000.0)
    until(lambda: emulators.steps() > 500)
    client.kill()
    client.wait()
    until(lambda: rests(emulators))
    assert 500 < emulators.steps() < 20_000
    doser = emulators.open()
    assert doser.stopped
    assert doser.delivered().volume_ul == emulators.steps() / 10
    doser.close()


def rests(emulators: Emulators) -> bool:
    before = emulators.steps()
    time.sleep(0.2)
    return emulators.steps() == before


def test_a_frozen_client_is_as_good_as_a_killed_one(emulators: Emulators) -> None:
    emulators.start()
    client = emulators.client(4000.0)
    until(lambda: emulators.steps() > 500)
    os.kill(client.pid, signal.SIGSTOP)
    until(lambda: rests(emulators))
    assert emulators.steps() < 20_000
    with pytest.raises(DeviceError, match="another program"):
        emulators.open()


def test_the_count_survives_the_emulators_own_death(emulators: Emulators) -> None:
    """Power cuts of the board in mid-dose: each leaves at most one step in doubt, and the truth between the bounds."""
    for cut in range(1, 6):
        board = emulators.start()
        doser = emulators.open()
        if doser.stopped:
            doser.clear_stop()
        _, low, high = doser.delivered()
        assert low <= emulators.steps() / 10 <= high <= low + 0.1 * cut + 1e-9
        killer = threading.Thread(target=kill_when, args=(board, emulators, emulators.steps() + 300))
        killer.start()
        with pytest.raises(UndecidedError):
            doser.dose_to(1000.0)
        killer.join()
        doser.close()
        assert emulators.steps() < 10_000


def kill_when(process: subprocess.Popen[bytes], emulators: Emulators, steps: int) -> None:
    until(lambda: emulators.steps() >= steps)
    process.kill()
    process.wait()


def test_a_second_emulator_on_the_same_state_is_refused(emulators: Emulators) -> None:
    emulators.start()
    second = emulators.start()
    assert second.wait(20) == 2
    assert b"another emulator" in second.stderr.read()


def test_it_ends_when_nobody_wants_it(emulators: Emulators) -> None:
    board = emulators.start("--linger-s", "0.2")
    emulators.open().close()
    assert board.wait(20) == 0
    assert not (emulators.folder / "doser").is_symlink()


def test_faults_are_switched_through_the_control_socket(emulators: Emulators) -> None:
    board = emulators.start()
    doser = emulators.open()
    until((emulators.folder / "control").exists)
    with socket.socket(socket.AF_UNIX) as control:
        control.connect(str(emulators.folder / "control"))
        stream = control.makefile("rw")

        def ask(request: object) -> dict[str, object]:
            stream.write(json.dumps(request) + "\n")
            stream.flush()
            return json.loads(stream.readline())

        assert ask({"faults": {"reset_after": 100}})["faults"]["reset_after"] == 100
        with pytest.raises(DeviceError, match="reset"):
            doser.dose_to(50.0)
        assert ask({})["true_steps"] == 100
        assert "error" in ask({"faults": {"nonsense": 1}})
        assert "error" in ask("nonsense")
        doser.close()
        ask({"do": "quit"})
    assert board.wait(20) == 0
