"""How many things a person has to do: each press of a button, key, or line that is typed counts as one action."""

import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QFileDialog, QLineEdit, QPushButton, QWidget

from tests import on_page
from tests import recorded_runs as runs
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.first_start import EXAMPLE
from ui.window.marked_text import MarkedText
from ui.window.source import Kind


class Hands:
    """Presses and types what a person would, and counts it."""

    def __init__(self, window: QWidget) -> None:
        self.window, self.actions = window, 0

    def click(self, widget: QWidget) -> None:
        assert widget.isVisible()
        assert widget.isEnabled()
        self.actions += 1
        QTest.mouseClick(widget, Qt.MouseButton.LeftButton)

    def press(self, key: Qt.Key, control: bool = False) -> None:
        self.actions += 1
        modifier = Qt.KeyboardModifier.ControlModifier if control else Qt.KeyboardModifier.NoModifier
        QTest.keyClick(self.window, key, modifier)

    def answer(self, path: Path) -> None:
        """Type a file's name into the question that stands beside the window, and press Enter: two actions."""
        until(lambda: any(one.isVisible() for one in self.window.findChildren(QFileDialog)))
        (question,) = [one for one in self.window.findChildren(QFileDialog) if one.isVisible()]
        question.activateWindow()
        assert QTest.qWaitForWindowActive(question, 10_000)
        field = question.findChild(QLineEdit, "fileNameEdit")
        field.setFocus()
        until(field.hasFocus)
        wait_ms(100)
        field.selectAll()
        QTest.keyClicks(field, str(path))
        wait_ms(500)  # the list beside the field follows what is typed
        QTest.keyClick(field, Qt.Key.Key_Return)
        self.actions += 2
        until(lambda: not any(one.isVisible() for one in self.window.findChildren(QFileDialog)))
        self.window.activateWindow()
        assert QTest.qWaitForWindowActive(self.window, 10_000)


def try_it(hands: Hands, by: str) -> None:
    """The first thing that a person does."""
    button = hands.window.sequence.first.buttons["Try it"]
    if by == "mouse":
        hands.click(button)
    else:
        assert hands.window.ring.around is button, "the keyboard is not where a person begins"
        hands.actions += 1
        QTest.keyClick(QApplication.focusWidget(), Qt.Key.Key_Space)


@contextmanager
def a_demo_that_runs(tmp_path, by):
    """The window, and the hands that have begun a demo."""
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        hands = Hands(window)
        try_it(hands, by)
        until(lambda: window.top.run.isEnabled(), 60.0)
        hands.press(Qt.Key.Key_F5)
        yield window, hands
        window.stop()
        until(lambda: not window.status.busy, 60.0)


@pytest.mark.parametrize("by", ["mouse", "keyboard"])
def test_from_the_start_to_a_demo_that_runs(tmp_path, by):
    """Two: try it, run it. A third looks at the fits that come."""
    with a_demo_that_runs(tmp_path, by) as (window, hands):
        until(lambda: window.status.running and window.on_screen.source.run is not None, 60.0)
        assert not isinstance(QApplication.focusWidget(), QPushButton), "the space bar would press something else"
        hands.press(Qt.Key.Key_2, control=True)
        until(window.fit.card.isVisible)
    assert hands.actions == 3


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("by", ["mouse", "keyboard"])
def test_from_the_start_to_a_fitted_demo(tmp_path, by):
    """At most four: try it, run it, look at it."""
    with a_demo_that_runs(tmp_path, by) as (window, hands):
        until(lambda: window.on_screen.shown.fits, 400.0)
        hands.press(Qt.Key.Key_2, control=True)
        until(lambda: window.fit.card.values["sigma_s"][1].text() != "–")
        assert window.fit.card.isVisible()
    print(f"\nfrom the start to a fitted demo by {by}: {hands.actions} actions")
    assert hands.actions <= 4


def test_from_the_start_to_a_run_on_an_own_rig(tmp_path):
    """At most eight: its file, a sequence, and Run."""
    own = tmp_path / "own"
    own.mkdir()
    rig = write_rig(own)
    rig.write_text(rig.read_text().replace('name = "test rig"', 'name = "own rig"'))
    (tmp_path / "short.toml").write_text('name = "s"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n')
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        hands = Hands(window)
        hands.click(window.sequence.first.buttons["Connect my rig"])
        hands.answer(rig)
        until(lambda: window.top.badge.text() == "own rig" and window.status.state.value == "ready", 60.0)
        to_the_rig = hands.actions
        hands.press(Qt.Key.Key_O, control=True)
        hands.answer(tmp_path / "short.toml")
        until(lambda: window.top.run.isEnabled(), 60.0)
        hands.press(Qt.Key.Key_F5)
        until(lambda: window.status.running or window.on_screen.source.run is not None, 60.0)
        until(lambda: not window.status.busy, 120.0)
        assert window.on_screen.shown.ending == "completed"
    print(f"\nto an own rig: {to_the_rig} actions; to a run on it: {hands.actions}")
    assert hands.actions <= 8


def test_from_the_start_to_two_runs_compared(tmp_path):
    """At most six: the page, and a tick for each."""
    for name, doses in (("a", 3), ("b", 2)):
        runs.recorded(tmp_path / "runs" / f"run-{name}", doses)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        hands = Hands(window)
        hands.press(Qt.Key.Key_8, control=True)
        listed = on_page.rows_of(window.compare, "runs to compare")
        until(lambda: listed.isVisible() and listed.count() == 2)
        listed.setFocus()
        for row in range(2):
            hands.actions += 1  # a press of the space bar on a row
            listed.setCurrentRow(row)
            QTest.keyClick(listed, Qt.Key.Key_Space)
        results = on_page.rows_of(window.compare, "results of the runs that are ticked")
        until(lambda: {row[0] for row in on_page.cells(results)} == {"REPLAY of run-a", "REPLAY of run-b"}, 30.0)
        assert {one.kind for one in window.compare.compared} == {Kind.REPLAY}
    print(f"\nto two runs compared: {hands.actions} actions")
    assert hands.actions <= 6


def test_a_rig_file_that_is_edited_outside_is_told_and_not_written_over(tmp_path):
    """Two people edit one file: neither must lose what they wrote without a word."""
    rig = write_rig(tmp_path)
    with window_on(tmp_path, rig) as window:
        until(lambda: window.status.state.value == "ready" and window.built, 60.0)
        file, text = window.calibration.findChild(MarkedText), rig.read_text()
        again, save = (on_page.button(window.calibration, one) for one in ("Open the rig again", "Save and open again"))
        rig.write_text(text.replace("tank_ul = 4000.0", "tank_ul = 3000.0"))
        until(lambda: "changed by another program" in window.banner.text, 20.0)
        assert "tank_ul = 3000.0" in file.toPlainText()
        assert window.rig.limits.tank_ul == 4000.0, "it counts once the rig is opened again"
        until(again.isEnabled)
        again.click()
        until(lambda: window.rig.limits.tank_ul == 3000.0, 60.0)
        until(lambda: window.status.state.value == "ready", 60.0)
        file.setPlainText(text.replace("tank_ul = 4000.0", "tank_ul = 2500.0"))
        rig.write_text(text.replace("tank_ul = 4000.0", "tank_ul = 3500.0"))
        until(lambda: "and here, too" in window.banner.text, 20.0)
        save.click()
        assert "3500" in rig.read_text()
        assert "press again" in window.banner.text
        save.click()
        assert "2500" in rig.read_text()
        until(lambda: window.rig.limits.tank_ul == 2500.0, 60.0)
        until(lambda: window.status.state.value == "ready", 60.0)
        rig.unlink()
        until(lambda: "is gone" in window.banner.text, 20.0)
        assert window.status.state.value == "ready", "the rig stays as it was opened"


def test_a_draft_that_cannot_be_kept_is_told(tmp_path, monkeypatch):
    """A full disk takes what is typed, and nobody knows."""
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.built and window.status.state.value == "ready", 60.0)
        shutil.copy(EXAMPLE, tmp_path / "own.toml")
        window.sequence.load(tmp_path / "own.toml")
        monkeypatch.setattr(QSettings, "status", lambda _: QSettings.Status.AccessError)
        window.sequence.document.edit_text(EXAMPLE.read_text() + "# more\n")
        until(lambda: "what is typed is not kept" in window.banner.text, 10.0)
        wait_ms(50)
