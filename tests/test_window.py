"""The window as a person finds it: pictures, doses and keys."""

import logging
import re

import pyqtgraph as pg
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest

from tests import on_page
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.keys import KeyCard


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    """On the small rig, with its first picture shown; its tests leave ink, and no stop, behind."""
    folder = tmp_path_factory.mktemp("window")
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.live.displayed and made.status.state.value == "ready")
        yield made


def test_a_real_rig_is_named(window):
    """The badge is how a person knows which rig STOP stops."""
    assert window.top.badge.text() == "test rig"


def test_stop_works_from_a_text_field_while_ink_flows(window):
    """A STOP that needs the mouse first, or loses against the field that is typed in, floods the tank."""
    window.show_page(window.doser)
    target, dose = on_page.field(window.doser, "Dose until the tank holds").edit, on_page.button(window.doser, "Dose")
    until(dose.isEnabled)
    target.setFocus()
    before = window.status.tank.volume_ul
    aim = round(before) + 900.0
    QTest.keyClicks(target, f"{aim:g}")
    QTest.keyClick(target, Qt.Key.Key_Return)
    until(lambda: window.status.target_ul == aim and window.status.tank.volume_ul > before + 20.0)
    QTest.keyClick(target, Qt.Key.Key_F12)
    until(lambda: window.status.stopped and window.status.target_ul is None)
    held = window.status.tank.volume_ul
    assert before + 20.0 < held < aim - 200.0
    assert not dose.isEnabled()
    assert "the doser is stopped" in on_page.words_on(window.statusBar())
    wait_ms(300)
    assert window.status.tank.volume_ul == held
    window.host.clear_stop()
    until(lambda: not window.status.stopped)
    assert dose.isEnabled()


def test_a_dose_beyond_the_budget_is_refused_in_words(window):
    """The guard's sentence has to reach the person."""
    until(on_page.button(window.doser, "Dose").isEnabled)
    held = window.status.tank.volume_ul
    window.host.dose_to(held + 1500.0)
    until(lambda: "one dose may have 1000 µl at most" in window.banner.text)
    assert window.status.tank.volume_ul == held


def test_f1_lists_the_keys_without_blocking(window):
    """A dialog that blocks would keep STOP away."""
    QTest.keyClick(window, Qt.Key.Key_F1)
    until(lambda: any(one.isVisible() for one in window.findChildren(KeyCard)))
    (card,) = window.findChildren(KeyCard)
    assert not card.isModal()
    assert "F12" in on_page.words_on(card)
    card.close()


def test_the_log_is_sifted(window):
    """Among thousands of lines a person looks for one."""
    logging.getLogger("tankrig.x").info("the syringe is empty")
    logging.getLogger("tankrig.x").warning("a frame was lost")
    until(lambda: any("a frame was lost" in line for line in window.log.lines()))
    sought = on_page.line(window.log, "only lines with these words")
    sought.setText("syringe")
    assert [line[10:] for line in window.log.lines()] == ["the syringe is empty"]
    sought.clear()
    on_page.choice(window.log, "how grave a line must be").setCurrentText("warnings and errors")
    assert not any("syringe" in line for line in window.log.lines())
    assert any("a frame was lost" in line for line in window.log.lines())


def test_levels_saturation_and_read_out_follow_the_picture(window):
    """The picture is what exposure is set by."""
    window.host.show(_full(window))
    until(on_page.button(window.doser, "Dose").isEnabled)
    window.host.dose_to(800.0)
    until(lambda: window.status.target_ul is None and window.status.tank.volume_ul == 800.0)
    until(lambda: window.live.frame.pixels.max() > 1000, what="no light was seen")
    (ends,) = (item for plot in window.live.findChildren(pg.PlotWidget) for item in plot.getPlotItem().items
               if isinstance(item, pg.LinearRegionItem))  # fmt: skip
    until(lambda: ends.getRegion()[1] > 500)
    on_page.point_at(window.live, 20.0, 4.0)
    until(lambda: _is_read(window, r"x (19|20)\.. mm, y [34]\.. mm", (10, 2)), what="pixels are 8 mm wide")
    exposure = on_page.field(window.live, "exposure")
    on_page.fill(exposure, "2000")
    QTest.keyClick(exposure.edit, Qt.Key.Key_Return)
    until(lambda: window.live.frame.settings.exposure_ms == 2000.0)
    until(lambda: _full_wells_are_told(window), what="full wells were not told of")


def _full_wells_are_told(window) -> bool:
    full = float((window.live.frame.pixels >= window.live.frame.saturation).mean())
    return full > 0.1 and f"\nsaturated {full:.2%}" in on_page.words_on(window.live)


def _is_read(window, place: str, pixel: tuple[int, int]) -> bool:
    counts = window.live.frame.pixels[pixel]
    return bool(re.search(f"{place}: {counts} counts, radiance after the first fit", on_page.words_on(window.live)))


def _full(window):
    import numpy as np

    from tankrig.pattern import Pattern

    return Pattern("full", np.full(window.rig.bench.wall.shape, 255, np.uint8))


def test_an_empty_list_of_runs_says_so(window):
    """An empty page that says nothing looks broken."""
    words = f"No runs in {window.runs.catalogue.folder} yet. Run a sequence, and when it has ended it will be here."
    assert words in on_page.words_on(window.runs)


@pytest.mark.usefixtures("window")
def test_what_waits_to_be_painted_goes_with_its_page():
    """A window closed just after a fit would end in a traceback: its plots are gone when their turn comes."""
    from tankrig.live.results import DoseFit
    from tankrig.scene import Medium
    from ui.window.fit_curves import FitCurves

    curves = FitCurves()
    fit = DoseFit(1.0, Medium(1e-4, 0.01, 0.7), (1e-5, 1e-4, 0.01))
    curves.show_fits([(1.0, fit)], "dose_ml", None)
    curves.deleteLater()
    wait_ms(200)
