"""Regions on the picture: counted where they lie, kept with the run, and never shown with another run."""

import weakref

import numpy as np
import pytest
import shiboken6
from pyqtgraph.parametertree import Parameter
from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtTest import QTest

import tankrig
from tankrig.devices import CameraSettings
from tankrig.pattern import Pattern
from tankrig.run.regions import Counted, Region, read_regions, write_regions
from tests import on_page
from tests import recorded_runs as runs
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.frame_renderer import ViewSettings, statistics_of
from ui.window.observed_devices import SeenFrame
from ui.window.palette import Palette
from ui.window.parameter_tree import parameter_tree

SHORT = (
    'name = "short"\nexposure_ms = 5\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n'
    '[[steps]]\ndo = "capture"\npattern = "dark"\nframes = 2\n'
)


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("regions")
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.status.state.value == "ready" and made.live.displayed, 60.0)
        made.home = folder
        yield made


@pytest.fixture
def window(opened):
    """The camera on screen, and no region."""
    opened.on_screen.leave()
    for one in list(opened.live.regions.drawn):
        opened.live.regions.remove(one)
    opened.show_page(opened.regions)
    until(lambda: opened.live.frame is not None)
    return opened


def row_of(window, name: str):
    """The numbers that stand under a name in the tree."""
    tree = on_page.rows_of(window.regions, "places of the regions, in mm on the water")
    (item,) = tree.findItems(name, Qt.MatchFlag.MatchExactly | Qt.MatchFlag.MatchRecursive)
    return item.param


def in_pixels(window):
    bench = window.rig.bench
    return window.live.regions.in_pixels(bench.camera, bench.tank)


def test_a_region_counts_the_pixels_that_it_lies_on(window):
    """A mean of other pixels than the ones under the rectangle would be believed."""
    seen = []
    window.live.counted.connect(seen.append)
    one = window.live.regions.add(QRectF(80.0, -40.0, 32.0, 24.0), "wall")
    assert in_pixels(window) == (Region("wall", (5, 8), (10, 14)),), "pixels are 8 mm wide"
    until(lambda: seen and seen[-1] and seen[-1][0].region.name == "wall")
    window.host.look_away(True)
    wait_ms(400)
    one.move(QRectF(80.0, -40.0, 32.0, 16.0))
    until(lambda: seen[-1][0].region.rows == (5, 7))
    part = window.live.frame.pixels[5:7, 10:14]
    assert (seen[-1][0].mean, seen[-1][0].sd) == pytest.approx((part.mean(), part.std()))
    window.host.look_away(False)
    window.live.counted.disconnect(seen.append)


def test_numbers_of_the_tree_move_the_region_and_follow_it(window):
    """Without a mouse a region is placed by typing; a dragged one says where it is."""
    one = window.live.regions.add(QRectF(80.0, -40.0, 32.0, 24.0), "wall")
    row = row_of(window, "wall")
    row.child("x").setValue(96.0)
    row.child("width").setValue(40.0)
    assert one.rect_mm == QRectF(96.0, -40.0, 40.0, 24.0)
    one.move(QRectF(16.0, -8.0, 24.0, 24.0))
    assert [row.child(side).value() for side in ("x", "y", "width", "height")] == [16.0, -8.0, 24.0, 24.0]
    other = window.live.regions.add()
    row_of(window, other.name).setName("wall")
    assert other.name != "wall", "two regions of one name could not be told apart in the file"
    row.setName("glass")
    assert [drawn.name for drawn in window.live.regions.drawn] == ["glass", other.name]
    assert [drawn.label.toPlainText() for drawn in window.live.regions.drawn] == ["glass", other.name]


@pytest.mark.usefixtures("qapp")
def test_nothing_of_a_tree_is_left_where_qt_makes_its_next_widget():
    root = Parameter.create(name="all", type="group", children=[{"name": "x", "type": "float", "value": 1.0}])
    tree = parameter_tree(root)
    kept = weakref.ref(tree.invisibleRootItem()._real_item)  # noqa: SLF001 - pyqtgraph's own, which has no other way to it
    assert kept() is not None
    shiboken6.delete(tree)
    assert kept() is None


def test_a_line_is_placed_by_its_numbers(window):
    window.live.profile.show(True)
    ends = row_of(window, "line (tick “line” beside the picture)")
    assert ends.opts["visible"]
    ends.child("from x").setValue(16.0)
    ends.child("to y").setValue(24.0)
    np.testing.assert_allclose(window.live.profile.ends_mm[[0, 1], [0, 1]], [16.0, 24.0])
    window.live.profile.show(False)


def test_regions_are_counted_in_a_whole_run_and_come_back_with_it(window):
    """What was measured beside a run is lost if it stays in a window."""
    window.live.regions.add(QRectF(80.0, -40.0, 32.0, 24.0), "wall")
    window.live.regions.add(QRectF(8.0, 0.0, 16.0, 16.0), "glass")
    (window.home / "short.toml").write_text(SHORT)
    window.sequence.load(window.home / "short.toml")
    until(lambda: window.top.run.isEnabled(), 60.0)
    ended = []
    window.host.run_ended.connect(ended.append)
    window.run()
    until(lambda: ended, 180.0)
    path = ended[0].path
    until(lambda: window.on_screen.shown.counted, 120.0, "regions that are drawn are counted when a run has ended")
    run = tankrig.open_run(path)
    assert [one.region.name for one in read_regions(path)] == ["wall", "glass"] * 4
    expected = run.frames.values[:, 5:8, 10:14].mean(axis=(1, 2))
    found = [one.mean for one in window.on_screen.shown.counted if one.region.name == "wall"]
    assert found == pytest.approx(expected)
    for one in list(window.live.regions.drawn):
        window.live.regions.remove(one)
    until(lambda: not window.status.busy, 60.0)
    window.show_run(path)
    until(lambda: window.on_screen.shown.counted, 30.0)
    assert [one.name for one in window.live.regions.drawn] == ["wall", "glass"]
    bench = window.on_screen.shown.reading.bench
    regions = window.live.regions.in_pixels(bench.camera, bench.tank)
    assert regions == (Region("wall", (5, 8), (10, 14)), Region("glass", (10, 12), (1, 3)))
    window.on_screen.leave()
    assert window.live.regions.drawn == [], "what was drawn before the run was opened is there again"
    window.live.regions.add(name="own")
    window.show_run(path)
    until(lambda: [one.name for one in window.live.regions.drawn] == ["wall", "glass"], 30.0)
    window.on_screen.leave()
    assert [one.name for one in window.live.regions.drawn] == ["own"]
    window.show_run(path)
    until(lambda: window.on_screen.shown.counted, 30.0)
    on_page.button(window.regions, "Copy table").click()
    assert len(QGuiApplication.clipboard().text().splitlines()) == 1 + 2 * 4


def test_what_was_counted_in_one_run_is_not_shown_in_another(window):
    """Curves of A under the title of B."""
    for name in "ab":
        runs.recorded(window.folder / f"run-{name}", 1)
    run = window.folder / "run-a"
    window.show_run(run)
    until(lambda: window.on_screen.shown.reading is not None)
    assert window.on_screen.shown.counted == ()
    region = Region("wall", (0, 2), (0, 2))
    write_regions(run, [Counted(region, 0, 1.0, "rays", 0.0, 8.0, 1.0, 7.0, 1.0, 5, 9)])
    window.show_run(window.folder / "run-b")
    window.show_run(run)
    until(lambda: window.on_screen.shown.counted)
    assert on_page.curves(window.regions, "") == [[(1.0, 7.0)]]
    window.show_run(window.folder / "run-b")
    assert window.on_screen.shown.counted == ()
    assert not any(on_page.curves(window.regions, ""))
    (run / "regions.csv").write_text("region,frame\nx,one\n")
    window.show_run(run)
    until(lambda: window.on_screen.shown.reading is not None)
    until(lambda: "save the regions again" in window.banner.text)
    assert window.on_screen.shown.fits, "a damaged list of regions keeps nobody from the run"


def test_any_region_can_be_added_and_taken_away_by_keyboard(window):
    """Every action by keyboard alone."""
    window.activateWindow()
    assert QTest.qWaitForWindowActive(window, 10_000)
    QTest.keyClick(window, Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    until(lambda: any(one.isVisible() for one in window.findChildren(Palette)))
    field = on_page.palette_of(window).field
    QTest.keyClicks(field, "add region")
    QTest.keyClick(field, Qt.Key.Key_Return)
    until(lambda: len(window.live.regions.drawn) == 1)
    assert on_page.button(window.regions, "Remove region").isEnabled()
    field = on_page.palette_of(window).field
    QTest.keyClicks(field, "remove region")
    QTest.keyClick(field, Qt.Key.Key_Return)
    until(lambda: not window.live.regions.drawn)
    assert not on_page.button(window.regions, "Remove region").isEnabled(), "it would do nothing"


def outlines_of(bench, pattern) -> np.ndarray:
    """Of the beams in a frame that a pattern lights."""
    frame = SeenFrame(np.zeros((8, 8), np.uint16), 4095, CameraSettings(20.0), pattern)
    return statistics_of(frame, ViewSettings(bench=bench), focus=False).outlines


@pytest.mark.usefixtures("opened")
def test_outlines_lie_on_the_light_in_a_calibrated_cameras_picture():
    """They lay beside it by a fifth of the tank: told in the picture's own millimetres, drawn in the water's."""
    import cv2

    from tankrig.light.single import single_scattering
    from tankrig.scene import Medium
    from tests.bent_scenes import small
    from ui.window.tank_plot import TankPlot
    from ui.window.tone import Tone

    scene = small(Medium(0.0, 1e-4, 0.0))
    light = single_scattering(scene)
    plot, mask = TankPlot(), np.zeros(light.shape, np.uint8)
    plot.show_indices(mask, Tone().palette())
    plot.place(scene.tank, scene.camera)
    lines = outlines_of(type("Bench", (), {"scene": lambda *_: scene})(), Pattern("lit", np.ones((2, 2), np.uint8)))
    assert np.isnan(lines[5::6]).all()
    for outline in np.split(lines, len(lines) // 6):
        corners = [plot.pixel_at(x, y)[::-1] for x, y in outline[:4].tolist()]
        cv2.fillConvexPoly(mask, np.round(np.array(corners) - 0.5).astype(np.int32), 1)
    near = cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0
    assert light[near].sum() > 0.9 * light.sum()
    assert near.mean() < 0.6


@pytest.mark.usefixtures("opened")
def test_a_wave_is_outlined_as_the_sheet_that_it_lies_in_and_not_by_its_columns():
    """A hundred lines over a picture hide the light that they should lie around."""
    from tankrig.bench import Bench
    from tankrig.pattern import Wave, draw
    from tankrig.pattern.wall import Wall
    from tankrig.scene import Camera, Tank

    wall = Wall((120, 160), (-40.0, 40.0), (0.0, 120.0))
    bench = Bench(Tank((160.0, 80.0, 120.0)), wall, "collimated", Camera("orthographic", (40, 80), 2.0))
    lines = outlines_of(bench, draw(Wave(16.0, (58.0, 62.0), 0.5, (-40.0, 40.0)), wall, "wave"))
    outlines = np.split(lines, len(lines) // 6)
    assert len(outlines) == 1, "none of its columns is quite dark"
    assert np.nanmin(lines[:, 1]) < -39.0
    assert np.nanmax(lines[:, 1]) > 39.0
