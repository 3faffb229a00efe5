"""What the window shows of runs that were recorded belongs to the run that its frame names: each mix-up that there was.

The runs are small and their numbers tell which run they are of (`tests/recorded_runs.py`).
"""

import shutil
from dataclasses import replace
from pathlib import Path
from time import sleep
from types import SimpleNamespace

import numpy as np
import pytest
from pyqtgraph import GraphicsView
from PySide6.QtCore import QEvent, QFile, QObject, Qt
from PySide6.QtWidgets import QApplication, QFileDialog, QSlider

from tankrig.devices import CameraSettings, Delivered
from tankrig.live.formatting import with_error
from tankrig.live.results import fits_in
from tankrig.run.notes import person_note
from tankrig.run.progress import Progress
from tankrig.run.reading import open_run
from tankrig.run.state import RunState
from tests import on_page
from tests import recorded_runs as runs
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window import jobs
from ui.window.frame_renderer import FrameRenderer, Picture
from ui.window.observed_devices import LatestValue, SeenFrame
from ui.window.replay import UNKNOWN, Replay
from ui.window.replay_bar import ReplayBar
from ui.window.runs_page import COLUMNS, PATH
from ui.window.shown import PhotographKey, Shown
from ui.window.source import Kind, RefitSettings, Source
from ui.window.source_frame import SourceFrame
from ui.window.status import RigState, RigStatus
from ui.window.tank_plot import TankPlot


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    """A window beside runs of 5, 3 and 2 doses, and one that was interrupted after 2 doses."""
    folder = tmp_path_factory.mktemp("belongs")
    for name, doses, ending in (("a", 5, "completed"), ("b", 3, "completed"), ("c", 2, "completed"), ("d", 2, "")):
        runs.recorded(folder / "runs" / f"run-{name}", doses, ending)
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.status.state.value == "ready", 60.0)
        yield made


@pytest.fixture
def window(opened):
    """The camera on screen, no filter, nothing to tell."""
    opened.on_screen.leave()
    runs_with(opened, "")
    while opened.banner.text:
        opened.banner.put_away()
    return opened


def runs_with(window, words: str) -> None:
    """List only runs with these words."""
    on_page.line(window.runs, "only runs with these words").setText(words)


def path_of(window, name: str) -> Path:
    return window.folder / f"run-{name}"


def show(window, name: str) -> Shown:
    window.show_run(path_of(window, name))
    shown = window.on_screen.shown
    until(lambda: shown.reading is not None)
    return shown


def card(window, name: str) -> str:
    _, value, note = window.fit.card.values[name]
    return f"{value.text()} {note.text()}"


def painted(window) -> None:
    """What waits for its turn to be painted has been."""
    on_page.painted(window.fit)


def agrees(window, run: Path) -> bool:
    """Whether card and curves say what the run's journal holds."""
    painted(window)
    doses, series = fits_in([event.fields for event in open_run(run).fits])
    ink = series.ink if series is not None else doses[-1].medium
    sd = series.sd if series is not None else doses[-1].sd
    number, half = with_error(ink.sigma_s, 1.96 * sd[1]).split(" ± ")
    curve = [(fit.dose_ml, fit.medium.sigma_s) for fit in doses]
    same = curve == on_page.dots(window.fit, "σs")
    return number in card(window, "sigma_s") and half in card(window, "sigma_s") and same


def test_a_refit_that_comes_after_another_run_was_opened_does_not_show_in_it(window, monkeypatch):
    """Fit anew of A, then open B: A's five doses stood beside B's fit in one plot."""
    asked = []
    monkeypatch.setattr(window.background, "run", lambda *words, **answer: asked.append((words, answer)))
    show(window, "a")
    window.runs.refits.ask()
    show(window, "b")
    (refit,) = [answer for words, answer in asked if words[0] is jobs.refit]
    doses = tuple(runs.dose_fit(path_of(window, "a"), number, again=1) for number in range(5))
    refit["then"](jobs.Found(doses, None, ()))
    until(lambda: "REFIT of run-a" in window.banner.text)
    assert window.on_screen.source == Source(Kind.REPLAY, path_of(window, "b"))
    assert agrees(window, path_of(window, "b"))
    window.banner.press()
    assert window.on_screen.source.kind is Kind.REFIT
    painted(window)
    assert [y for _, y in on_page.dots(window.fit, "g,")] == [0.5] * 5
    assert window.fit.card.belongs.whole.endswith("rays; dark frames subtracted")
    assert window.live_frame.title.text() == "REFIT of run-a with rays; dark frames subtracted"


def test_the_report_is_that_of_the_run_that_ended(window, monkeypatch):
    """ "Write its report" wrote the report of whatever row was selected."""
    from tankrig.run.runner import Outcome
    from tankrig.run.state import FinishReason

    asked = []
    monkeypatch.setattr(window.background, "run", lambda *words, **_: asked.append(words))
    window.ended(Outcome(FinishReason.COMPLETED, path_of(window, "c")))
    window.runs.catalogue.select(path_of(window, "a"))
    window.banner.press()
    assert asked == [(jobs.report, path_of(window, "c"))]


def test_an_export_is_of_the_run_that_was_asked_about(window, monkeypatch, tmp_path):
    """The dialog of A, answered when B was selected, saved B's frames as A.nc."""
    asked = []
    monkeypatch.setattr(window.background, "run", lambda *words, **_: asked.append(words))
    window.runs.catalogue.select(path_of(window, "a"))
    window.runs.export_selected("NetCDF")
    (question,) = window.runs.findChildren(QFileDialog)
    assert "run-a" in question.windowTitle()
    window.runs.catalogue.select(path_of(window, "b"))
    question.selectFile(str(tmp_path / "out.nc"))
    question.accept()
    until(lambda: asked)
    assert asked == [(jobs.export, path_of(window, "a"), tmp_path / "out.nc")]


def test_what_a_filter_hides_is_not_selected(window):
    """A hidden run stayed selected, and Open opened it."""
    before = window.on_screen.source
    window.runs.catalogue.select(path_of(window, "a"))
    runs_with(window, "run-b")
    assert window.runs.catalogue.selected is None
    for words in ("Open", "Report", "NetCDF", "TIFF", "Resume", "Delete"):
        assert not on_page.button(window.runs, words).isEnabled()
    window.runs.open_selected()
    assert window.on_screen.source == before
    runs_with(window, "")
    assert window.runs.catalogue.selected is None


def test_a_row_that_is_clicked_selects_that_run_whatever_is_listed(window):
    runs_with(window, "run-c")
    table = on_page.rows_of(window.runs, "runs")
    table.selectRow(0)
    runs_with(window, "")
    window.runs.refresh()
    assert window.runs.catalogue.selected.path == path_of(window, "c")
    assert table.selectedItems()[0].text() == "run-c"


def test_against_time_doses_stand_at_their_times(window):
    """All doses of a run that was opened again stood at .28 s."""
    show(window, "b")
    against = on_page.choice(window.fit, "what the curves stand against")
    against.setCurrentText("against time")
    painted(window)
    assert [at for at, _ in on_page.dots(window.fit, "g,")] == [60.0, 120.0, 180.0]
    against.setCurrentText("against dose")


def test_opening_a_run_leaves_nothing_of_the_one_before(window):
    """Cards, pictures and bars of the run before stayed until the new one's had come, or for good."""
    shown = show(window, "a")
    assert agrees(window, path_of(window, "a"))
    shown.photographs[PhotographKey("rays", 0.5)] = SimpleNamespace(offset=0.0)
    shown.choose(PhotographKey("rays", 0.5))
    image, medium = np.ones((20, 30)), shown.by_dose[-1].medium
    rmse = {"1": 0.3, "1–3": 0.2, "1–20": 0.1, "all": 0.05}
    bench = shown.reading.bench
    compared = jobs.Comparison("rays", 0.5, image, image, 0.1 * image, rmse, bench.tank, bench.camera)
    shown.take_comparison(PhotographKey("rays", 0.5), shown.by_dose[-1], compared)
    painted(window)
    drawn, left = on_page.pictures(window.fit), on_page.bar(window.fit, "all orders")
    assert list(drawn) == ["observed, 0–100 %", "model, same scale", "residual, ±10 %"]
    assert left.format() == "5 % left"
    window.show_run(path_of(window, "c"))  # nothing of it has been read yet
    assert window.fit.card.values["sigma_s"][1].text() == "–"
    assert on_page.pictures(window.fit) == {}
    assert left.format() == "–"
    assert on_page.dots(window.fit, "g,") == []
    assert window.sequence.run_list.lines() == []
    assert medium.sigma_s > 0.0


def test_after_resuming_earlier_doses_and_done_steps_are_there(window):
    """Earlier doses vanished from the curves, and done steps lost their ✓."""
    path = path_of(window, "d")
    reading = jobs.read(path)
    window.on_screen.begin(path, reading.labels, reading.run.journal)
    painted(window)
    assert [x for x, _ in on_page.dots(window.fit, "g,")] == [0.1, 0.2]
    assert [line[:1] for line in window.sequence.run_list.lines()[:3]] == ["✓", "✓", " "]
    for event in runs.add_dose(path, 2, "d" * 64):
        window.on_screen.take(path, event)
    assert agrees(window, path)
    window.on_screen.take(path_of(window, "a"), event)
    assert agrees(window, path), "a line of another run came through"


class Moved(QObject):
    """Plots whose size has changed."""

    def __init__(self) -> None:
        super().__init__()
        self.plots: list[object] = []

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:  # noqa: N802 - Qt's name
        if event.type() == QEvent.Type.Resize and isinstance(watched, GraphicsView):
            self.plots.append((type(watched.parent()).__name__, event.oldSize(), event.size()))
        return False


def test_nothing_moves_when_a_fit_comes_and_its_picture_is_computed(window, tmp_path):
    """A button that came and went made the status bar grow, and each fit laid the whole window out anew, for 60 ms."""
    path = runs.recorded(tmp_path / "run-e", 2, "")
    reading = jobs.read(path)
    window.on_screen.begin(path, reading.labels, reading.run.journal)
    window.show_page(window.fit)
    painted(window)
    wait_ms(300)
    moved = Moved()
    QApplication.instance().installEventFilter(moved)
    try:
        for number in (2, 3):
            for event in runs.add_dose(path, number, "d" * 64):
                window.on_screen.take(path, event)
            ended = []
            window.background.run(sleep, 0.3, then=ended.append, name="the model's picture of rays")
            until(lambda ended=ended: ended)
            painted(window)
            wait_ms(100)
    finally:
        QApplication.instance().removeEventFilter(moved)
    assert moved.plots == []


def test_the_exposure_shown_is_the_pictures_own(window, monkeypatch):
    """It showed 99 ms while a run took 20."""
    window.live.set_camera(CameraSettings(99.0), free=False)
    monkeypatch.setattr(window.live, "set_camera", lambda *_, **__: None)  # as at rest
    frame = SeenFrame(np.full((20, 30), 100, np.uint16), 4095, CameraSettings(20.0, 2.0), None)
    window.host.look_away(True)
    until(lambda: window.live.frame is not None)
    window.host.frames.put(frame)
    until(lambda: window.live.frame is frame)
    assert [on_page.field(window.live, name).value for name in ("exposure", "gain")] == [20.0, 2.0]
    window.host.look_away(False)


@pytest.mark.usefixtures("opened")
def test_levels_and_counts_beside_a_frame_are_its_own_however_soon_it_came_after_another():
    """A slider moved in a replay showed the frame that it ended at with the levels and counts of one passed by."""
    frames: LatestValue[SeenFrame] = LatestValue()
    renderer = FrameRenderer(frames, lambda: None)
    shown: list[Picture] = []

    def last() -> Picture | None:
        picture = renderer.pictures.take()
        if picture is not None:
            shown.append(picture)
        return shown[-1] if shown else None

    try:
        for level in (100, 3000):
            frame = SeenFrame(np.full((20, 30), level, np.uint16), 4095, CameraSettings(20.0, 2.0), None)
            frames.put(frame)
            until(lambda frame=frame: last() is not None and last().frame is frame)
        until(lambda: last().statistics is not None)
        assert last().frame is frame
        assert last().tone.high >= 3000.0
        wait_ms(500)
        assert len([one for one in shown if one.frame is frame]) <= 2, "once more, and no more"
    finally:
        renderer.close()


def test_a_frame_of_another_source_is_not_shown(window):
    """Between two sources a frame of the old one may still be on its way."""
    show(window, "a")
    assert window.live.frame is None
    late = SeenFrame(np.full((20, 30), 100, np.uint16), 4095, CameraSettings(20.0), None)
    window.host.frames.put(late)
    of_b = SeenFrame(late.pixels, 4095, CameraSettings(20.0), None, path_of(window, "b"))
    window.host.frames.put(of_b)
    own = SeenFrame(late.pixels, 4095, CameraSettings(20.0), None, path_of(window, "a"))
    from tests.window_rig import wait_ms

    wait_ms(100)
    assert window.live.frame is None
    window.host.frames.put(own)
    until(lambda: window.live.frame is own)
    window.on_screen.leave()
    assert window.live.frame is None, "a recorded picture stayed under the camera's title"
    until(lambda: window.live.frame is not None and window.live.frame.run is None)


def test_radiance_is_by_the_gain_of_the_source(window):
    """The pointer read radiances of one run by the gain of another."""
    a = show(window, "a")
    a.dark = 10.0
    b = show(window, "b")
    assert b.dark is None
    assert b.newest.gain != a.newest.gain


def test_a_refit_with_a_free_background_has_it_in_all_orders():
    """The bars of a refit left the background out that it had fitted, so that all orders looked wrong."""
    from tankrig.live.exposures import Photograph
    from tankrig.live.results import DoseFit
    from tankrig.pattern.kinds import Sheet, draw
    from tankrig.report.pictures import predicted
    from tankrig.scene import Medium
    from tests.memory_rig import BENCH

    pattern = draw(Sheet((-60.0, 60.0), (50.0, 70.0)), BENCH.wall)
    scene = BENCH.scene(pattern, Medium(1e-4, 0.004, 0.5))
    bare = Photograph("sheet", 0.1, 0.0, scene, np.zeros(scene.camera.shape), np.ones(scene.camera.shape), 0.0, 1)
    light = predicted(bare, DoseFit(0.1, Medium(1e-4, 0.004, 0.5))).image
    image = 100.0 * light + 0.3 * 100.0 * light.max()
    fit = DoseFit(0.1, Medium(1e-4, 0.004, 0.5), gain=100.0)
    free = Photograph("sheet", 0.1, 0.0, scene, image, np.ones_like(image), "free", 1)
    taken_out = Photograph("sheet", 0.1, 0.0, scene, image, np.ones_like(image), 0.0, 1)
    assert jobs.compare(free, fit).rmse["all"] < 1e-9
    assert jobs.compare(taken_out, fit).rmse["all"] > 0.1


def test_refits_hand_on_photographs_as_they_were_fitted(monkeypatch, tmp_path):
    from tankrig.live.exposures import Photograph
    from tankrig.pattern.kinds import Sheet, draw
    from tankrig.scene import Medium
    from tests.memory_rig import BENCH

    scene = BENCH.scene(draw(Sheet((-60.0, 60.0), (50.0, 70.0)), BENCH.wall), Medium(1e-4, 0.004, 0.5))
    zero = np.zeros(scene.camera.shape)
    one = Photograph("sheet", 0.1, 0.0, scene, zero, zero, 0.0, 1)
    monkeypatch.setattr("tankrig.run.reading.open_run", lambda _: None)
    monkeypatch.setattr("tankrig.live.exposures.exposures_of", lambda _: SimpleNamespace(photographs=lambda: [one]))
    monkeypatch.setattr("tankrig.live.fits.fit_dose", lambda here, _start, **_: here)
    found = jobs.refit(tmp_path, RefitSettings(("sheet",), free_background=True))
    assert [photograph.offset for photograph in found.photographs] == ["free"]


def test_what_was_told_goes_when_it_is_no_longer_true(window):
    """ "288 µl" stood over an empty tank, and "no picture" over a live one."""
    from dataclasses import replace

    from ui.window.status import RigState

    at_rest = window.status
    window.follow(replace(at_rest, trouble="the tank holds between 0 and 288 µl", troubles=at_rest.troubles + 1))
    assert "288" in window.banner.text
    window.follow(replace(at_rest, troubles=at_rest.troubles + 1))
    assert "288" not in window.banner.text
    assert any("288" in one.sentence for one in window.banner.history)
    window.follow(replace(at_rest, state=RigState.FAILED, trouble="gone", troubles=at_rest.troubles + 2))
    window.follow(replace(at_rest, troubles=at_rest.troubles + 2))
    assert "no picture" not in on_page.words_on(window.live)


def test_a_run_that_is_deleted_leaves_the_screen_at_once(window, monkeypatch):
    """Numbers of a run that is no more belong to nothing."""
    runs.recorded(path_of(window, "e"), 2)
    monkeypatch.setattr(QFile, "moveToTrash", lambda run: shutil.rmtree(run) is None)
    window.runs.refresh()
    show(window, "e")
    window.runs.catalogue.select(path_of(window, "e"))
    window.runs.delete_selected()
    assert path_of(window, "e").exists(), "it has to be asked twice"
    window.runs.delete_selected()
    assert window.on_screen.source.run != path_of(window, "e")
    assert window.runs.catalogue.find(path_of(window, "e")) is None
    assert window.live.frame is None or window.live.frame.run is None


def test_every_page_says_whose_it_is(window):
    """A person looks at one page; what it shows must not need another to be understood."""
    show(window, "a")
    titles = [frame.title.text() for frame in window.findChildren(SourceFrame)]
    # the picture, the fit, the waves, the regions, the replay, the steps of the run and what to photograph next
    assert titles.count("REPLAY of run-a") == 7
    assert titles.count("LIVE: test rig") == 3  # doser, projector and calibration stay the rig's own
    assert all(titles)
    assert window.sequence.run_frame.title.text() == "REPLAY of run-a"


def test_a_run_whose_folder_vanishes_is_told_and_what_was_read_stays(window, tmp_path):
    """A stick that is pulled out must not take what is on screen along, nor be met with silence."""
    path = runs.recorded(window.folder / "run-gone", 2)
    shown = show(window, "gone")
    moved = tmp_path / "kept"
    path.rename(moved)
    window.runs.refresh()
    until(lambda: "run-gone" in window.banner.text)
    assert window.on_screen.shown is shown
    painted(window)
    assert [x for x, _ in on_page.dots(window.fit, "g,")] == [0.1, 0.2]
    window.show_run(path)
    until(lambda: "does not exist" in window.banner.text)
    assert window.on_screen.source.run != path


def test_frames_are_found_by_pattern_dose_and_repeat(window):
    """A slider through hundreds of frames finds no repeat of one picture; each axis has one of its own."""
    jumped, bar = [], ReplayBar()
    replay = Replay(open_run(path_of(window, "a")), lambda _: None)
    replay.jump = jumped.append
    bar.set_replay(replay)
    assert replay.places(None, 0.3) == [2]
    assert replay.places("no such pattern", None) == []
    bar.dose.slider.setSliderPosition(2)
    bar.dose.slider.triggerAction(QSlider.SliderAction.SliderMove)
    assert bar.dose.value.text() == "0.3 ml"
    assert jumped[-1] == 2
    assert bar.repeat.value.text() == "1 of 1"
    replay.moved.emit(replay, 4, "frame 5 of 5")
    axes = (bar.frame, bar.pattern, bar.dose, bar.repeat)
    until(lambda: [axis.value.text() for axis in axes] == ["5 of 5", UNKNOWN, "0.5 ml", "1 of 1"])
    replay.close()


def test_runs_are_listed_with_what_they_hold_and_sorted_by_it(window):
    """Ten doses are more than nine, and the newest run is first."""
    table = on_page.rows_of(window.runs, "runs")
    doses = COLUMNS.index("doses")
    held = {table.item(row, 0).text(): table.item(row, doses).data(Qt.ItemDataRole.DisplayRole)
            for row in range(table.rowCount())}  # fmt: skip
    assert {name: held[name] for name in ("run-a", "run-b", "run-c")} == {
        "run-a": 5, "run-b": 3, "run-c": 2,
    }  # fmt: skip
    window.runs.catalogue.select(path_of(window, "b"))
    for order in (Qt.SortOrder.AscendingOrder, Qt.SortOrder.DescendingOrder):
        table.sortItems(doses, order)
        found = [table.item(row, doses).data(Qt.ItemDataRole.DisplayRole) for row in range(table.rowCount())]
        assert found == sorted(found, reverse=order is Qt.SortOrder.DescendingOrder)
        window.runs.refresh()
        assert window.runs.catalogue.selected.path == path_of(window, "b")
        assert {item.data(PATH) for item in table.selectedItems()} == {str(path_of(window, "b"))}
    window.runs.open_selected()
    assert window.on_screen.source.run == path_of(window, "b")


def test_a_note_is_kept_with_the_run_that_it_was_typed_for(window):
    """Bubbles on the wall are remembered for a week, and written on the wrong run."""
    note = on_page.line(window.runs, "note on the selected run")
    window.runs.catalogue.select(path_of(window, "c"))
    note.setText("bubbles on the wall")
    window.runs.catalogue.select(path_of(window, "b"))
    assert note.text() == ""
    window.runs.catalogue.select(path_of(window, "c"))
    note.setText("bubbles on the wall")
    note.editingFinished.emit()
    until(lambda: window.runs.catalogue.find(path_of(window, "c")).note == "bubbles on the wall")
    assert person_note(open_run(path_of(window, "c")).journal) == "bubbles on the wall"
    assert window.runs.catalogue.find(path_of(window, "c")).ending == "completed", "a note is no end of a run"
    assert window.runs.catalogue.find(path_of(window, "b")).note == ""
    runs_with(window, "bubbles")
    assert [one.path.name for one in window.runs.catalogue.visible] == ["run-c"]
    runs_with(window, "")
    window.runs.note(path_of(window, "c"), "")
    until(lambda: window.runs.catalogue.find(path_of(window, "c")).note == "")


def test_counts_along_a_line_are_those_of_its_pixels(window):
    """A profile that is off by a pixel, or upside down, is worse than none."""
    from ui.window.live_curves import along

    pixels = np.arange(600, dtype=np.uint16).reshape(20, 30)
    plot = TankPlot()
    plot.show_indices(pixels.astype(np.uint8), np.zeros((256, 3), np.uint8))
    plot.place(window.rig.bench.tank, window.rig.bench.camera)
    # rows: y from −80 to 80 mm, columns: x from 0 to 240 mm, pixels of 8 mm
    at, counts = along(pixels, plot, np.array([4.0, -76.0]), np.array([236.0, -76.0]))
    assert counts.tolist() == list(range(30))
    assert at[-1] == pytest.approx(232.0)
    _, counts = along(pixels, plot, np.array([4.0, -76.0]), np.array([4.0, 200.0]))
    assert counts.tolist()[0] == 0
    assert counts.max() == 570, "what lies beside the picture is left out"


def test_a_run_that_is_over_and_a_rig_that_cannot_be_used_are_not_framed_as_live(window):
    """Frames said "LIVE: the camera, and run …" for as long as the window was open, and above a picture of nothing."""
    path = runs.begin_run(window.folder / "run-over")
    window.on_screen.begin(path, ["x"], [runs.session(path)])
    live = "LIVE: the camera, and run run-over"
    title = window.live_frame.title
    assert title.text() == window.fit.parentWidget().title.text() == live
    window.on_screen.take(path, runs.add(path, "end", 9.0, reason="completed"))
    titles = [frame.title.text() for frame in window.findChildren(SourceFrame)]
    assert titles.count(f"{live}, which is over") == 7
    window.on_screen.take(path, runs.session(path, 20.0))
    assert title.text() == live, "it goes on"
    window.follow(RigStatus(RigState.FAILED, "no camera", 10_000))
    assert title.text() == "NO PICTURE: the rig cannot be used"
    assert window.live_frame.property("source") != "live"
    assert window.live.frame is None, "a picture that no longer moves"
    window.follow(RigStatus(RigState.IDLE))
    assert title.text() == live
    window.on_screen.forget(path)


def test_how_sharp_the_picture_is_stands_there_only_while_it_is_asked_for(window):
    focus = on_page.button(window.live, "focus")
    assert not focus.isChecked()
    until(lambda: window.live.frame is not None)
    assert "focus 0." not in on_page.words_on(window.live)
    focus.click()
    until(lambda: "focus 0." in on_page.words_on(window.live))
    focus.click()
    assert "focus 0." not in on_page.words_on(window.live)


def test_the_end_of_a_run_is_told_in_words_that_are_true():
    """ "About 0 s left" stood there for ten seconds, of fits that a run without ink does not have."""
    at_its_end = RigStatus(progress=Progress(5, 5, "all steps are done", "", 0.0), run_state=RunState.RUNNING)
    assert at_its_end.finishing
    assert "the last fits are being made" in at_its_end.words
    assert "nothing to fit" in replace(at_its_end, tank=Delivered(0.0, 0.0, 0.0)).words
    assert not replace(at_its_end, progress=Progress(4, 5, "x", "", 3.0)).finishing


@pytest.mark.usefixtures("window")
def test_focus_holds_its_peak():
    from ui.window.live_curves import FocusCurve

    curve = FocusCurve()
    for value in (0.1, 0.4, 0.2):
        curve.add(value)
    assert curve.best == 0.4
    curve.begin()
    assert curve.best == 0.0
