"""The window as a person finds it: it opens, tells which rig, obeys its keys, and remembers its looks."""

import logging
import subprocess
import sys
from pathlib import Path

import pytest

from tests.window_rig import LONG_DOSE, open_window, until, write_rig

from PySide6.QtCore import Qt  # noqa: E402, I001 - after the platform was chosen
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication


@pytest.fixture
def window(tmp_path, qapp):
    """On the small rig, with its first picture shown."""
    made = open_window(tmp_path, write_rig(tmp_path))
    until(lambda: made.live.displayed and made.status.tank is not None)
    yield made
    made.close()
    until(lambda: not made.isVisible())


def test_it_opens_on_the_simulated_rig_and_says_so(tmp_path, qapp):
    """Somebody who takes a simulation for the bench draws wrong conclusions."""
    made = open_window(tmp_path, None)
    until(lambda: made.live.displayed)
    assert "SIMULATED" in made.top.badge.text()
    assert made.top.stop.isVisible()
    made.close()


def test_a_real_rig_is_named(window):
    """The badge is how a person knows which rig STOP stops."""
    assert window.top.badge.text() == "test rig"


def test_stop_works_from_a_text_field_while_ink_flows(window):
    """A STOP that needs the mouse first, or loses against the field that is typed in, floods the tank."""
    window.show_page(window.doser)
    target = window.doser._target.edit
    until(lambda: window.doser._dose.isEnabled())
    target.setFocus()
    QTest.keyClicks(target, "900")
    QTest.keyClick(target, Qt.Key.Key_Return)
    until(lambda: window.status.target_ul == 900.0 and window.status.tank.volume_ul > 20.0)
    QTest.keyClick(target, Qt.Key.Key_F12)
    until(lambda: window.status.stopped and window.status.target_ul is None)
    held = window.status.tank.volume_ul
    assert 20.0 < held < 600.0
    assert not window.doser._dose.isEnabled()
    assert "stopped" in window._words.text()
    QTest.qWait(300)
    assert window.status.tank.volume_ul == held
    window.host.clear_stop()
    until(lambda: not window.status.stopped)
    assert window.doser._dose.isEnabled()


def test_a_dose_beyond_the_budget_is_refused_in_words(window):
    """The guard's sentence has to reach the person."""
    until(lambda: window.doser._dose.isEnabled())
    window.host.dose_to(1500.0)
    until(lambda: "one dose may have 1000 µl at most" in window.banner.text)
    assert window.status.tank.volume_ul == 0.0


def test_f1_lists_the_keys_without_blocking(window):
    """A dialog that blocks would keep STOP away."""
    QTest.keyClick(window, Qt.Key.Key_F1)
    until(lambda: hasattr(window, "_card") and window._card.isVisible())
    assert not window._card.isModal()
    window._card.close()


def test_theme_and_docks_are_remembered(tmp_path, qapp):
    """What a person arranged must be there the next day."""
    rig = write_rig(tmp_path)
    first = open_window(tmp_path, rig)
    until(lambda: first.live.displayed)
    QTest.keyClick(first, Qt.Key.Key_T, Qt.KeyboardModifier.ControlModifier)
    assert QApplication.instance().property("theme") == "light"
    first.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, first.docks[first.log])
    first.close()
    second = open_window(tmp_path, rig)
    assert second.dockWidgetArea(second.docks[second.log]) == Qt.DockWidgetArea.LeftDockWidgetArea
    assert QApplication.instance().property("theme") == "light"
    second.close()


def test_the_log_is_sifted(window):
    """Among thousands of lines a person looks for one."""
    logging.getLogger("tankrig.x").info("the syringe is empty")
    logging.getLogger("tankrig.x").warning("a frame was lost")
    until(lambda: any("a frame was lost" in line for line in window.log.lines()))
    window.log._filter.setText("syringe")
    assert [line[10:] for line in window.log.lines()] == ["the syringe is empty"]
    window.log._filter.clear()
    window.log._level.setCurrentText("warnings and errors")
    assert not any("syringe" in line for line in window.log.lines())
    assert any("a frame was lost" in line for line in window.log.lines())


def test_a_wrong_rig_file_opens_with_its_line_marked_and_the_rest_usable(tmp_path, qapp):
    """Mending a rig file by trial and error costs an afternoon."""
    rig = write_rig(tmp_path)
    rig.write_text(rig.read_text().replace("tank_ul = 4000.0", 'tank_ul = "much"'))
    made = open_window(tmp_path, rig)
    until(lambda: made.calibration._text.marked)
    line = rig.read_text().splitlines()[made.calibration._text.marked - 1]
    assert line == 'tank_ul = "much"'
    assert "limits.tank_ul" in made.banner.text
    (tmp_path / "long.toml").write_text(LONG_DOSE)
    made.sequence.load(tmp_path / "long.toml")
    assert made.sequence.document.reading.sequence is not None
    text = made.calibration._text
    text.setPlainText(text.toPlainText().replace('"much"', "4000.0"))
    made.calibration._save()
    until(lambda: made.live.displayed)
    assert made.calibration._text.marked == 0
    made.close()


def test_levels_saturation_and_read_out_follow_the_picture(window):
    """The picture is what exposure is set by."""
    window.host.show(_full(window))
    window.host.dose_to(500.0)
    until(lambda: window.status.target_ul is None and window.status.tank.volume_ul == 500.0)
    until(lambda: window.live.frame.pixels.max() > 1000, what="no light was seen")
    until(lambda: window.live._tone.high > 500)
    from PySide6.QtCore import QPointF

    window.live._read(QPointF(20.0, 0.0))
    assert "counts" in window.live._read_out.text()
    assert "radiance after the first fit" in window.live._read_out.text()
    window.live._exposure.set_value(2000.0)
    window.live._ask_camera()
    until(lambda: window.live.frame.settings.exposure_ms == 2000.0 and "saturated" in window.live._saturated.text())
    until(lambda: window.live._saturated.text().startswith("saturated"), what="full wells were not told of")


def _full(window):
    import numpy as np

    from tankrig.pattern import Pattern

    shape = window.host._description.bench.wall.shape
    return Pattern("full", np.full(shape, 255, np.uint8))


def test_signals_with_booleans_do_not_bring_the_program_down():
    """PySide6 6.12.0 on Python 3.11 lost a reference to True with each emitted signal and aborted after some 570."""
    program = (
        "from PySide6.QtCore import QObject, Signal\n"
        "class Bell(QObject):\n    rung = Signal(bool)\n"
        "bell = Bell()\n"
        "heard = []\n"
        "bell.rung.connect(heard.append)\n"
        "for _ in range(20000): bell.rung.emit(True)\n"
        "print(len(heard))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "20000")


def test_runs_folder_named_in_the_empty_list(tmp_path, window):
    """An empty page that says nothing looks broken."""
    assert str(Path(tmp_path) / "runs") in window.runs._empty.text()
