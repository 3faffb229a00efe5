"""What a person who has never seen the window meets: ways to begin, results that say what they are, runs compared."""

import os
import re
import signal

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest

from tankrig.devices import Delivered
from tests import on_page
from tests import recorded_runs as runs
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window import jobs, sequence_text
from ui.window.first_start import EXAMPLE
from ui.window.keys import KEYS
from ui.window.palette import Palette
from ui.window.result import NAMES, of_dose, result_of
from ui.window.source import Kind, RefitSettings, Source
from ui.window.source_frame import SourceFrame

SLOW_S = 150.0
"""In which work in the background, of low priority, comes about beside three busy programs on two cores."""


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    folder = tmp_path_factory.mktemp("first")
    for name, doses in (("a", 3), ("b", 2)):
        runs.recorded(folder / "runs" / f"run-{name}", doses)
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.status.state.value == "ready" and made.live.displayed, 60.0)
        made.home = folder
        yield made


def click(button) -> None:
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)


def test_the_first_page_offers_ways_to_begin_and_no_error(tmp_path):
    """It was met by a red: key "steps" is missing."""
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        page = window.sequence
        until(page.first.isVisible)  # pages are built after the first picture
        assert not page.tabs.isVisible()
        assert on_page.wrongs_on(page) == []
        assert window.banner.text == ""
        click(page.first.buttons["Open a run"])
        until(lambda: window.runs.isVisible())


def test_the_example_is_two_presses_from_a_run(window):
    """Try it, then Run: at most four actions from the start to a fitted demo."""
    click(window.sequence.first.buttons["Try it"])
    until(lambda: "1.6 ml of ink" in window.sequence.plan_list.says)
    assert window.top.run.isEnabled() or window.sequence.document.plan is not None
    assert window.sequence.document.path is None, "saving must not write into the program's own folder"
    assert EXAMPLE.read_text() == window.sequence.document.text


def test_what_is_undone_or_begun_anew_offers_the_ways_to_begin_again(window):
    """After one step, added and undone, they never came back."""
    page = window.sequence
    window.show_page(page)
    opened(window, "a")
    page.append_separation()
    assert not page.first.isVisible()
    click(on_page.button(page, "New"))
    until(page.first.isVisible)
    window.banner.put_away()
    click(page.first.buttons["Build a sequence"])
    until(page.tabs.isVisible)
    window.run()
    assert "no steps yet" in window.banner.text
    page.append_separation()
    until(lambda: page.document.plan is not None)
    assert "no steps yet" not in window.banner.text, "what is no longer true goes by itself"
    click(on_page.button(page, "Undo"))
    until(page.first.isVisible)
    page.append_separation()
    click(on_page.button(page, "New"))
    until(page.first.isVisible)
    assert "had not been saved" in window.banner.text, "what was edited is offered back"
    window.banner.put_away()
    window.on_screen.leave()


def test_an_example_that_has_run_says_how_the_window_runs_it_again(window):
    """ "Start a new ledger" named nothing that the window has."""
    page = window.sequence
    window.show_page(page)
    page.try_example()
    page.document.set_tank(Delivered(1600.0, 1600.0, 1600.0))
    way = on_page.button(page, "To the Doser page")
    until(way.isVisible)
    assert "press “Filled with fresh water…” on the Doser page" in on_page.words_on(page)
    window.run()
    window.banner.press()
    until(window.doser.isVisible)
    window.show_page(page)
    until(way.isVisible)
    filled = on_page.button(window.doser, "Filled with fresh water")
    until(filled.isEnabled)  # the ledger is read in another thread, and nothing is focused that is not enabled
    click(way)
    until(lambda: window.focusWidget() is filled)
    page.document.set_tank(Delivered(0.0, 0.0, 0.0))
    assert not way.isVisibleTo(page)
    window.show_page(page)


def test_the_example_is_the_one_of_the_documentation():
    from pathlib import Path

    assert EXAMPLE.read_text() == (Path(__file__).parents[1] / "docs" / "examples" / "dilution.toml").read_text()


def test_another_rig_is_opened_by_its_file(window):
    """To an own rig in at most eight actions, without the command line."""
    other = window.home / "other"
    other.mkdir()
    file = write_rig(other)
    file.write_text(file.read_text().replace('name = "test rig"', 'name = "other rig"'))
    window.ask_for_rig()
    from PySide6.QtWidgets import QFileDialog

    (question,) = window.findChildren(QFileDialog)
    question.selectFile(str(file))
    question.accept()
    until(lambda: window.top.badge.text() == "other rig", 30.0)
    until(lambda: window.status.state.value == "ready", 30.0)
    assert any(frame.title.text() == "LIVE: other rig" for frame in window.findChildren(SourceFrame))
    window.use_rig(window.home / "rig.toml")
    until(lambda: window.top.badge.text() == "test rig" and window.status.state.value == "ready", 30.0)


def test_a_window_of_the_first_size_shows_what_a_page_is_for(window):
    """Run was below the edge of the first page, and the curves against dose below that of the Fit page."""
    window.resize(1280, 800)
    window.show_page(window.sequence)
    window.sequence.begin_anew()
    for page, name in ((window.sequence, ""), (window.fit, "a"), (window.runs, "a")):
        window.on_screen.leave() if not name else opened(window, name)
        window.show_page(page)
        until(lambda page=page: window.docks[page].widget().verticalScrollBar().maximum() == 0)
    until(lambda: on_page.rows_of(window.runs, "runs").horizontalScrollBar().maximum() == 0)


def opened(window, name: str):
    window.show_run(window.folder / f"run-{name}")
    shown = window.on_screen.shown
    until(lambda: shown.reading is not None)
    return shown


def test_a_result_says_what_it_is_of_and_with_which_confidence(window):
    """Cards showed one standard deviation and plots 95 %, unlabelled."""
    shown = opened(window, "a")
    result = result_of(shown)
    assert result.doses_ml == (0.1, 0.2, 0.3)
    assert "ink, from 0.1, 0.2, 0.3 ml" in window.fit.card.belongs.whole
    assert "Henyey–Greenstein" in window.fit.card.belongs.whole
    sd = shown.series.sd[1]
    by_name = {one.name: one for one in result.coefficients}
    assert by_name["sigma_s"].half == pytest.approx(1.96 * sd)
    assert "(95 %)" in window.fit.card.values["sigma_s"][2].text()
    titles = [title for title in on_page.titles(window.fit) if title.startswith(("σs", "σa", "g,"))]
    assert len(titles) == 3
    assert all("95 %" in title for title in titles)
    assert not {one.name: one for one in of_dose(shown, shown.by_dose[0]).coefficients}["sigma_a"].determined


def test_results_are_copied_as_text_and_as_a_table(window):
    """Numbers that are typed off the screen are typed wrong."""
    shown = opened(window, "a")
    window.fit.card.copy_asked.emit("text")
    text = QGuiApplication.clipboard().text()
    assert text.startswith("REPLAY of run-a\n")
    assert "95 %" in text
    window.fit.card.copy_asked.emit("table")
    head, *lines = QGuiApplication.clipboard().text().splitlines()
    assert len(lines) == 4  # three doses and the ink
    column = head.split("\t").index("σs (1/mm, of ink 1/mm/ml)")
    assert [float(line.split("\t")[column]) for line in lines[:3]] == pytest.approx(
        [fit.medium.sigma_s for fit in shown.by_dose]
    )
    assert len({line.count("\t") for line in (head, *lines)}) == 1


def test_two_runs_are_compared_side_by_side(window):
    """Each with its own numbers, whatever is on screen; at most six actions."""
    window.show_page(window.compare)
    a, b = (Source(Kind.REPLAY, window.folder / f"run-{name}") for name in "ab")
    window.compare.tick(a, b)
    results = on_page.rows_of(window.compare, "results of the runs that are ticked")
    until(lambda: results.rowCount() == 2)
    rows = {row[0]: row for row in on_page.cells(results)}
    assert rows.keys() == {"REPLAY of run-a", "REPLAY of run-b"}
    for source in (a, b):
        shown = window.compare.shown_of(source)
        assert shown.by_dose == [runs.dose_fit(source.run, number) for number in range(3 if source == a else 2)]
        number = result_of(shown).coefficients[0]
        assert number.text in rows[f"REPLAY of {source.run.name}"][2 + list(NAMES).index(number.name)]
    wanted = [[(0.1 * (dose + 1), runs.dose_fit(one.run, dose).medium.sigma_s) for dose in range(doses)]
              for one, doses in ((b, 2), (a, 3))]  # fmt: skip
    assert sorted(on_page.curves(window.compare, "σs"), key=len) == [pytest.approx(np.array(one)) for one in wanted]
    window.compare.tick()
    assert results.rowCount() == 0
    assert on_page.curves(window.compare, "σs") == []


def test_advice_is_appended_as_steps(window, monkeypatch):
    """The command line's advice had to be typed off a terminal."""
    asked = []
    monkeypatch.setattr(window.background, "run", lambda *words, **answer: asked.append((words, answer)))
    shown = opened(window, "a")
    window.show_page(window.compare)
    window.compare.tabs.setCurrentIndex(1)
    click(window.compare.next.ask)
    (answer,) = [answer for words, answer in asked if words[0] is jobs.advise]
    table = {"kind": "rays", "y_mm": [-40.0, 0.0, 40.0], "z_mm": [54.0, 66.0], "width_mm": 8.0}
    answer["then"]((jobs.Suggestion("dose to 1700 µl, then rays × 4", 1700.0, "beams", table, 4),))
    assert shown.advice
    (button,) = window.compare.next.buttons
    window.sequence.load(EXAMPLE)
    before = window.sequence.document.reading.sequence
    click(button)
    document = window.sequence.document
    after = sequence_text.read(document.text, document.folder).sequence
    assert len(after.tasks) == len(before.tasks) + 3
    assert [task.label for task in after.tasks[-3:]] == ["dose to 1700 µl", "wait until mixed", "capture beams × 4"]
    opened(window, "b")
    assert window.compare.next.buttons == [], "advice for another run"


def test_a_refit_stays_known_and_can_be_shown_again(window, monkeypatch):
    """Refits were lost as soon as another run was opened."""
    asked = []
    monkeypatch.setattr(window.background, "run", lambda *words, **answer: asked.append((words, answer)))
    opened(window, "a")
    source = window.on_screen.refit(window.folder / "run-a", RefitSettings(("rays",), free_background=True))
    (answer,) = [answer for words, answer in asked if words[0] is jobs.refit]
    fit = runs.dose_fit(window.folder / "run-a", 0, again=7)
    answer["then"](jobs.Found((fit,), None, ()))
    until(lambda: window.on_screen.source == source)
    window.runs.refits.chosen.emit(None)
    until(lambda: window.on_screen.source.kind is Kind.REPLAY and window.on_screen.shown.fits)
    assert "refit: rays; background fitted" in [
        window.runs.refits.list.itemText(row) for row in range(window.runs.refits.list.count())
    ]
    window.on_screen.show_refit(source)
    assert window.on_screen.shown.by_dose == [fit]
    assert not window.compare.next.ask.isEnabled(), "advice is by the fits that the run keeps"
    window.runs.refits.chosen.emit(None)
    until(lambda: window.on_screen.source.kind is Kind.REPLAY and window.on_screen.shown.fits)
    assert window.compare.next.ask.isEnabled()


def test_a_report_is_said_to_be_written_and_where_whether_or_not_a_browser_opens_it(window, monkeypatch):
    """The button looked dead where no browser is registered, and nothing was told anywhere."""
    asked = []
    monkeypatch.setattr(window.background, "run", lambda *words, **answer: asked.append((words, answer)))
    run = window.folder / "run-a"
    for opens in (True, False):
        monkeypatch.setattr("PySide6.QtGui.QDesktopServices.openUrl", lambda _, opens=opens: opens)
        window.runs.report(run)
        assert window.banner.text == "The report of run-a is being written."
        asked[-1][1]["then"](run / "report.html")
        assert str(run / "report.html") in window.banner.text
        assert ("No browser" in window.banner.text) is not opens
    assert f"is written: {run / 'report.html'}" in (window.folder / "window.log").read_text()
    window.runs.report(run)
    asked[-1][1]["failed"]("the disk is full")
    assert window.banner.text == "The report of run-a is not written: the disk is full"
    window.banner.put_away()


def nap(seconds: float) -> float:
    """In the background's process."""
    import time

    from ui.window import progress

    progress.done(0.5)
    time.sleep(seconds)
    return seconds


def die() -> None:
    """As the kernel ends a process; in the background's own."""
    os.kill(os.getpid(), signal.SIGKILL)


def test_work_in_the_background_is_seen_and_called_off(window):
    """Minutes without a sign look like a program that hangs."""
    found, refused = [], []
    window.background.run(nap, 60.0, then=found.append, failed=refused.append, name="a long nap")
    window.background.run(nap, 0.01, then=found.append, failed=refused.append, name="a short nap")
    from ui.window.work_strip import WorkStrip

    (strip,) = window.findChildren(WorkStrip)
    until(lambda: re.search(r"a long nap: in work 50 %.*\(and 1 more\)", on_page.words_on(strip)), SLOW_S)
    window.background.cancel(strip.tasks()[0])
    until(lambda: found == [0.01], SLOW_S)
    assert refused == ["cancelled"]
    until(lambda: on_page.words_on(strip) == "")


def test_a_background_process_that_dies_is_told_and_the_next_work_is_done(window):
    """Out of memory, the kernel ends what is largest; the window must not wait for it for ever."""
    found, refused = [], []
    window.background.run(die, then=found.append, failed=refused.append, name="what dies")
    until(lambda: refused, SLOW_S)
    assert "nothing that was recorded is lost" in refused[0]
    window.background.run(nap, 0.01, then=found.append, failed=refused.append, name="the next")
    until(lambda: found == [0.01], SLOW_S)


def test_the_resume_offer_stands_above_the_error_of_the_remembered_sequence(tmp_path):
    """After a crash the offer was covered by what was wrong with the sequence, and lost with it."""
    (tmp_path / "wrong.toml").write_text('name = "x"\n[[steps]]\ndo = "dance"\n')
    runs.recorded(tmp_path / "runs" / "run-cut", 1, ending="")
    rig = write_rig(tmp_path)
    from PySide6.QtCore import QSettings

    QSettings(str(tmp_path / "window.ini"), QSettings.Format.IniFormat).setValue(
        "sequence", str(tmp_path / "wrong.toml")
    )
    with window_on(tmp_path, rig) as made:
        until(lambda: made.status.state.value == "ready", 60.0)
        wait_ms(100)
        assert made.banner.action == "Resume it"
        assert "run-cut" in made.banner.text
        assert any("dance" in one.sentence for one in made.banner.history)


def test_any_action_is_found_by_its_name(window):
    """Keys that nobody remembers are no keys."""
    window.activateWindow()  # another window may have been opened and closed by a test before
    assert QTest.qWaitForWindowActive(window, 10_000)
    QTest.keyClick(window, Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    until(lambda: any(one.isVisible() for one in window.findChildren(Palette)))
    palette = on_page.palette_of(window)
    QTest.keyClicks(palette.field, "calibration page")
    assert palette.list.count() == 1
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    until(lambda: not window.docks[window.calibration].visibleRegion().isEmpty())


def test_what_is_dropped_is_opened_for_what_it_is(window):
    """A run's folder, a sequence and a rig file; the rest is told."""
    from PySide6.QtCore import QMimeData, QPoint, QUrl
    from PySide6.QtGui import QDropEvent

    def drop(path) -> None:
        data = QMimeData()
        data.setUrls([QUrl.fromLocalFile(str(path))])
        action, button = Qt.DropAction.CopyAction, Qt.MouseButton.LeftButton
        window.dropEvent(QDropEvent(QPoint(5, 5), action, data, button, Qt.KeyboardModifier.NoModifier))

    drop(window.folder / "run-b")
    until(lambda: window.on_screen.source.run == window.folder / "run-b")
    drop(EXAMPLE)
    assert window.sequence.document.path == EXAMPLE
    (window.home / "own.toml").write_text(EXAMPLE.read_text())
    drop(window.home / "own.toml")
    drop(window.home / "nothing.xyz")
    assert "nothing to open" in window.banner.text
    assert [path.name for path in window.recent.still_there()][:2] == ["own.toml", "run-b"]
    menu = on_page.button(window.sequence, "Recent").menu()
    assert [one.text().split()[0] for one in menu.actions()][:2] == ["own.toml", "run-b"]
    menu.actions()[1].trigger()
    until(lambda: window.on_screen.source.run == window.folder / "run-b")


SCENE = """
[tank]
size_mm = [240.0, 160.0, 120.0]
surface = "matched"
[medium]
sigma_a = 0.0002
sigma_s = 0.0198
g = 0.5
[projector]
kind = "collimated"
beams = [ { y_mm = [-8.0, 8.0], z_mm = [52.0, 68.0], irradiance = 1.0 } ]
[camera]
kind = "orthographic"
shape = [10, 15]
pixel_mm = 16.0
"""


def test_a_scene_is_predicted_and_again_when_a_number_is_changed(window):
    """What a coefficient does to the picture is seen by changing it."""
    import tankrig

    (window.home / "scene.toml").write_text(SCENE)
    window.open_path(window.home / "scene.toml")
    scene = window.scene
    until(lambda: scene.prediction is not None, 120.0)
    assert scene.prediction.image.shape == (10, 15)
    before = scene.prediction
    scene.tree_root.child("σs").setValue(0.005)
    until(lambda: scene.prediction is not before, 120.0)
    assert scene.prediction.image.sum() < 0.7 * before.image.sum()
    names: dict = {}
    exec(scene.python.rpartition("prediction =")[0], names)
    assert names["scene"].medium.sigma_s == 0.005
    assert names["scene"] == scene.scene
    assert isinstance(names["scene"], tankrig.Scene)
    scene.close()
    (window.home / "scene.toml").write_text(SCENE.replace("sigma_s", "sigma_x"))
    window.open_path(window.home / "scene.toml")
    assert "sigma_x" in window.banner.text


def test_every_button_of_every_page_is_found_by_its_name_and_pressed_by_keys(window):
    """Every action by keyboard alone: a button that only a mouse reaches is none for some people."""
    from PySide6.QtWidgets import QAbstractButton, QTabBar

    palette = on_page.palette_of(window)
    listed = [palette.list.item(row).text() for row in range(palette.list.count())]
    palette.close()
    missing = []
    for title, page in (("Camera", window.live), *window.docks.pages()):
        for button in page.findChildren(QAbstractButton):
            words = button.text().partition("  ")[0].strip().rstrip("…")
            own = words and not isinstance(button.parent(), QTabBar)
            if own and not any(one.startswith(f"{title}: {words}") for one in listed):
                missing.append((title, words))
    assert not missing
    assert len(listed) > 80
    for key in KEYS:
        assert any(key.what.casefold() in words.casefold() for words in listed), key.name
    palette = on_page.palette_of(window)
    QTest.keyClicks(palette.field, "fit: choose picture of")
    assert palette.list.count() == 1
    assert palette.list.item(0).text().startswith("Fit: choose picture of")
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    pictures = on_page.choice(window.fit, "picture of")
    until(lambda: pictures.view().isVisible() or not pictures.isEnabled())
    pictures.hidePopup()
    assert next(one for one in listed if one.startswith("Sequence: Dry run")).endswith("    F7")
    palette, same = on_page.palette_of(window), on_page.button(window.fit, "residual on the same scale")
    QTest.keyClicks(palette.field, "residual on the same scale")
    before = same.isChecked()
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert same.isChecked() is not before
    same.setChecked(before)


def test_frames_and_figures_are_saved_as_they_are(window):
    """A screenshot of colours has no counts; a figure in a report must be one that can be enlarged."""
    import cv2

    from ui.window.figure import save_figure, write_counts

    window.on_screen.leave()
    until(lambda: window.live.frame is not None)
    pixels = window.live.frame.pixels
    for name in ("frame.tif", "frame.png"):
        write_counts(window.home / name, pixels)
        again = cv2.imread(str(window.home / name), cv2.IMREAD_UNCHANGED)
        assert again.dtype == pixels.dtype
        assert (again == pixels).all()
    window.show_page(window.fit)
    title, page = window.docks.in_front()
    assert title == "Fit"
    save_figure(page, window.home / "fit.pdf")
    assert (window.home / "fit.pdf").read_bytes()[:5] == b"%PDF-"
    save_figure(page, window.home / "fit.png")
    picture = cv2.imread(str(window.home / "fit.png"))
    assert picture.shape[:2] == (2 * page.height(), 2 * page.width())
    window.saving.copy_figure()
    assert QGuiApplication.clipboard().pixmap().width() == 2 * page.width()


def test_what_is_on_screen_is_copied_as_python_that_works(window):
    """A figure that nobody can make again is an anecdote."""
    shown = opened(window, "a")
    window.saving.copy_as_python()
    names: dict = {}
    exec(QGuiApplication.clipboard().text(), names)
    assert [fit["dose_ml"] for fit in names["fits"] if fit["fit"] == "dose"] == [fit.dose_ml for fit in shown.by_dose]
    from ui.window.as_python import as_python

    refit = as_python(Source(Kind.REFIT, window.folder / "run-a", RefitSettings(("rays",), free_background=True)))
    compile(refit, "copied", "exec")
    assert 'offset="free"' in refit
