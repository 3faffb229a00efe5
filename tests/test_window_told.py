"""What the window tells before a run and while it goes on, and that no error in a run ends the window's thread."""

from pathlib import Path

import pytest

import tankrig
from drivers.rig import load_rig_file
from drivers.simulated.camera import SimulatedCamera
from tankrig.calibration.file import Calibration, save
from tankrig.devices import CameraSettings
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.banner import MOST_SHOWN, Banner

SHORT = 'name = "short"\nexposure_ms = 5\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n'


def run(window, folder: Path) -> None:
    (folder / "sequence.toml").write_text(SHORT)
    window.sequence.load(folder / "sequence.toml")
    until(lambda: window.top.run.isEnabled())
    window.run()


def said(window, words: str) -> bool:
    wait_ms(10)
    return any(words in line for line in window.log.lines())


def test_a_damaged_newest_calibration_is_told_and_no_run_begins(tmp_path):
    """Who looks may look; who runs has to decide first."""
    rig = write_rig(tmp_path)
    folder = Path(load_rig_file(rig).calibration_folder)
    one = Calibration("latency", "simulated projector", (30, 40), {"p99_ms": 9.0}, date="2026-01-01T00:00:00+00:00")
    older = save(one, folder)
    newer = save(Calibration("latency", one.device, one.shape, {"p99_ms": 9.5}), folder)
    newer.path.write_text(newer.path.read_text().replace("9.5", "9.6"))
    with window_on(tmp_path, rig) as window:
        until(lambda: window.status.state.value == "ready", 40.0)
        until(lambda: newer.path.name in window.banner.text and older.path.name in window.banner.text)
        window.banner.put_away()
        run(window, tmp_path)
        until(lambda: "a person has to decide" in window.banner.text, 40.0)
        until(lambda: window.status.state.value == "ready", 40.0)
    assert not list((tmp_path / "runs").glob("*/zarr.json"))


def test_a_camera_that_clamps_is_told_in_the_log(tmp_path, monkeypatch):
    real = SimulatedCamera.configure
    monkeypatch.setattr(SimulatedCamera, "configure", lambda self, asked: real(self, CameraSettings(2.0, asked.gain)))
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        ended = []
        window.host.run_ended.connect(ended.append)
        run(window, tmp_path)
        until(lambda: ended, 60.0)
        until(lambda: said(window, "was asked for 5 ms at gain 1 and has set 2 ms at gain 1"))
        assert ended[0].error is None


@pytest.mark.parametrize("error", [RuntimeError("a bug"), SystemExit(3)])
def test_an_error_of_any_kind_in_a_run_is_told_and_the_rig_can_be_opened_again(tmp_path, monkeypatch, error):
    """A thread that is gone leaves a window that says nothing and a rig that nobody has."""

    def failing(*_: object) -> None:
        raise error

    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 40.0)
        with monkeypatch.context() as patch:
            patch.setattr("tankrig.run.runner.Runner._capture", failing)
            run(window, tmp_path)
            until(lambda: f"failed unexpectedly ({type(error).__name__}" in window.banner.text, 60.0)
        (path,) = [file.parent for file in (tmp_path / "runs").glob("*/zarr.json")]
        assert tankrig.open_run(path).end["reason"] == "failed"
        window.host.reopen()
        until(lambda: window.status.state.value == "ready", 40.0)


def test_however_much_is_told_a_person_can_put_it_away_and_read_it_again(qtbot):
    """A day's notices, each of something else, would otherwise wait to be put away one by one."""
    banner = Banner()
    qtbot.addWidget(banner)
    for number in range(5 * MOST_SHOWN):
        banner.say(f"frame {number} is missing")
    for _ in range(MOST_SHOWN):
        assert banner.text
        banner.put_away()
    assert banner.text == ""
    assert [one.sentence for one in banner.history] == [f"frame {n} is missing" for n in range(5 * MOST_SHOWN)]
