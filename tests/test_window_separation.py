"""Light sorted by waves, in the window: the step, its pictures live and in replay, and the command's numbers."""

import json

import numpy as np
import pyqtgraph as pg
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PySide6.QtCore import Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest

from tankrig.live.formatting import with_error
from tankrig.pattern.kinds import draw
from tankrig.pattern.wall import Wall
from tankrig.run.derived import read_derived
from tankrig.run.reading import open_run
from tankrig.scene import Camera, Tank
from tankrig.sequence import Capture, Repeat, Separate, Sequence
from tests import on_page
from tests import recorded_runs as runs
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.cli import main
from ui.window.forms import Form
from ui.window.result import Z
from ui.window.separated import Basis, SeparatedSheet, SheetKey
from ui.window.separation_page import cells_of, palette, toned
from ui.window.source import LIVE
from ui.window.steps_editor import separation_for
from ui.window.tank_sections import ROWS, nearest_rows

TANK, CAMERA = Tank((240.0, 160.0, 120.0)), Camera("orthographic", (8, 12), 20.0)
FIRST = (
    'name = "waves"\nexposure_ms = 5.0\n[[steps]]\ndo = "dose"\ntotal_ul = 300.0\n'
    '[[steps]]\ndo = "wait"\nseconds = 1.0\n[[steps]]\ndo = "wait"\nseconds = 0.1\n'
)


def sheet(dose_ml: float, height_mm: float, of: float = 1.0) -> SeparatedSheet:
    """A sheet whose numbers are those of no other."""
    own = of * (dose_ml + 0.001 * height_mm)
    image = np.full((8, 12), own, np.float32)
    return SeparatedSheet(
        SheetKey(dose_ml, height_mm), Basis(f"{own}", None), image, {8.0: 0.5 * image, 16.0: 0.6 * image},
        {8.0: 0.5 * image, 16.0: 0.4 * image}, 0.3 * image, np.full((80, 120), 0.3 * own, np.float32), TANK, CAMERA,
        {8.0: 0.5, 16.0: 0.6}, (0.3 * own, 0.01), (0.01 * own, 0.001), None, (),
    )  # fmt: skip


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    folder = tmp_path_factory.mktemp("waves")
    for name in "ab":
        runs.recorded(folder / "runs" / f"run-{name}", 1)
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.status.state.value == "ready", 60.0)
        made.home = folder
        made.show_page(made.separation)
        yield made


def test_without_waves_the_page_says_how_to_get_them(window):
    """A page of empty pictures tells nobody anything."""
    window.on_screen.leave()
    page = window.separation
    add = on_page.button(page, "Add the step")
    until(add.isVisible)
    assert not on_page.rows_of(page, "what each sheet tells").isVisible()
    assert "thin sheets" in on_page.words_on(page)
    QTest.mouseClick(add, Qt.MouseButton.LeftButton)
    until(window.sequence.steps.isVisible)
    (step,) = window.sequence.document.reading.table["steps"]
    assert step["do"] == "separate"
    assert window.sequence.document.plan is not None, "what is appended can be run on this rig"
    form = window.sequence.steps.findChild(Form)
    assert {"z_mm", "periods_mm", "shifts", "frames", "y_mm", "heights_mm", "exposure_ms", "gain"} == form.rows.keys()


@given(
    st.integers(24, 2000), st.integers(24, 2000), st.floats(20.0, 400.0), st.floats(20.0, 400.0), st.floats(-50.0, 50.0)
)
@settings(deadline=None, max_examples=60)
def test_the_step_that_is_offered_can_be_shown_by_any_projector(rows, columns, wide_mm, tall_mm, low_mm):
    """Waves finer than four of its pixels are refused, and a sheet thinner than a row lights nothing."""
    wall = Wall((rows, columns), (-0.5 * wide_mm, 0.5 * wide_mm), (low_mm, low_mm + tall_mm))
    step = Separate(**{name: value for name, value in separation_for(wall).items() if name != "do"})
    for wave in step.patterns.values():
        assert draw(wave, wall).pixels.any()


@given(
    st.lists(st.floats(10.0, 110.0).map(round), min_size=1, max_size=4, unique=True),
    st.lists(st.sampled_from([4.0, 8.0, 16.0]), min_size=1, max_size=3, unique=True),
    st.integers(1, 3), st.booleans(),
)  # fmt: skip
def test_a_sheet_ends_with_its_last_wave(heights_mm, periods_mm, times, between):
    """Separated earlier, waves are missing; later, a person waits for what is there."""
    step = Separate((58.0, 62.0), tuple(periods_mm), heights_mm=tuple(map(float, heights_mm)))
    inner = (step, Capture("dark")) if between else (step,)
    sequence = Sequence("waves", (Repeat(times, inner), Capture("full")))
    ends = sorted(sequence.sheet_ends)
    assert len(ends) == times * len(heights_mm)
    waves = [sequence.waves.get(getattr(task.action, "pattern", "")) for task in sequence.tasks]
    begin = 0
    for end in ends:
        here = [wave for wave in waves[begin : end + 1] if wave is not None]
        assert len({wave.z_mm for wave in here}) == 1
        assert len(here) == len(periods_mm) * step.shifts
        begin = end + 1
    assert not any(waves[begin:])


@given(st.lists(st.integers(1, 39).map(lambda number: 3 * number), min_size=1, max_size=6, unique=True))
def test_a_section_shows_each_sheet_where_it_is(heights_mm):
    """A band at another height would put ink where there is none."""
    heights = sorted(heights_mm)
    rows = nearest_rows(heights, 120.0, ROWS)
    z = (np.arange(ROWS) + 0.5) * 120.0 / ROWS
    for number, height in enumerate(heights):
        assert rows[np.abs(z - height).argmin()] == number
    shown = rows >= 0
    assert np.all(np.diff(rows[shown]) >= 0)


def test_a_slider_goes_through_the_heights_of_a_dose(window):
    """Sweeps in depth: all pictures are those of the height that the slider stands at, on one scale."""
    window.show_run(window.folder / "run-a")
    shown, page = window.on_screen.shown, window.separation
    window.show_page(page)
    shown.take_separated([sheet(0.1, 60.0), *(sheet(0.2, z) for z in (30.0, 60.0, 90.0))])
    peak = 0.2 + 0.09
    page.heights.slider.setFocus()
    for number, z in enumerate((30.0, 60.0, 90.0)):
        if number == 0:
            QTest.keyClick(page.heights.slider, Qt.Key.Key_Home)
        else:
            QTest.keyClick(page.heights.slider, Qt.Key.Key_Right)
        assert page.sheet.key == SheetKey(0.2, z)
        one = shown.separated[page.sheet.key]
        on_page.painted(page)
        drawn = on_page.pictures(page)
        for title, image in (
            ("whole sheet", one.sheet), ("follows 8 mm", one.modulated[8.0]), ("has forgotten it", one.even[8.0]),
            ("order 1", one.order_1),
        ):  # fmt: skip
            np.testing.assert_array_equal(drawn[title].image, toned(image, np.float32(peak)))
        side = drawn["from the side"]
        (here,) = (item for item in side.getViewBox().addedItems if isinstance(item, pg.InfiniteLine))
        assert here.value() == z
        bands = side.image[:, 60]
        for at, height in ((30, 30.0), (60, 60.0), (90, 90.0)):
            wanted = toned(np.array([0.3 * (0.2 + 0.001 * height)], np.float32), np.float32(peak))
            assert bands[at] == wanted[0]
        assert bands[0] == bands[-1] == 255, "no sheet was there"
        table = on_page.rows_of(page, "what each sheet tells")
        assert table.item(table.selectedItems()[0].row(), 1).text() == f"{z:g}"
    table.selectRow(0)
    assert page.sheet.key == SheetKey(0.1, 60.0)
    assert "from the side" not in on_page.pictures(page), "one height is no depth"
    assert palette()[255].tolist() != palette()[254].tolist()


def test_what_comes_late_belongs_to_the_run_that_it_is_of(window):
    """A sheet of run A under the title of run B would be a wrong result."""
    window.show_run(window.folder / "run-a")
    of_a = window.on_screen.shown
    of_a.take_separated([sheet(0.1, 60.0)])
    page = window.separation
    assert page.sheet is not None
    window.show_run(window.folder / "run-b")
    assert page.sheet is None
    assert on_page.rows_of(page, "what each sheet tells").rowCount() == 0
    assert on_page.pictures(page) == {}
    of_a.take_separated([sheet(0.1, 30.0)])
    assert page.sheet is None
    window.on_screen.shown.take_separated([sheet(0.5, 10.0)])
    assert page.sheet.key == SheetKey(0.5, 10.0)
    on_page.button(page, "Copy table").click()
    lines = [line.split("\t") for line in QGuiApplication.clipboard().text().splitlines()]
    assert len({len(line) for line in lines}) == 1
    assert dict(zip(*lines, strict=True))["z (mm)"] == "10"
    window.on_screen.leave()
    assert window.on_screen.source == LIVE
    assert page.sheet is None


def test_waves_are_no_patterns_to_fit(tmp_path):
    """A box for each of twelve waves, none of which can be fitted, hides the two that can."""
    from ui.window.jobs import read

    waves = '[[steps]]\ndo = "separate"\nz_mm = [56.0, 64.0]\nperiods_mm = [16, 32]\n'
    (tmp_path / "waves.toml").write_text(FIRST + waves + '[[steps]]\ndo = "capture"\npattern = "full"\n')
    rig = write_rig(tmp_path)
    words = ["run", str(tmp_path / "waves.toml"), "--rig", str(rig), "--out", str(tmp_path / "run"), "--no-fit"]
    assert main(words) == 0
    reading = read(tmp_path / "run")
    assert reading.separates
    assert reading.patterns == ("full",)


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_run_is_separated_while_it_goes_on_and_the_same_in_replay(tmp_path, capsys):
    """By the button, and to the numbers of `tankrig separate`."""
    (tmp_path / "waves.toml").write_text(FIRST)
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        until(lambda: window.status.state.value == "ready", 60.0)
        window.sequence.load(tmp_path / "waves.toml")
        window.sequence.steps.choose(("steps", 1))
        window.sequence.steps.separate.click()
        on_page.fill(window.sequence.steps.findChild(Form).rows["heights_mm"], "40 80")
        on_page.fill(window.sequence.steps.findChild(Form).rows["periods_mm"], "16 32")
        until(lambda: window.top.run.isEnabled(), 60.0)
        window.sequence.document.edit_text(window.sequence.document.text.replace("seconds = 0.1", "seconds = 600"))
        until(lambda: window.top.run.isEnabled(), 60.0)
        window.show_page(window.separation)
        ended = []
        window.host.run_ended.connect(ended.append)
        window.run()
        until(lambda: window.on_screen.source.run is not None, 60.0)
        window.show_page(window.separation)
        sheets = window.on_screen.shown.separated
        until(  # a sheet is shown with the waves that there are, and again with those that come after
            lambda: [len(one.modulated) for one in sheets.values()] == [2, 2], 200.0,
            "it was not separated while the run went on",
        )  # fmt: skip
        assert window.status.running
        path = window.on_screen.source.run
        live = dict(window.on_screen.shown.separated)
        window.stop()
        until(lambda: ended and not window.status.busy, 60.0)
        files = sorted(path.glob("derived/separation-*.npz"))
        assert len(files) == 2
        capsys.readouterr()
        assert main(["separate", str(path), "--json"]) == 0
        told = json.loads(capsys.readouterr().out)["sheets"]
        window.show_run(path)
        until(lambda: len(window.on_screen.shown.separated) == 2, 100.0)
        replayed = window.on_screen.shown.separated
        for row, (file, one) in enumerate(zip(files, told, strict=True)):
            arrays, about = read_derived(file)
            key = SheetKey(one["dose_ml"], 0.5 * sum(one["z_mm"]))
            assert about["frames"] == replayed[key].basis.frames == live[key].basis.frames
            np.testing.assert_array_equal(replayed[key].order_1, arrays["order_1"].astype(np.float32))
            np.testing.assert_array_equal(replayed[key].order_1, live[key].order_1)
            cells = on_page.cells(on_page.rows_of(window.separation, "what each sheet tells"))[row]
            assert cells == cells_of(replayed[key], sorted(replayed[key].follow))
            part, sd = 100.0 * one["order_1"], 100.0 * one["order_1_sd"]
            assert with_error(part, Z * sd) in cells
            assert all(f"{100.0 * share:.1f}" in cells for share in one["follow"].values())
        assert len(open_run(path).events("frame")) == 1 + 2 * 2 * 4
        wait_ms(50)
