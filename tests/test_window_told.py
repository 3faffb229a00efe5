"""What the window tells before a run and while it goes on, and that no error in a run ends the window's thread."""

import logging
import os
import signal
import threading
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QMimeData, Qt, QUrl

import tankrig
from drivers.rig import load_rig_file
from drivers.simulated.camera import SimulatedCamera
from tankrig.calibration.file import Calibration, save
from tankrig.devices import CameraSettings
from tests import on_page
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.banner import MOST_SHOWN, Banner
from ui.window.elided import Elided
from ui.window.forms import Form
from ui.window.fresh_water import HERE
from ui.window.kept_log import KeptLog
from ui.window.marked_text import MarkedText

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

    real, in_a_run = SimulatedCamera.capture, threading.Event()

    def failing(*asked: Any) -> Any:
        if in_a_run.is_set():
            raise error
        return real(*asked)

    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 40.0)
        window.host.run_began.connect(lambda *_: in_a_run.set(), Qt.ConnectionType.DirectConnection)
        with monkeypatch.context() as patch:
            patch.setattr(SimulatedCamera, "capture", failing)
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


def test_what_does_not_fit_into_a_line_ends_in_dots(qtbot):
    """ "7 models are" stood in the status bar: the rest was in a second line that nobody saw."""
    line = Elided(1)
    qtbot.addWidget(line)
    line.setContentsMargins(6, 2, 6, 2)
    line.show()
    words = "running step 5 of 40: capture sheet times 4; 7 models are being prepared for the fit, about 42 s left"
    for width in range(200, 900, 13):
        line.resize(width, 30)
        line.say(words)
        assert line.heightForWidth(width) < 2 * line.fontMetrics().lineSpacing()
        assert (line.text() == words) or line.text().endswith("…")
        assert line.too_long == (line.text() != words)


def live_fits() -> list[BaseProcess]:
    """The processes of live fits, as they are called in a list of processes."""
    return [one for one in active_children() if one.name == "live-fit"]


def test_a_live_fit_whose_process_dies_is_told(tmp_path):
    """Who sees a green "completed" believes that all was fitted."""
    others = live_fits()  # of a test before this one, on a busy machine

    def started() -> list[BaseProcess]:
        return [one for one in live_fits() if one not in others]

    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        (tmp_path / "sequence.toml").write_text(SHORT.replace("frames = 2", "frames = 400"))
        window.sequence.load(tmp_path / "sequence.toml")
        until(lambda: window.top.run.isEnabled())
        window.run()
        until(lambda: window.status.running and started(), 60.0)
        (fit,) = started()
        os.kill(fit.pid, signal.SIGKILL)
        until(lambda: "live fit's process has ended" in window.banner.text, 60.0)
        window.stop()
        until(lambda: not window.status.busy, 60.0)


def test_a_reason_at_the_very_first_is_in_the_log_on_disk(tmp_path):
    """The page that lists it comes last, and the rig may have failed by then."""
    rig = write_rig(tmp_path)
    rig.write_text(rig.read_text().replace("tank_ul = 4000.0", 'tank_ul = "much"'))
    with window_on(tmp_path, rig) as window:
        until(lambda: "limits.tank_ul" in window.banner.text, 60.0)
    assert "limits.tank_ul" in (tmp_path / "runs" / "window.log").read_text()


def test_a_log_of_nothing_leaves_no_folder_and_one_that_cannot_be_written_is_said_once(tmp_path, caplog):
    """A window that had no screen left a folder of a mistyped name behind."""
    kept = KeptLog(tmp_path / "typo")
    assert list(tmp_path.iterdir()) == []
    logging.getLogger("tankrig.run").info("opened")
    kept.close()
    assert "opened" in (tmp_path / "typo" / "window.log").read_text()
    (tmp_path / "file").write_text("")
    kept = KeptLog(tmp_path / "file" / "below")
    for _ in range(2):
        logging.getLogger("tankrig.run").info("opened")
    kept.close()
    assert [record.message for record in caplog.records if "cannot be kept there" in record.message] == [
        f"{tmp_path / 'file' / 'below' / 'window.log'}: the log cannot be kept there (Not a directory)"
    ]


def test_what_was_said_of_a_run_goes_with_it(qtbot):
    banner = Banner()
    qtbot.addWidget(banner)
    banner.say("The run a was aborted.", "bad", "Resume it", key="ended", about="runs/a")
    banner.say("Finished: REFIT of a.", "good", "Show it", key="REFIT of a", about="runs/a")
    banner.say("The disk is nearly full.")
    banner.withdraw("runs/a")
    assert banner.text == "The disk is nearly full."
    banner.put_away()
    assert banner.text == ""


def test_a_draft_is_offered_where_the_command_names_another_sequence(tmp_path):
    (tmp_path / "other.toml").write_text(SHORT)
    rig = write_rig(tmp_path)
    with window_on(tmp_path, rig) as first:
        until(lambda: first.status.state.value == "ready", 60.0)
        first.sequence.document.edit_text(SHORT.replace("short", "mine"))
    with window_on(tmp_path, rig, tmp_path / "other.toml") as window:
        until(lambda: window.built and "had not been saved" in window.banner.text, 60.0)
        assert window.sequence.document.path == tmp_path / "other.toml"
        window.banner.press()
        assert 'name = "mine"' in window.sequence.document.text


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("told")
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.status.state.value == "ready" and made.built, 60.0)
        yield made


@pytest.fixture
def window(opened):
    """For several tests: at rest, with nothing to tell."""
    until(lambda: not opened.status.busy)
    while opened.banner.text:
        opened.banner.put_away()
    opened.activateWindow()
    return opened


def test_what_the_camera_has_made_of_an_exposure_is_shown_between_runs(window, monkeypatch):
    real = SimulatedCamera.configure
    monkeypatch.setattr(SimulatedCamera, "configure", lambda self, asked: real(self, CameraSettings(2.0, asked.gain)))
    window.setFocus()  # a field that somebody types in keeps what is typed
    window.host.configure(CameraSettings(30.0))
    until(lambda: on_page.field(window.live, "exposure").value == 2.0, 60.0)


def test_a_file_dropped_on_a_text_is_opened_and_not_written_into_it(window, tmp_path):
    files = QMimeData()
    files.setUrls([QUrl.fromLocalFile(str(tmp_path / "a.toml"))])
    words = QMimeData()
    words.setText("frames = 4")
    for text in (*window.calibration.findChildren(MarkedText), *window.sequence.findChildren(MarkedText)):
        assert not text.canInsertFromMimeData(files)
        assert text.canInsertFromMimeData(words)


def test_a_field_that_makes_no_sense_is_not_shown_on_the_projector(window):
    page = window.projector
    show = on_page.button(page, "Show it")
    until(show.isEnabled)
    typed = page.findChild(Form).rows["y_mm"]
    on_page.fill(typed, "wide")
    assert typed.wrong
    assert not show.isEnabled()
    kinds = on_page.choice(page, "A pattern to show between runs")
    kinds.setCurrentIndex((kinds.currentIndex() + 1) % kinds.count())
    until(show.isEnabled)


def test_what_was_typed_in_a_step_that_is_left_is_told(window, tmp_path):
    (tmp_path / "s.toml").write_text(SHORT + '[[steps]]\ndo = "note"\ntext = "x"\n')
    window.sequence.load(tmp_path / "s.toml")
    steps = window.sequence.steps
    steps.tree.setCurrentItem(steps.tree.topLevelItem(0))
    on_page.fill(steps.findChild(Form).rows["frames"], "foo")
    until(lambda: not window.top.run.isEnabled())
    steps.tree.setCurrentItem(steps.tree.topLevelItem(1))
    until(lambda: "the value before it stands" in window.banner.text)


def test_a_dose_that_the_tank_cannot_hold_is_refused_with_its_own_limit(window):
    """ "0 to 1e+06 µl" was offered of a tank of 4 ml, and a press with an empty field said nothing."""
    window.show_page(window.doser)
    field, dose = on_page.field(window.doser, "Dose until the tank holds"), on_page.button(window.doser, "Dose")
    until(dose.isEnabled)
    dose.click()
    assert field.says.text() == "say how much the tank shall hold; give 0 to 4000 µl in all"
    for typed in ("-50", "4001", "much"):
        on_page.fill(field, typed)
        assert field.says.text() == f"the tank may not hold {typed}; give 0 to 4000 µl in all"
        assert not dose.isEnabled()
    on_page.fill(field, "")


def test_what_the_doser_would_refuse_is_not_offered_and_its_words_say_why(window):
    """A dose beyond its budget could be asked for, and was refused once the pump had been turned to."""
    page = window.doser
    window.show_page(page)
    field, dose = on_page.field(page, "Dose until the tank holds"), on_page.button(page, "Dose")
    volume, prime = on_page.field(page, "Prime the tube with"), on_page.button(page, "Prime")
    until(dose.isEnabled)
    window.host.dose_to(window.status.tank.volume_ul + 50.0)
    until(lambda: window.status.target_ul is not None and not dose.isEnabled())
    assert dose.toolTip() == prime.toolTip() == "it doses; wait for it or stop it"
    until(lambda: not window.status.busy and dose.isEnabled())
    held_ul = window.status.tank.volume_ul
    for total_ul, why in (
        (held_ul + 1500.0, "one dose may have 1000 µl at most and this one has 1500"),
        (held_ul - 20.0, f"the tank holds {held_ul:g} µl already; {HERE}"),
    ):
        on_page.fill(field, f"{total_ul:g}")
        assert (field.says.text(), dose.toolTip(), dose.isEnabled()) == (why, why, False)
        window.host.dose_to(total_ul)
        until(lambda why=why: why in window.banner.text)
        until(lambda: not window.status.busy)
    on_page.fill(field, f"{held_ul + 10.0:g}")
    assert dose.isEnabled()
    assert dose.toolTip() == "dose until the tank holds this much in all"
    on_page.button(page, "the tube hangs in a waste vessel").setChecked(True)
    on_page.fill(volume, "5000")
    assert (
        volume.says.text() == prime.toolTip() == "give more than 0 and no more than the 1000 µl that one dose may have"
    )
    assert not prime.isEnabled()
    on_page.fill(volume, "40")
    until(prime.isEnabled)
    window.stop()
    until(lambda: window.status.stopped and not dose.isEnabled())
    assert dose.toolTip() == prime.toolTip() == "a stop is latched; clear it first"
    on_page.button(page, "Clear the stop").click()
    until(dose.isEnabled)
    on_page.button(page, "the tube hangs in a waste vessel").setChecked(False)
    on_page.fill(field, "")


def test_light_that_misses_the_tank_is_told_where_it_is_drawn(window, tmp_path):
    """A sheet wider than the tank's wall was cut there without a word."""
    cut = "reaches beyond the tank's wall, -80 … 80 mm; what is beyond is cut off"
    wide = '[patterns.wide]\nkind = "sheet"\ny_mm = [-95.0, 60.0]\nz_mm = [56.0, 64.0]\n'
    (tmp_path / "wide.toml").write_text(f'name = "w"\n{wide}[[steps]]\ndo = "capture"\npattern = "wide"\n')
    page = window.sequence
    page.load(tmp_path / "wide.toml")
    until(lambda: f'Pattern "wide": y = -95 … 60 mm {cut}.' in on_page.words_on(page))
    page.tabs.setCurrentWidget(page.patterns)
    until(lambda: f"y = -95 … 60 mm {cut}" in on_page.words_on(page.patterns))
    on_page.fill(page.patterns.findChild(Form).rows["y_mm"], "-60 60")
    until(lambda: cut not in on_page.words_on(page))
    window.show_page(window.projector)
    on_page.choice(window.projector, "A pattern to show between runs").setCurrentText("sheet")
    typed = window.projector.findChild(Form).rows["y_mm"]
    on_page.fill(typed, "-60 90")
    until(lambda: f"y = -60 … 90 mm {cut}" in on_page.words_on(window.projector))
    on_page.fill(typed, "-60 60")
    until(lambda: cut not in on_page.words_on(window.projector))


def test_what_was_wrong_before_does_not_stay_beside_what_is_wrong_now(window):
    """ "[60, -60] lights no pixel" stood there when the field held letters."""
    window.show_page(window.projector)
    on_page.choice(window.projector, "A pattern to show between runs").setCurrentText("sheet")
    typed = window.projector.findChild(Form).rows["y_mm"]
    on_page.fill(typed, "60 -60")
    until(lambda: "y_mm = [60, -60] has no width" in on_page.words_on(window.projector))
    on_page.fill(typed, "abc")
    until(lambda: "has no width" not in on_page.words_on(window.projector))
    on_page.fill(typed, "60 -60")
    until(lambda: "has no width" in on_page.words_on(window.projector))


def test_a_press_long_after_the_first_is_no_second_one(window, monkeypatch):
    """Who pressed once, and comes back an hour later, must not have the tank's ink forgotten at a touch."""
    monkeypatch.setattr("ui.window.doser_page.SURE_MS", 20)
    asked: list[None] = []
    window.doser.refill_asked.connect(lambda: asked.append(None))
    refill = on_page.button(window.doser, "Filled with fresh water")
    refill.click()
    until(lambda: "Press again" not in refill.text())
    refill.click()
    assert not asked
    refill.click()
    assert len(asked) == 1
