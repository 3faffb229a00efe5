"""The window for a person with wet hands: keys that stop, fields that say what is wrong, and what the pump does."""

import re
import time

import pytest
from PySide6.QtCore import QEvent, QPoint, QRect, QSettings, QSize, Qt
from PySide6.QtGui import QCloseEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QFileDialog,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)

from drivers.emulation.truth import read_truth
from tests import on_page
from tests.window_rig import LONG_DOSE, until, wait_ms, window_on, write_rig
from ui.window.docks import PART
from ui.window.forms import Form


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wet")
    with window_on(folder, write_rig(folder)) as made:
        until(lambda: made.status.state.value == "ready" and made.live.displayed, 60.0)
        made.home = folder
        yield made


@pytest.fixture
def window(opened):
    """At rest, with no stop latched and nothing to tell."""
    opened.host.clear_stop()
    until(lambda: not opened.status.stopped and not opened.status.busy)
    while opened.banner.text:
        opened.banner.put_away()
    opened.activateWindow()
    return opened


def dosing(window) -> float:
    """Ink flows; how much the tank held before."""
    held = window.status.tank.volume_ul
    window.dose_to(held + 600.0)
    until(lambda: window.status.target_ul is not None and window.status.tank.volume_ul > held + 5.0)
    return held


def stopped(window, held: float) -> bool:
    until(lambda: window.status.stopped and window.status.target_ul is None)
    return window.status.tank.volume_ul < held + 500.0


@pytest.mark.parametrize("key", [Qt.Key.Key_F12, Qt.Key.Key_Escape])
@pytest.mark.parametrize("place", ["field", "text", "dialog"])
def test_both_keys_stop_wherever_the_keyboard_is(window, key, place):
    """Whoever types when the tube slips off presses the nearest key."""
    held = dosing(window)
    question = None
    if place == "field":
        window.show_page(window.doser)
        target: QWidget = on_page.field(window.doser, "Dose until the tank holds").edit
    elif place == "text":
        window.show_page(window.sequence)
        window.sequence.tabs.setCurrentWidget(window.sequence.text)
        target = window.sequence.text
    else:
        window.sequence.open_file()
        (question,) = window.sequence.findChildren(QFileDialog)
        target = question
    target.setFocus()
    QTest.keyClick(target, key)
    assert stopped(window, held)
    if question is not None:
        question.close()
        question.deleteLater()
        wait_ms(10)


def test_esc_stops_nothing_that_does_not_move_and_closes_a_dialog_then(window):
    """A latched stop that nobody asked for costs the next dose."""
    window.sequence.open_file()
    (question,) = window.sequence.findChildren(QFileDialog)
    QTest.keyClick(question, Qt.Key.Key_Escape)
    until(lambda: not window.sequence.findChildren(QFileDialog))
    QTest.keyClick(window, Qt.Key.Key_Escape)
    wait_ms(300)
    assert not window.status.stopped
    assert "STOP" not in window.banner.text


def test_ctrl_q_asks_while_ink_flows_and_a_signal_does_not(window):
    """One slip of a finger must not end an experiment of a day."""
    held = dosing(window)
    QTest.keyClick(window, Qt.Key.Key_Q, Qt.KeyboardModifier.ControlModifier)
    until(lambda: hasattr(window, "question") and window.question.isVisible())
    assert not window.question.isModal()
    assert window.isVisible()
    assert window.status.target_ul is not None
    QTest.keyClick(window.question, Qt.Key.Key_Escape)
    assert stopped(window, held), "STOP comes before the question"
    window.question.close()
    wait_ms(10)


def test_the_windows_own_cross_asks_too(window):
    held = dosing(window)
    event = QCloseEvent()
    spontaneous = type("FromTheDesktop", (QCloseEvent,), {"spontaneous": lambda _: True})()
    window.closeEvent(spontaneous)
    assert not spontaneous.isAccepted()
    assert "closes when" not in window.banner.text
    assert window.status.target_ul is not None
    assert window.question.isVisible()
    window.question.close()
    window.stop()
    assert stopped(window, held)
    assert event.isAccepted()


def test_the_keyboards_place_is_seen_wherever_tab_leads(window):
    """Eight Tabs from the live view showed none."""
    window.live.setFocus()
    seen = set()
    for _ in range(40):
        QTest.keyClick(QApplication.focusWidget() or window, Qt.Key.Key_Tab)
        wait_ms(5)
        now = QApplication.focusWidget()
        assert now is not None
        assert window.ring.around is now
        assert window.ring.isVisible(), f"no ring around {now}"
        seen.add(now)
    assert len(seen) > 8
    assert sum(isinstance(one, QCheckBox) for one in seen) > 2


def test_highlighted_entries_of_lists_can_be_read(window):
    """White on white."""
    for name in ("dark", "light"):
        window.set_theme(name)
        box: QComboBox = on_page.choice(window.live, "false colour")
        box.showPopup()
        wait_ms(30)
        view = box.view()
        view.setCurrentIndex(box.model().index(0, 0))
        wait_ms(10)
        rect = view.visualRect(box.model().index(0, 0))
        picture = view.viewport().grab(rect).toImage()
        picture.save(str(window.home / "list.png"))
        assert best_contrast(picture) > 4.5, name
        box.hidePopup()
    window.set_theme("dark")


def best_contrast(picture) -> float:
    """Between the most frequent colour and the one that is furthest from it."""
    from collections import Counter

    colours = Counter(picture.pixel(x, y) for x in range(picture.width()) for y in range(picture.height()))
    ground = colours.most_common(1)[0][0]
    return max(contrast(ground, one) for one in colours)


def contrast(one: int, other: int) -> float:
    """As WCAG 2.2 has it, of two colours 0xRRGGBB."""

    def luminance(colour: int) -> float:
        parts = [(colour >> shift & 0xFF) / 255.0 for shift in (16, 8, 0)]
        red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_a_ticked_box_has_a_tick(window):
    """A blue square may be on or off."""
    for name in ("dark", "light"):
        window.set_theme(name)
        box = on_page.button(window.live, "auto levels")
        box.setChecked(True)
        wait_ms(20)
        picture = box.grab().copy(3, (box.height() - 14) // 2, 14, 14).toImage()
        assert best_contrast(picture) > 4.5, name
    window.set_theme("dark")


@pytest.mark.parametrize(("field", "typed"), [("frames", "0"), ("until", "foo"), ("exposure_ms", "much")])
def test_a_wrong_field_blocks_the_run_and_says_why_beside_it(window, field, typed):
    """Frames 0 and until "foo" ran with the values from before."""
    (window.home / "one.toml").write_text('name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n')
    window.sequence.load(window.home / "one.toml")
    until(lambda: window.top.run.isEnabled())
    window.sequence.steps.choose(("steps", 0))
    form = window.sequence.steps.findChild(Form)
    row = form.rows[field]
    one = next(iter(row.fields.values())) if field == "until" else row
    on_page.fill(one, typed)
    assert window.sequence.document.plan is None
    assert not on_page.button(window.sequence, "Run").isEnabled()
    assert one.says.text()
    assert one.says.isVisibleTo(form)
    window.run()
    wait_ms(100)
    assert not window.status.busy
    assert one.wrong in window.banner.text
    on_page.fill(one, "3" if field == "frames" else "")
    assert window.sequence.document.plan is not None


def test_a_draft_is_on_disk_as_soon_as_it_was_typed(window):
    """A power cut an hour later must not cost the hour."""
    (window.home / "draft.toml").write_text(LONG_DOSE)
    window.sequence.load(window.home / "draft.toml")
    window.sequence.document.edit_text(LONG_DOSE.replace("900", "800"))
    assert "(edited)" in window.sequence.document.title
    on_disk = window.home / "window.ini"
    until(lambda: "800" in str(QSettings(str(on_disk), QSettings.Format.IniFormat).value("draft")))
    window.sequence.document.edit_text(LONG_DOSE)
    assert "(edited)" not in window.sequence.document.title, "it is what the file has again"


def test_a_long_exposure_counts_down_over_the_picture(window):
    """A picture that stands still for twelve seconds looks like a window that hangs."""
    window.live.camera_asked.emit(type(window.host.camera_settings)(2500.0, 1.0))
    until(lambda: re.search("exposing, [123] s left", on_page.words_on(window.live)), 30.0)
    window.live.camera_asked.emit(type(window.host.camera_settings)(20.0, 1.0))
    until(lambda: "exposing" not in on_page.words_on(window.live), 30.0)


def test_what_is_primed_is_not_in_the_tank(window):
    """Ink in the waste vessel that counts as in the tank makes every concentration wrong."""
    window.show_page(window.doser)
    page, held = window.doser, window.status.tank.volume_ul
    state = window.home / "rig" / "tank" / "state"
    steps = read_truth(state).steps
    on_page.fill(on_page.field(page, "Prime the tube with"), "40")
    until(on_page.button(page, "Dose").isEnabled)
    prime, hangs = on_page.button(page, "Prime"), on_page.button(page, "the tube hangs in a waste vessel")
    assert not prime.isEnabled(), "nobody has said where the tube hangs"
    hangs.setChecked(True)
    QTest.mouseClick(prime, Qt.MouseButton.LeftButton)
    until(lambda: window.status.aside_ul == 40.0)
    assert window.status.busy
    until(lambda: not window.status.busy)
    assert read_truth(state).steps == steps + 400
    assert window.status.tank.volume_ul == held
    assert not hangs.isChecked()
    window.host.dose_aside(5000.0)
    until(lambda: "one dose may have" in window.banner.text)


def test_pages_come_back_to_their_size(window):
    """After the window was small once, a page stayed a strip at the edge."""
    window.show_page(window.fit)
    for width in (1280, 1024, 1280):
        window.resize(width, 700)
        until(lambda width=width: abs(window.docks[window.fit].width() - PART * width) < 0.02 * width)


def test_an_errors_colour_follows_the_theme(window):
    """Red for the dark ground cannot be read on the light one."""
    (window.home / "wrong.toml").write_text('name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 0\n')
    window.sequence.load(window.home / "wrong.toml")
    from ui.window.theme import DARK, LIGHT

    for name, theme in (("light", LIGHT), ("dark", DARK)):
        window.set_theme(name)
        QApplication.sendPostedEvents(None, QEvent.Type.PaletteChange)
        wait_ms(10)
        (marked,) = window.sequence.steps.tree.findItems("⚠", Qt.MatchFlag.MatchContains | Qt.MatchFlag.MatchRecursive)
        assert marked.foreground(0).color().name() == theme.bad


def edge_contrast(widget, inside: QPoint) -> float:
    """Of a widget's outline, at the middle of its left side, against what lies beside it."""
    window = widget.window()
    picture = window.grab(QRect(widget.mapTo(window, QPoint(-3, widget.height() // 2 + inside.y())), QSize(12, 1)))
    row = [picture.toImage().pixel(x, 0) for x in range(picture.width())]
    return max(contrast(row[0], one) for one in row[1 : 6 + inside.x()])


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_text_and_outlines_stand_out(window, theme):
    """WCAG 2.2: text 4.5 to 1, outlines of what can be pressed or filled in 3 to 1; measured in the pixels drawn."""
    window.set_theme(theme)
    window.resize(1280, 800)
    (window.home / "seen.toml").write_text('name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n')
    window.sequence.load(window.home / "seen.toml")
    faint, thin, looked = [], [], 0
    window.live.regions.add()
    for page in (window.sequence, window.fit, window.doser, window.projector, window.runs, window.compare,
                 window.regions, window.calibration, window.log):  # fmt: skip
        window.show_page(page)
        wait_ms(60)
        for widget in window.findChildren(QWidget):
            if not widget.isVisible() or not widget.isEnabled() or widget.visibleRegion().isEmpty():
                continue
            if isinstance(widget, QLabel) and widget.text() and widget.width() > 8:
                looked += 1
                if (found := best_contrast(widget.grab().toImage())) < 4.5:
                    faint.append((page.__class__.__name__, widget.text()[:40], round(found, 2)))
            elif isinstance(widget, QPushButton) and widget.text():
                looked += 1
                if (found := best_contrast(widget.grab().toImage().copy(8, 4, widget.width() - 16, 30))) < 4.5:
                    faint.append((page.__class__.__name__, widget.text(), round(found, 2)))
            if isinstance(widget, QPushButton | QLineEdit | QComboBox | QCheckBox) and not widget.hasFocus():
                looked += 1
                if (found := edge_contrast(widget, QPoint(0, 0))) < 3.0:
                    who = type(widget).__name__, widget.accessibleName() or widget.toolTip()
                    thin.append((page.__class__.__name__, *who, round(found, 2)))
    window.set_theme("dark")
    for one in list(window.live.regions.drawn):
        window.live.regions.remove(one)
    assert looked > 150
    assert not faint
    assert not thin


def test_the_pump_delivers_at_the_rate_that_was_set(window):
    """A plume that is pushed too fast mixes otherwise than the one that was calibrated."""
    window.show_page(window.doser)
    rate, set_it = on_page.field(window.doser, "The pump delivers"), on_page.button(window.doser, "Set the rate")
    until(rate.isEnabled, 60.0)
    assert rate.value == 200.0, "2000 steps/s at 10 steps per µl"
    for typed in ("0", "1e9", "fast"):
        on_page.fill(rate, typed)
        assert not set_it.isEnabled()
        assert "0.01 to 6553.5 µl/s" in rate.says.text()
    on_page.fill(rate, "25")
    set_it.click()
    until(lambda: window.rig.pace.dose_ul_per_s == 25.0 and window.status.state.value == "ready", 60.0)
    held = window.status.tank.volume_ul
    window.dose_to(held + 50.0)
    until(lambda: window.status.tank.volume_ul > held + 1.0, 60.0)
    began = time.monotonic()
    until(lambda: window.status.target_ul is None, 60.0)
    assert time.monotonic() - began > 1.5, "50 µl at 25 µl/s take two seconds; at 200 µl/s they took a quarter"
    assert window.host.source.rate_ul_per_s == 25.0
    window.host.use(type(window.host.source)(window.host.source.file, window.host.source.folder))
    until(lambda: window.rig.pace.dose_ul_per_s == 200.0 and window.status.state.value == "ready", 60.0)
