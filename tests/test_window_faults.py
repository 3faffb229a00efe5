"""The window when things go wrong: nothing acknowledged is lost, the pump stands still, the reason is said."""

import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import tankrig
from drivers.emulation.truth import read_truth
from drivers.rig import load_rig_file
from tankrig.devices import Delivered
from tankrig.dosing import TankLedger
from tankrig.dosing.records import JointCount
from tankrig.run import disk
from tankrig.run.recovery import recover
from tests import on_page
from tests.window_rig import LONG_DOSE, until, wait_ms, window_on, write_rig
from ui.window.status import RigState

FRAMES = 'name = "frames"\nexposure_ms = 2.0\n[[steps]]\ndo = "capture"\npattern = "dark"\nframes = 400\n'


def steps_of(folder: Path) -> int:
    """What the plunger has really pushed out so far."""
    return read_truth(folder / "rig" / "tank" / "state").steps


def began(window, folder: Path, sequence: str) -> None:
    (folder / "sequence.toml").write_text(sequence)
    window.sequence.load(folder / "sequence.toml")
    until(lambda: window.top.run.isEnabled())
    window.run()
    until(lambda: window.status.running)


def decide(window, volume_ul: float) -> None:
    """A person says what the tank holds."""
    on_page.fill(on_page.field(window.doser, "The tank holds"), f"{volume_ul:g}")
    on_page.button(window.doser, "That is what it holds").click()


def only_run(folder: Path) -> Path:
    (run,) = [path.parent for path in (folder / "runs").glob("*/zarr.json")]
    return run


def test_closing_in_a_dose_stops_it_and_the_run_is_offered_again(tmp_path):
    """Whoever closes the window goes home; ink that flows on fills the tank."""
    rig = write_rig(tmp_path)
    with window_on(tmp_path, rig) as window:
        began(window, tmp_path, LONG_DOSE)
        until(lambda: window.status.tank is not None and window.status.tank.volume_ul > 30.0)
        window.close()
        assert window.isVisible()  # it stays until all is safe, and says so
        assert "closes when all it recorded is safe" in window.banner.text
        until(lambda: not window.isVisible())
    held = steps_of(tmp_path)
    assert 300 < held < 9000
    time.sleep(0.3)
    assert steps_of(tmp_path) == held
    assert tankrig.open_run(only_run(tmp_path)).end["reason"] == "aborted"
    with window_on(tmp_path, rig) as window:
        until(lambda: "was aborted" in window.banner.text)
        assert window.banner.action
        ended = []
        window.host.run_ended.connect(ended.append)
        window.banner.press()
        until(lambda: ended, 60.0)
        assert ended[0].reason.value == "completed", ended[0].error
        assert steps_of(tmp_path) == 9000


def test_a_run_whose_fit_cannot_begin_is_ended_and_can_be_resumed(tmp_path, monkeypatch):
    """No room on the disk: a run that is neither going on nor over keeps its folder locked."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tankrig.live.attached.open_run", full)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        (tmp_path / "sequence.toml").write_text(LONG_DOSE)
        window.sequence.load(tmp_path / "sequence.toml")
        until(lambda: window.top.run.isEnabled())
        window.run()
        until(lambda: "No space left" in window.banner.text, 40.0)
        monkeypatch.undo()
        window.host.reopen()
        until(lambda: window.status.state.value == "ready", 40.0)
        ended = []
        window.host.run_ended.connect(ended.append)
        window.resume(only_run(tmp_path))
        until(lambda: ended, 60.0)
        assert ended[0].reason.value == "completed", ended[0].error
    assert steps_of(tmp_path) == 9000


@pytest.mark.long
def test_an_unplugged_camera_ends_the_run_and_is_named(tmp_path):
    """A person must know which cable to look at, and what was recorded."""
    with window_on(tmp_path, write_rig(tmp_path, camera="faults = { unplugged_from = 60 }")) as window:
        until(lambda: window.status.state.value == "ready")
        began(window, tmp_path, FRAMES)
        until(lambda: "camera" in window.banner.text and "is gone" in window.banner.text, 40.0)
        assert "Resume it" in window.banner.action
    found = recover(only_run(tmp_path))
    assert found.frames > 0
    assert not found.damaged


@pytest.mark.long
def test_a_full_disk_ends_the_run_and_says_so(tmp_path, monkeypatch):
    """What was acknowledged stays; what to do is on screen."""
    write, count = disk.write, []

    def full(path: Path, data: bytes) -> None:
        count.append(path)
        if len(count) > 40 and "frames" in str(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(path, data)

    monkeypatch.setattr(disk, "write", full)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        began(window, tmp_path, FRAMES)
        until(lambda: "No space left" in window.banner.text, 40.0)
        assert "free some space" in window.banner.text
    found = recover(only_run(tmp_path))
    assert found.frames > 10
    assert not found.damaged


def rig_with_an_unknown_tank(folder: Path) -> Path:
    """Its file; a crash in a dose has left 0 to 500 µl in the tank."""
    rig = write_rig(folder)
    ledger = TankLedger(load_rig_file(rig).ledger)
    nothing = Delivered(0.0, 0.0, 0.0)
    ledger.join(JointCount("another doser", nothing, nothing))
    ledger.begin("some run", 500.0)
    ledger.close()
    return rig


def test_an_unknown_tank_is_explained_and_resolved(tmp_path):
    """After a crash in a dose nobody knows what the tank holds; a window that guesses doses twice."""
    rig = rig_with_an_unknown_tank(tmp_path)
    with window_on(tmp_path, rig) as window:
        until(lambda: window.status.undecided is not None)
        asked = on_page.words_on(window.doser)
        assert "It is not known how much ink the tank holds." in asked
        assert "between 0 and 500 µl" in asked
        assert not on_page.button(window.doser, "Dose").isEnabled()
        assert "see the Doser page" in on_page.words_on(window.statusBar())
        decide(window, 700)
        until(lambda: "it is between 0 and 500 µl" in window.banner.text)
        decide(window, 120)
        until(lambda: window.status.undecided is None and window.status.tank.volume_ul == 120.0)
        assert "It is not known how much ink the tank holds." not in on_page.words_on(window.doser)


def test_stop_while_the_window_asks_about_the_ink_gives_the_run_up(tmp_path):
    """A person's word on the tank went nowhere after STOP, and was taken later, when nobody thought of it."""
    rig = rig_with_an_unknown_tank(tmp_path)
    with window_on(tmp_path, rig) as window:
        until(lambda: window.status.undecided is not None and window.status.state is RigState.IDLE)
        (tmp_path / "sequence.toml").write_text(LONG_DOSE)
        window.sequence.load(tmp_path / "sequence.toml")
        until(lambda: window.sequence.document.plan is not None)
        window.run()
        until(lambda: window.status.state is RigState.ASKING, 40.0)
        assert not window.host.in_motion, "Esc stops nothing here"
        window.stop()
        until(lambda: window.status.state is RigState.IDLE, 40.0)
        decide(window, 120)
        until(lambda: window.status.undecided is None and window.status.tank.volume_ul == 120.0)
        assert not window.status.running
    assert steps_of(tmp_path) == 0


TWO_DOSES = (
    'name = "two"\n[[steps]]\ndo = "dose"\ntotal_ul = 100\n[[steps]]\ndo = "wait"\nseconds = 2\n'
    '[[steps]]\ndo = "dose"\ntotal_ul = 200\n'
)


def interrupted_in_the_wait(window, folder: Path) -> Path:
    """A run that was stopped when the tank held 100 µl and 200 were to come."""
    began(window, folder, TWO_DOSES)
    until(lambda: only_run(folder).exists() and tankrig.open_run(only_run(folder)).events("dose_done"))
    window.stop()
    until(lambda: not window.status.busy and window.status.tank is not None and window.status.tank.volume_ul == 100.0)
    return only_run(folder)


def test_a_run_that_would_go_on_in_fresh_water_is_asked_about_with_the_numbers(tmp_path):
    """Its second dose would make another concentration than its journal says, without a word."""
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        run = interrupted_in_the_wait(window, tmp_path)
        on_page.button(window.doser, "Filled with fresh water").click()
        on_page.button(window.doser, "Press again: the tank is empty of ink and filled anew").click()
        until(lambda: window.status.tank is not None and window.status.tank.volume_ul == 0.0)
        window.resume(run)
        until(lambda: window.status.undecided is not None)
        asked = on_page.words_on(window.doser)
        assert "the run's journal says that the tank holds 100 µl" in asked
        assert "between 0 and 100 µl" in asked
        decide(window, 130)
        until(lambda: "cannot hold 130 µl" in on_page.words_on(window.doser))
        assert steps_of(tmp_path) == 1000
        ended = []
        window.host.run_ended.connect(ended.append)
        decide(window, 0)
        until(lambda: ended, 60.0)
        assert ended[0].reason.value == "completed", ended[0].error
    assert steps_of(tmp_path) == 3000, "the fresh water has 200 µl now"
    session = tankrig.open_run(run).events("session")[-1]
    assert (session["said_ul"], session["delivered_ul"]) == (0.0, 0.0)


def test_a_run_goes_on_without_a_question_where_all_agree(tmp_path):
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        run = interrupted_in_the_wait(window, tmp_path)
        ended = []
        window.host.run_ended.connect(ended.append)
        window.resume(run)
        until(lambda: ended or window.status.undecided, 60.0)
        assert ended, window.status.undecided
    assert steps_of(tmp_path) == 2000


def test_a_lost_ledger_is_asked_about_before_a_run_goes_on(tmp_path):
    """The journal knows of 100 µl and the new ledger does not; dosing 200 more would make 300."""
    rig = write_rig(tmp_path)
    with window_on(tmp_path, rig) as window:
        run = interrupted_in_the_wait(window, tmp_path)
    load_rig_file(rig).ledger.unlink()
    with window_on(tmp_path, rig) as window:
        until(lambda: window.status.tank is not None and not window.status.busy)
        window.resume(run)
        until(lambda: window.status.undecided is not None)
        assert "or its ledger was lost" in on_page.words_on(window.doser)
        ended = []
        window.host.run_ended.connect(ended.append)
        decide(window, 100)
        until(lambda: ended, 60.0)
    assert steps_of(tmp_path) == 2000


@pytest.mark.long
def test_a_killed_program_stops_the_pump_and_loses_nothing(tmp_path):
    """kill -9 is what a power switch, or an impatient person, does."""
    rig = write_rig(tmp_path)
    (tmp_path / "sequence.toml").write_text(LONG_DOSE)
    program = (
        "import sys\nfrom pathlib import Path\nfrom tests.window_rig import window_on, until\n"
        f"folder = Path({str(tmp_path)!r})\n"
        "if __name__ == '__main__':\n"
        f"    with window_on(folder, Path({str(rig)!r})) as window:\n"
        "        window.sequence.load(folder / 'sequence.toml')\n"
        "        until(lambda: window.top.run.isEnabled())\n"
        "        window.run()\n"
        "        until(lambda: False, 60.0)\n"
    )
    script = tmp_path / "window.py"
    script.write_text(program)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    child = subprocess.Popen([sys.executable, str(script)], env=environment)
    deadline = time.monotonic() + 60.0
    while (
        not list((tmp_path / "runs").glob("*/journal.jsonl"))
        or b"dose_intent" not in next((tmp_path / "runs").glob("*/journal.jsonl")).read_bytes()
    ):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.4)
    child.kill()
    child.wait()
    time.sleep(2.5)  # the doser's own watchdog
    held = steps_of(tmp_path)
    assert 0 < held < 9000
    assert not recover(only_run(tmp_path)).damaged
    with window_on(tmp_path, rig) as window:
        until(lambda: "was interrupted" in window.banner.text)
        window.banner.press()
        until(lambda: window.status.undecided is not None, 30.0)
        ended = []
        window.host.run_ended.connect(ended.append)
        decide(window, held / 10.0)
        until(lambda: ended, 60.0)
        assert ended[0].reason.value == "completed", ended[0].error
    assert steps_of(tmp_path) == 9000
    wait_ms(1)
