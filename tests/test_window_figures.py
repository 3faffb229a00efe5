"""The window's figures, on a machine that does nothing else: `pytest -m long -s tests/test_window_figures.py`.

TANKRIG_RUN_S gives the length of the long run in seconds: 300 for its gaps, 1800 for its memory, which
is measured with `-p no:logging`: pytest keeps each line of the log.
"""

import os
import shutil
import statistics
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import psutil
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

import drivers.rig
from tankrig.devices import CameraSettings, Frame
from tankrig.errors import DeviceError
from tests import on_page
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.event_loop_monitor import TICK_MS

pytestmark = [pytest.mark.long, pytest.mark.timeout(2400)]

SHAPE, PIXEL_MM, RATE = (1024, 1280), 0.15625, 30.0
RUN_S = float(os.environ.get("TANKRIG_RUN_S", "60"))
KEPT_FRAMES = 300
STOP_BYTE = b"\x18"


class PreparedCamera:
    """Frames that were made before, 30 a second; `silent` makes it hang."""

    name, shape, saturation = "prepared camera", SHAPE, 65535

    def __init__(self, pictures: list[np.ndarray]) -> None:
        self._pictures, self._number = pictures, 0
        self._closed, self.silent = threading.Event(), False
        self._start = time.monotonic()
        self.taken = 0

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        if self.silent and self._closed.wait(timeout_s):
            raise DeviceError("prepared camera: is closed; open it again")
        self._number = max(self._number + 1, int((after_ns / 1e9 - self._start) * RATE) + 1)
        due = self._start + self._number / RATE
        time.sleep(max(0.0, due - time.monotonic()))
        self.taken += 1
        start_ns = int(due * 1e9)
        pixels = self._pictures[self._number % len(self._pictures)]
        return Frame(pixels, start_ns, start_ns, time.monotonic_ns(), self._number)

    def close(self) -> None:
        self._closed.set()


def pictures() -> list[np.ndarray]:
    """Of a sheet in milky water, with shot noise."""
    random = np.random.default_rng(0)
    x = np.arange(SHAPE[1]) * PIXEL_MM
    y = (np.arange(SHAPE[0]) - SHAPE[0] / 2) * PIXEL_MM
    light = 200.0 + 20000.0 * np.exp(-x / 120.0) / (1.0 + np.exp((np.abs(y[:, None]) - 60.0) / 4.0))
    return [random.poisson(light).astype(np.uint16) for _ in range(8)]


@pytest.fixture
def prepared(tmp_path, monkeypatch):
    """A rig file whose camera is the prepared one; the camera comes with it."""
    cameras: list[PreparedCamera] = []
    made, open_device, load = pictures(), drivers.rig.open_device, drivers.rig.load_rig_file

    def opened(name: str, settings: Any) -> Any:
        if name != "simulated-camera":
            return open_device(name, settings)
        cameras.append(PreparedCamera(made))
        return cameras[-1]

    def loaded(*arguments: Any) -> Any:
        description = load(*arguments)
        camera = replace(description.bench.camera, shape=SHAPE, pixel_mm=PIXEL_MM)
        return replace(description, bench=replace(description.bench, camera=camera))

    monkeypatch.setattr(drivers.rig, "open_device", opened)
    monkeypatch.setattr(drivers.rig, "load_rig_file", loaded)
    # Half an hour would take 150 GB, which are not looked for: `ring` keeps 300 frames.
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(total=2**50, used=0, free=2**50))
    return write_rig(tmp_path), cameras


@contextmanager
def ring(runs: Path):
    """Keeps only the newest frames of a run on disk, so that it may go on for as long as one likes."""
    ending = threading.Event()

    def work() -> None:
        oldest = 0
        while not ending.wait(0.5):
            frames = next(runs.glob("*/frames"), None)
            while frames and (frames / f"c.{oldest + KEPT_FRAMES}.0.0").exists():
                (frames / f"c.{oldest}.0.0").unlink()
                oldest += 1

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


class Ticks:
    """Gaps of a window's event loop beside the time that a host took from this machine meanwhile.

    And beside the time that the window's thread stood in the queue for a processor, which the kernel tells: what is
    left of a gap without it is the window's own, however busy the machine is.
    """

    def __init__(self, window: Any) -> None:
        self._queue = Path(f"/proc/self/task/{threading.get_native_id()}/schedstat")
        self.reset()
        window.event_loop.ticked.connect(self._look)

    def _look(self, gap_ms: float) -> None:
        if self.count < len(self._told):
            queued_ms = self._queued_ms()
            taken_s = getattr(psutil.cpu_times(), "steal", 0.0)
            self._told[self.count] = gap_ms, taken_s, gap_ms - (queued_ms - self._before_ms)
            self.count, self._before_ms = self.count + 1, queued_ms

    def reset(self) -> None:
        # All of it before the window's memory is measured; ones, for pages of zeros take none until they are written.
        self._told = np.ones((int(1.1e3 * (RUN_S + 60.0) / TICK_MS), 3))
        self.count, self._before_ms = 0, self._queued_ms()

    def _queued_ms(self) -> float:
        return int(self._queue.read_text().split()[1]) / 1e6 if self._queue.exists() else 0.0

    def own_ms(self) -> Any:
        """Gaps less the time in the queue for a processor; longest first."""
        return np.sort(self._told[: self.count, 2])[::-1]

    def undisturbed_ms(self) -> Any:
        """Gaps around which, five ticks to either side, nothing was taken; longest first."""
        ms, taken_s = self._told[: self.count, :2].T
        at = np.arange(self.count)
        before, after = (np.clip(at + by, 0, len(at) - 1) for by in (-5, 5))
        return np.sort(ms[taken_s[after] == taken_s[before]])[::-1]


def test_the_window_stays_smooth_through_a_run_with_a_live_fit(tmp_path, prepared):
    """Gaps of the event loop, pictures per second and memory: what a person feels as getting in the way."""
    rig, cameras = prepared
    steps = int((RUN_S + 60.0) * RATE / 150)
    (tmp_path / "sequence.toml").write_text(
        'name = "long"\n[patterns.sheet]\nkind = "sheet"\ny_mm = [-60.0, 60.0]\nz_mm = [56.0, 64.0]\n'
        '[[steps]]\ndo = "capture"\npattern = "dark"\nframes = 2\n[[steps]]\ndo = "dose"\ntotal_ul = 300.0\n'
        f'[[steps]]\ndo = "repeat"\ntimes = {steps}\nsteps = [{{ do = "capture", pattern = "sheet", frames = 150 }}]\n'
    )
    with window_on(tmp_path, rig) as window, ring(tmp_path / "runs"):
        window.sequence.load(tmp_path / "sequence.toml")
        until(lambda: window.top.run.isEnabled())
        wait_ms(3000)
        ticks = Ticks(window)
        ended: list[Any] = []
        window.host.run_ended.connect(ended.append)
        window.event_loop.reset()
        window.run()
        until(lambda: window.status.running and window.status.progress.step > 3, 60.0)
        window.show_page(window.fit)
        wait_ms(10_000)
        at_start = window.event_loop.worst_ms
        memory = psutil.Process()
        window.event_loop.reset()
        ticks.reset()
        began, displayed, held = time.monotonic(), window.live.displayed, memory.memory_info().rss
        taken = cameras[-1].taken
        while not ended and time.monotonic() < began + RUN_S:
            wait_ms(1000)  # each wait leaves some hundred bytes behind, which `until` would do a hundred times a second
        seconds = time.monotonic() - began
        worst, longest, own = window.event_loop.worst_ms, window.event_loop.longest(5), ticks.undisturbed_ms()
        quiet = 100.0 * len(own) / ticks.count
        rate, taken = (window.live.displayed - displayed) / seconds, (cameras[-1].taken - taken) / seconds
        unqueued = ticks.own_ms()
        grown = (memory.memory_info().rss - held) / 1e6
        fits = len(window.on_screen.shown.fits)
        window.stop()
        until(lambda: ended, 60.0)
    print(
        f"\n{seconds:.0f} s of {SHAPE[1]} × {SHAPE[0]} 16-bit at {RATE:g} Hz, {fits} fits: worst gap {worst:.0f} ms, "
        f"{at_start:.0f} ms while the run began "
        f"(the longest of the last 20 s: {', '.join(f'{gap:.0f}' for gap in longest)}; "
        f"around the {quiet:.1f} % of ticks with no time taken by a host "
        f"{', '.join(f'{gap:.0f}' for gap in own[:5])}; less the time in the queue for a processor "
        f"{', '.join(f'{gap:.0f}' for gap in unqueued[:8])}, {(unqueued > 33.0).sum()} above 33), "
        f"{rate:.2f} pictures/s of the {taken:.2f} that the run takes, memory {grown:+.1f} MB"
    )
    assert ended[0].reason.value == "aborted", ended[0].error
    assert rate > 29.5
    assert rate > 0.995 * taken
    assert fits > 1
    if RUN_S >= 300.0:
        assert worst <= 33.0
        assert grown <= 20.0


@pytest.fixture
def stops(monkeypatch):
    """When stop bytes went onto the wire."""
    import serial

    seen: list[float] = []
    write = serial.Serial.write

    def watched(port: Any, data: bytes) -> Any:
        done = write(port, data)
        if STOP_BYTE in bytes(data):
            seen.append(time.perf_counter())
        return done

    monkeypatch.setattr(serial.Serial, "write", watched)
    return seen


@pytest.mark.parametrize("trouble", ["nothing", "busy processors", "a hanging camera", "a hanging doser"])
def test_from_the_key_to_the_stop_byte(tmp_path, prepared, stops, trouble):
    """The promise of the red button, also when all else is busy or hangs."""
    rig, cameras = prepared
    burners = []
    if trouble == "busy processors":
        spin = "import os\nos.nice(10)\nwhile True: pass"
        burners = [subprocess.Popen([sys.executable, "-c", spin]) for _ in range(2)]
    times = []
    try:
        with window_on(tmp_path, rig) as window:
            for number in range(5):
                until(on_page.button(window.doser, "Dose").isEnabled, 60.0)
                window.host.dose_to(150.0 * (number + 1))
                until(lambda n=number: window.status.tank.volume_ul > 150.0 * n + 20.0)
                cameras[-1].silent = trouble == "a hanging camera"
                hung = [child for child in psutil.Process().children() if "emulator" in " ".join(child.cmdline())]
                if trouble == "a hanging doser":
                    hung[0].suspend()
                stops.clear()
                pressed = time.perf_counter()
                QTest.keyClick(window, Qt.Key.Key_F12)
                until(lambda: stops)
                times.append(1e3 * (stops[0] - pressed))
                cameras[-1].silent = False
                hung[0].resume()
                until(lambda: window.status.target_ul is None, 60.0)
                window.host.clear_stop()
                until(lambda: not window.status.stopped, 60.0)
    finally:
        for burner in burners:
            burner.kill()
    print(f"\nkey to stop byte with {trouble}: {', '.join(f'{one:.1f}' for one in times)} ms")
    assert max(times) < 100.0


STARTED = """
import sys, time
from pathlib import Path
began = float(sys.argv[2])
if __name__ == "__main__":
    from ui.cli import main  # as the command `tankrig` does
    from ui.window import app
    from PySide6.QtCore import QSettings, QTimer
    app.settings = lambda: QSettings(sys.argv[1] + "/w.ini", QSettings.Format.IniFormat)
    made, told = app.application, []

    def look():
        from PySide6.QtWidgets import QApplication
        windows = [one for one in QApplication.topLevelWidgets() if one.objectName() == "tankrig"]
        if windows and windows[0].live.displayed and not told:
            told.append(time.time() - began)  # the picture was painted before this timer fired again
        if windows and windows[0].built:
            print(told[0], time.time() - began)
            timer.stop()
            windows[0].close()

    timer = QTimer()
    timer.timeout.connect(look)

    def application():
        program = made()
        timer.start(1)
        return program

    app.application = application
    sys.exit(main(["gui", "--runs", sys.argv[1] + "/runs"]))
"""


def test_from_the_start_of_the_program_to_the_first_picture(tmp_path):
    """Somebody who waits for a window starts a second one."""
    (tmp_path / "start.py").write_text(STARTED)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    taken = []
    for _ in range(6):
        command = [sys.executable, str(tmp_path / "start.py"), str(tmp_path), str(time.time())]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)
        assert done.returncode == 0, done.stderr
        taken.append([float(word) for word in done.stdout.split()])
    pictures, pages = zip(*taken[1:], strict=True)  # the first run warms the disk
    print(
        f"\nstart to first picture: {', '.join(f'{one:.2f}' for one in pictures)} s, "
        f"median {statistics.median(pictures):.2f}; to all pages: median {statistics.median(pages):.2f}"
    )
    assert statistics.median(pictures) < 2.0
