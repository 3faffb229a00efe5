"""The calibration page leads a person through a procedure while the rig is lent to it, and shows what is known."""

import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from PySide6.QtCore import QObject, Qt, Signal
from PySide6.QtTest import QTest

from tankrig.calibration.file import newest

from . import on_page
from .window_rig import until, window_on, write_rig

FAST = "time_scale = 0.005"


@contextmanager
def opened_in(folder: Path):
    rig = write_rig(folder, projector=FAST, camera=f"{FAST}\nmost_per_s = 1000.0")
    with window_on(folder, rig) as made:
        until(lambda: made.built and made.status.state.name == "IDLE", what="the rig opens")
        made.show_page(made.calibration)
        made.calibration.tabs.setCurrentIndex(1)
        yield made


@pytest.fixture
def window(tmp_path: Path):
    with opened_in(tmp_path) as made:
        yield made


class Begun(QObject):
    """A command that was begun: it says what the test has it say."""

    asked, said = Signal(str, bool), Signal(str, bool)
    looked, kept, ended = Signal(object), Signal(object), Signal(int, str)

    def __init__(self, words: list[str]) -> None:
        super().__init__()
        self.words = words

    @classmethod
    def instead(cls, monkeypatch: pytest.MonkeyPatch) -> list["Begun"]:
        """Have these begun in place of processes; those that were."""
        begun: list[Begun] = []

        def begin(words: list[str], _: Path) -> Begun:
            begun.append(cls(words))
            return begun[-1]

        monkeypatch.setattr("ui.window.calibration_wizard.CalibrationProcess", begin)
        return begun


def choose(window, kind: str, options: str):
    wizard = window.calibration.wizard
    wizard.choose(kind)
    words = options.split()
    for flag, value in zip(words[::2], words[1::2], strict=True):
        wizard.options[flag].set_text(value)
    until(wizard.begin.isEnabled)
    QTest.mouseClick(wizard.begin, Qt.MouseButton.LeftButton)
    return wizard


@pytest.mark.long
def test_radiometry_is_measured_shown_and_known(window, tmp_path: Path) -> None:
    wizard = choose(window, "radiometry", "--gains 1")
    looks = set()
    until(lambda: looks.add(wizard.light.text()) or not wizard.at_work, 60.0)
    assert "counts per electron" in wizard.result.text()
    assert wizard.seen.pixmap().width() > 300
    filled = [re.search(r"brightest (\d+)% of the range", look) for look in looks]
    assert any(int(found[1]) > 30 for found in filled if found)
    kept = newest(tmp_path / "calibration", "radiometry")
    assert kept is not None
    assert kept.path.name in wizard.result.text()
    until(lambda: window.status.state.name == "IDLE", what="the rig is taken back")
    until(lambda: kept.path.name in words_of(window.calibration), what="the page shows what is known")


def words_of(page) -> str:
    return on_page.words_on(page.tabs.widget(0))


@pytest.fixture(params=[signal.default_int_handler, signal.SIG_IGN], ids=["terminal", "background"])
def started_from(request: pytest.FixtureRequest) -> Iterator[None]:
    """A shell starts what it puts into the background with SIGINT ignored, and children inherit that."""
    before = signal.signal(signal.SIGINT, request.param)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.long
def test_a_pump_is_weighed_by_answering_in_the_window(window, tmp_path: Path) -> None:
    wizard = choose(window, "pump", "--volumes 20,80 --repeats 2 --temperature 21")
    weights = iter((20.3, 81.5, 20.3, 81.4))

    def answered() -> bool:
        if wizard.answer.isVisible():
            QTest.keyClicks(wizard.answer, "a lot")
            QTest.keyClick(wizard.answer, Qt.Key.Key_Return)
            assert wizard.answer.isVisible(), "no number was taken for a weight"
            wizard.answer.clear()
            QTest.keyClicks(wizard.answer, str(next(weights)))
            QTest.keyClick(wizard.answer, Qt.Key.Key_Return)
        elif wizard.done.isVisible():
            QTest.mouseClick(wizard.done, Qt.MouseButton.LeftButton)
        return not wizard.at_work

    until(answered, 40.0)
    assert "a nominal µl is" in wizard.result.text()
    (file,) = tmp_path.glob("pump-*.toml")
    until(lambda: file.name in words_of(window.calibration))


def test_what_a_field_allows_is_what_its_command_takes() -> None:
    import click

    from ui.cli.calibrate import calibrate
    from ui.window.calibration_wizard import WIZARDS

    for wizard in WIZARDS:
        options = {option.opts[0]: option for option in calibrate.get_command(None, wizard.kind).params}
        for choice in wizard.choices:
            taken = options[choice.flag].type
            if isinstance(taken, click.IntRange):
                assert (choice.kind, choice.low, choice.high) == ("whole", taken.min, taken.max), wizard.kind


@pytest.mark.long
def test_a_calibration_that_is_cancelled_leaves_nothing(window, tmp_path: Path) -> None:
    wizard = choose(window, "radiometry", "--gains 1")
    until(lambda: wizard.bar.value() > 0)
    QTest.mouseClick(wizard.cancel, Qt.MouseButton.LeftButton)
    until(lambda: not wizard.at_work)
    until(lambda: window.status.state.name == "IDLE")
    assert not (tmp_path / "calibration").exists()


def test_a_doubtful_result_is_used_when_a_person_says_so(window, monkeypatch, tmp_path: Path) -> None:
    """It lay aside, and only the command line's `--accept`, given before, would have used it."""
    from tankrig.calibration.file import Calibration, save

    folder = tmp_path / "calibration"
    doubtful = Calibration("latency", "simulated projector", (30, 40), {"p99_ms": 9.0}, doubts=("it came late",))
    kept = save(doubtful, folder)
    assert newest(folder, "latency") is None
    begun = Begun.instead(monkeypatch)
    wizard = choose(window, "latency", "--flips 20")
    until(lambda: begun, what="the rig is let go of, and the command begins")
    result = {"path": str(kept.path), "rows": {"p99": "9 ms"}, "doubts": list(kept.doubts), "in_use": False}
    begun[0].kept.emit(result)
    begun[0].ended.emit(0, "")
    assert "Doubt: it came late" in wizard.result.text()
    until(wizard.use.isVisible)
    QTest.mouseClick(wizard.use, Qt.MouseButton.LeftButton)
    assert newest(folder, "latency").result == {"p99_ms": 9.0}
    assert wizard.use.isHidden()
    until(lambda: kept.path.name in words_of(window.calibration), what="the page shows what is known")


def test_a_doubtful_result_is_offered_for_as_long_as_nothing_newer_is_in_force(tmp_path: Path) -> None:
    """It was only right after it had been measured: another Begin, or a new window, and it could not be used."""
    from tankrig.calibration.file import Calibration, left_aside, save

    def measured(folder: str, kind: str, day: int, doubts: tuple[str, ...] = ()) -> Calibration:
        when = f"2026-11-{day}T10:00:00+00:00"
        device = "simulated projector"
        found = Calibration(kind, device, (30, 40), {"p99_ms": 9.0}, doubts=doubts, date=when, rig="test rig")
        return save(found, tmp_path / folder)

    measured("other", "latency", 12, ("it came late",))
    measured("other", "projector", 12, ("the board moved",))
    used = measured("other", "projector", 13)
    measured("other", "stray", 12, ("the card moved",))
    assert left_aside(tmp_path / "other").keys() == {"latency", "stray"}
    measured("other", "projector", 14, ("the board moved",))
    assert left_aside(tmp_path / "other").keys() == {"latency", "stray", "projector"}
    assert left_aside(tmp_path / "other", {"projector": used.hash}).keys() == {"latency", "stray"}
    late = measured("calibration", "latency", 12, ("it came late",))
    with window_on(tmp_path, write_rig(tmp_path, projector=FAST, camera=FAST)) as window:
        until(lambda: window.built and window.status.state.name == "IDLE", what="the rig opens")
        window.show_page(window.calibration)
        wizard = window.calibration.wizard
        until(lambda: "latency, set aside" in words_of(window.calibration))
        assert "doubt: it came late" in words_of(window.calibration)
        window.calibration.tabs.setCurrentIndex(1)
        wizard.choose("latency")
        assert wizard.use.isVisible()
        assert "Doubt: it came late" in wizard.result.text()
        wizard.choose("stray")
        assert wizard.use.isHidden()
        assert wizard.result.text() == ""
        wizard.choose("latency")
        until(wizard.begin.isEnabled)
        wizard.begin.click()
        assert wizard.use.isHidden()
        QTest.mouseClick(wizard.cancel, Qt.MouseButton.LeftButton)
        until(lambda: window.status.state.name == "IDLE" and wizard.use.isVisible(), what="it is offered again")
        window.calibration.tabs.setCurrentIndex(0)
        use = on_page.button(window.calibration.tabs.widget(0), wizard.use.text())
        QTest.mouseClick(use, Qt.MouseButton.LeftButton)
        kept = newest(tmp_path / "calibration", "latency")
        assert kept.hash == late.hash
        assert "used from now on, doubts and all" in wizard.result.text()
        until(lambda: "latency, set aside" not in words_of(window.calibration))
        wizard.choose("camera")
        wizard.choose("latency")
        assert wizard.use.isHidden()


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("calibrated")
    with opened_in(folder) as made:
        made.home = folder
        yield made


@pytest.fixture
def shared(opened):
    """A window for several tests, with nothing typed."""
    until(lambda: opened.status.state.name == "IDLE", what="the rig is at rest")
    opened.calibration.tabs.setCurrentIndex(1)
    opened.calibration.wizard.choose("camera")
    opened.activateWindow()
    return opened


@pytest.mark.usefixtures("started_from")
def test_nothing_else_begins_meanwhile_and_stop_ends_it(shared) -> None:
    """STOP is always one press away, also from a pump that is being weighed."""
    wizard = choose(shared, "pump", "--volumes 20 --repeats 3")
    until(wizard.done.isVisible, what="asks where the tube hangs")
    assert "vessel on the balance" in wizard.request.text()
    assert shared.status.busy
    assert not wizard.begin.isEnabled()
    shared.host.dose_to(50.0)
    QTest.mouseClick(wizard.done, Qt.MouseButton.LeftButton)
    until(lambda: "tare" in wizard.request.text())
    shared.host.stop()
    until(lambda: not wizard.at_work, what="the calibration has ended")
    assert not list(shared.home.glob("pump-*.toml"))
    until(lambda: shared.status.state.name == "IDLE", what="the rig is taken back")


def test_what_is_measured_is_known(shared) -> None:
    wizard = choose(shared, "latency", "--flips 20")
    until(lambda: wizard.bar.value() > 0)
    until(lambda: not wizard.at_work)
    assert "99 % within" in wizard.result.text()
    if not wizard.use.isHidden():  # on a busy machine the light is late, and the result doubtful
        QTest.mouseClick(wizard.use, Qt.MouseButton.LeftButton)
    kept = newest(shared.home / "calibration", "latency")
    assert kept.path.name in wizard.result.text()
    until(lambda: shared.status.state.name == "IDLE", what="the rig is taken back")
    until(lambda: kept.path.name in words_of(shared.calibration), what="the page shows what is known")


def test_what_makes_no_sense_is_said_as_it_is_typed_and_nothing_begins(shared) -> None:
    """The rig was let go of first, and then the command refused its option, by its name on a command line."""
    wizard = shared.calibration.wizard
    for kind, flag, typed, why in (
        ("latency", "--flips", "5", "5 is outside of 20 to 10000"),
        ("latency", "--flips", "abc", "abc is no whole number; give 20 to 10000"),
        ("radiometry", "--gains", "1, many", "give numbers with commas between them, more than 0 to 1e+06"),
        ("pump", "--volumes", "50, 2000", "2000 is outside of more than 0 to 1000 µl"),
    ):
        wizard.choose("camera")
        wizard.choose(kind)
        until(wizard.begin.isEnabled)
        field = wizard.options[flag]
        field.edit.selectAll()
        QTest.keyClicks(field.edit, typed)
        assert field.says.text() == why
        assert not field.says.isHidden()
        assert not wizard.begin.isEnabled()
        assert why in wizard.begin.toolTip()
        wizard.follow(shared.status)
        assert not wizard.begin.isEnabled()
        wizard.begin.click()
        assert not wizard.at_work
    wizard.choose("radiometry")
    QTest.keyClicks(wizard.options["--longest-ms"].edit, "20")
    assert "are no sweep" in wizard.wrong.text()
    assert not wizard.begin.isEnabled()
    wizard.options["--longest-ms"].edit.clear()
    assert wizard.begin.isEnabled()
    assert wizard.wrong.isHidden()


def test_numbers_reach_the_command_as_they_were_meant(shared, monkeypatch) -> None:
    """ "50 250" became one dose of 50250 µl."""
    begun = Begun.instead(monkeypatch)
    wizard = shared.calibration.wizard
    wizard.choose("pump")
    wizard.options["--volumes"].set_text("50 250")
    wizard.options["--temperature"].set_text("21,5")
    until(wizard.begin.isEnabled)
    wizard.begin.click()
    until(lambda: begun, what="the rig is let go of, and the command begins")
    assert begun[0].words[-6:] == ["--volumes", "50,250", "--repeats", "10", "--temperature", "21.5"]
    begun[0].ended.emit(0, "")
