"""Rules that hold for every doser, whichever pump is behind it; on a clock of their own (`tests.virtual_time`)."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from drivers.counted.record import CountFile
from drivers.registry import open_device
from tankrig.errors import DeviceError, UndecidedError

from .doser_bench import AnyBench, Bench, CavroBench, NewEraBench
from .virtual_time import World

SLOW = {
    Bench: {"rate": 400.0, "dose_cap": 20_000},
    NewEraBench: {"rate_ml_per_min": 2.4},
    CavroBench: {"speed_ul_per_s": 40.0},
}
BENCHES = pytest.mark.parametrize("bench", list(SLOW), indirect=True)
COUNTED = pytest.mark.parametrize("bench", [NewEraBench, CavroBench], indirect=True)
UL_PER_S = 40.0
STOPS_WITHIN_S = {Bench: 1.5, NewEraBench: 3.0, CavroBench: 1.0}


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[AnyBench]:
    with request.param(tmp_path, world=World(), **SLOW[request.param]) as made:
        yield made


def assert_bounds_hold(doser: Any, bench: AnyBench) -> None:
    _, low, high = doser.delivered()
    assert low - 1e-9 <= bench.true_ul <= high + 1e-9


# -- watchdog ----------------------------------------------------------------------------------------------------------


@BENCHES
def test_a_hung_dosing_thread_stops_the_pump_however_often_others_look(bench: AnyBench) -> None:
    """A window that polls must not keep a pump running whose program hangs: it would deliver the whole dose."""
    doser, world = bench.open(), bench.world
    seen: list[float] = []

    def hang() -> None:
        begun_s, begun_ul = world.now_s, bench.true_ul
        assert begun_ul > 0.0
        while world.now_s < begun_s + 20.0:
            world.advance(0.1)
            doser.delivered()
        seen.extend((begun_ul, bench.true_ul))

    world.after(3.0, hang)
    with nullcontext() if isinstance(bench, CavroBench) else pytest.raises(DeviceError, match=r"watchdog|stopped at"):
        doser.dose_to(500.0)  # a Cavro, which has no watchdog, waits for its next move, and then goes on
    before_ul, after_ul = seen
    assert after_ul - before_ul <= UL_PER_S * (STOPS_WITHIN_S[type(bench)] + 0.1)
    assert_bounds_hold(doser, bench)


@BENCHES
def test_while_it_doses_being_asked_puts_nothing_on_the_wire(bench: AnyBench) -> None:
    doser, world = bench.open(), bench.world
    told: list[tuple[float, float, float, float]] = []

    def look() -> None:
        before = bench.written(doser)
        told.append((*doser.delivered(), bench.true_ul))
        assert bench.written(doser) == before
        if len(told) < 50:
            world.after(0.1, look)

    world.after(1.0, look)
    doser.dose_to(300.0)
    assert len(told) == 50
    assert all(low <= volume <= high and low - 1e-9 <= true <= high + 1e-9 for volume, low, high, true in told)
    assert told[-1][0] > told[0][0] + 100.0, "it does not tell how far it is"


def test_a_pump_that_goes_on_beyond_its_volume_is_stopped(tmp_path: Path) -> None:
    """Whatever has become of what it was set to: it is stopped at the first poll that counts more than was asked."""
    with NewEraBench(tmp_path, world=World(), **SLOW[NewEraBench]) as bench:
        doser, world = bench.open(), bench.world
        world.after(1.5, lambda: setattr(bench.board.core, "left", None))
        with pytest.raises(DeviceError, match=r"counts .* where 100 were asked, and still moves"):
            doser.dose_to(100.0)
        assert bench.true_ul <= 100.0 + 0.25 * UL_PER_S
        assert doser.stopped
        assert not bench.moving
        assert_bounds_hold(doser, bench)


# -- what a device knows -----------------------------------------------------------------------------------------------


def silent_in_a_dose(bench: AnyBench, doser: Any, total_ul: float) -> None:
    """Nothing is heard of it from the third second on; it goes on as far as its firmware lets it."""
    bench.world.after(3.0, lambda: bench.faults(mute=True, deaf=not isinstance(bench, CavroBench)))
    with pytest.raises(UndecidedError):
        doser.dose_to(total_ul)
    assert doser.unknown
    assert doser.stopped
    bench.world.advance(3.0)  # by then it rests, without having heard the stop


@BENCHES
def test_what_was_heard_before_the_fault_raises_the_low_bound(bench: AnyBench) -> None:
    doser = bench.open()
    silent_in_a_dose(bench, doser, 500.0)
    _, low, high = doser.delivered()
    assert 30.0 < low <= bench.true_ul <= high <= 500.0


@BENCHES
def test_a_person_is_not_asked_before_a_pump_that_answers_again(bench: AnyBench) -> None:
    """`resolve` took 200 where the doser had counted 600, and the next dose went 400 µl beyond its target."""
    doser = bench.open()
    silent_in_a_dose(bench, doser, 500.0)
    bench.no_faults()
    with pytest.raises(DeviceError, match=r"20 µl cannot have been delivered in all; it was between"):
        doser.resolve(20.0)
    assert not doser.unknown
    assert_bounds_hold(doser, bench)
    doser.clear_stop()
    doser.dose_to(500.0)
    assert 490.0 < bench.true_ul <= 500.0


@BENCHES
def test_nothing_is_left_to_ask_once_the_pump_has_told(bench: AnyBench) -> None:
    doser = bench.open()
    silent_in_a_dose(bench, doser, 500.0)
    bench.no_faults()
    doser.delivered()
    assert not doser.unknown
    assert doser.stopped, "it went on without a person"
    with pytest.raises(DeviceError, match="nothing to resolve"):
        doser.resolve(bench.true_ul)


@BENCHES
def test_a_word_that_agrees_with_a_pump_that_answers_again_is_taken(bench: AnyBench) -> None:
    doser = bench.open()
    silent_in_a_dose(bench, doser, 500.0)
    bench.no_faults()
    doser.resolve(bench.true_ul)
    assert not doser.unknown
    assert_bounds_hold(doser, bench)


@BENCHES
def test_a_silent_pump_is_not_resolved_behind_its_back(bench: AnyBench) -> None:
    doser = bench.open()
    silent_in_a_dose(bench, doser, 500.0)
    with pytest.raises(DeviceError, match="no reply"):
        doser.resolve(100.0)
    assert doser.unknown


@COUNTED
def test_a_counter_that_survived_the_unplugging_is_believed_by_the_next_program(bench: AnyBench) -> None:
    """Its 299.6 were ignored, 150 taken, and 649 µl went into a budget of 600."""
    doser = bench.open()
    bench.world.after(5.0, lambda: bench.do("unplug"))
    with pytest.raises(UndecidedError, match="line is gone"):
        doser.dose_to(600.0)
    assert_bounds_hold(doser, bench)
    doser.close()
    bench.world.advance(10.0)
    bench.do("plug")
    again = bench.open()
    assert again.stopped
    assert not again.unknown
    _, low, high = again.delivered()
    assert low - 1e-9 <= bench.true_ul <= high + 1e-9
    assert high - low < 6.0
    with pytest.raises(DeviceError):
        again.resolve(50.0)
    again.clear_stop()
    again.dose_to(600.0)
    assert 590.0 < bench.true_ul <= 600.0


def test_a_pump_initialised_after_an_unknown_dose_does_not_count_its_move_as_ink(tmp_path: Path) -> None:
    """Unplugged in a dose, initialised by a person: its position means nothing any more."""
    with CavroBench(tmp_path, world=World(), **SLOW[CavroBench]) as bench:
        doser = bench.open()
        silent_in_a_dose(bench, doser, 500.0)
        bench.no_faults()
        before_ul = bench.true_ul
        doser.initialise()
        assert doser.unknown
        _, low, high = doser.delivered()
        assert low <= before_ul <= high <= 500.0
        doser.resolve(before_ul)
        assert doser.delivered().volume_ul == pytest.approx(before_ul, abs=doser.increment_ul)


# -- count file --------------------------------------------------------------------------------------------------------


def another_name(count: Path, how: str) -> Path:
    other = count.with_name("other")
    if how == "link":
        other.symlink_to(count)
    elif how == "folder":
        other.symlink_to(count.parent)
        return other / "count"
    elif how == "hard link":
        other.hardlink_to(count)
    elif how == "moved":
        count.rename(other)
    return other if how != "itself" else count


@pytest.mark.parametrize("how", ["itself", "link", "folder", "hard link", "moved"])
@COUNTED
def test_a_count_has_one_doser_by_whatever_name(bench: AnyBench, how: str, tmp_path: Path) -> None:
    doser = bench.open()
    doser.dose_to(20.0)  # the file has been replaced meanwhile
    tick_ul = json.loads((tmp_path / "count").read_text())["tick_ul"]
    with pytest.raises(DeviceError, match=r"another doser uses it|has a second name") as refusal:
        CountFile(another_name(tmp_path / "count", how), "second", tick_ul)
    assert "\n" not in str(refusal.value)
    if how == "moved":
        with pytest.raises(DeviceError, match="was moved or replaced"):
            doser.dose_to(40.0)
        assert bench.true_ul <= 20.0
        (tmp_path / "other").rename(tmp_path / "count")
        doser.clear_stop()
    doser.dose_to(40.0)
    doser.close()
    (tmp_path / "other").unlink(missing_ok=True)
    CountFile(tmp_path / "count", "next", tick_ul).close()


HOLDER = """
import sys, time
from pathlib import Path
from drivers.counted.record import CountFile
file = CountFile(Path(sys.argv[1]), "holder", 0.001)
file.update(unsure=(1, 2))
print("held", flush=True)
time.sleep(60)
"""


def test_a_killed_program_lets_go_of_the_count(tmp_path: Path) -> None:
    count = tmp_path / "count"
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(count)], stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"held\n"
    with pytest.raises(DeviceError, match="another doser uses it"):
        CountFile(count, "second", 0.001)
    os.kill(holder.pid, signal.SIGKILL)
    holder.communicate()
    second = CountFile(count, "second", 0.001)
    assert second.record.unsure == (1, 2)
    second.close()


@COUNTED
def test_a_path_that_is_not_utf_8_works(bench: AnyBench, tmp_path: Path) -> None:
    """A folder named on another system: the dose must not be left open because its path cannot be told."""
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/t\xe4nk"))
    doser = bench.open(count_file=odd / "count")
    doser.dose_to(20.0)
    (odd / "count").unlink()
    with pytest.raises(DeviceError) as refusal:
        doser.dose_to(40.0)
    assert "t\\xe4nk" in str(refusal.value)
    str(refusal.value).encode()
    assert 19.0 < bench.true_ul <= 20.0


def test_a_simulated_doser_in_a_folder_that_is_not_utf_8_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="not valid UTF-8; use another folder"):
        open_device("simulated-doser", {"folder": Path(os.fsdecode(os.fsencode(tmp_path) + b"/t\xe4nk"))})


@COUNTED
def test_a_count_file_of_an_earlier_version_still_asks_a_person(bench: AnyBench, tmp_path: Path) -> None:
    """They kept no word of the dose beside its bounds, so that the counter cannot settle it."""
    doser = bench.open()
    doser.dose_to(20.0)
    doser.close()
    stored = json.loads((tmp_path / "count").read_text())
    ticks = round(1.0 / stored["tick_ul"])
    (tmp_path / "count").write_text(json.dumps(stored | {"unsure": [10 * ticks, 60 * ticks], "begun": None}))
    again = bench.open()
    assert again.unknown
    assert again.stopped
    assert again.delivered()[1:] == pytest.approx((10.0, 60.0))
    again.resolve(20.0)
    again.clear_stop()
    again.dose_to(30.0)
    assert 28.0 < bench.true_ul <= 30.0


def test_a_dose_that_had_ended_is_settled_for_the_next_program(tmp_path: Path) -> None:
    """Its program was killed before it wrote that down: the counter stands where the leg was to end."""
    with NewEraBench(tmp_path, world=World(), **SLOW[NewEraBench]) as bench:
        doser, count = bench.open(), tmp_path / "count"
        begun: list[bytes] = []
        bench.world.after(1.5, lambda: begun.append(count.read_bytes()))
        doser.dose_to(100.0)
        doser.close()
        count.write_bytes(begun[0])
        again = bench.open()
        assert again.stopped
        assert not again.unknown
        assert_bounds_hold(again, bench)


@pytest.mark.parametrize("ends", [True, False])
def test_a_dose_begun_by_an_earlier_version_is_read(tmp_path: Path, ends: bool) -> None:
    """Its count file says neither where the leg ends nor how far the pump goes on its own."""
    with NewEraBench(tmp_path, world=World(), **SLOW[NewEraBench]) as bench:
        doser, count = bench.open(), tmp_path / "count"
        begun: list[dict[str, Any]] = []
        bench.world.after(1.5, lambda: begun.append(json.loads(count.read_bytes())))
        if not ends:
            bench.world.after(2.0, lambda: bench.do("unplug"))
        with nullcontext() if ends else pytest.raises(UndecidedError):
            doser.dose_to(300.0)
        doser.close()
        bench.world.advance(5.0)
        bench.do("plug")
        count.write_text(json.dumps(begun[0] | {"begun": {"what": "dose", "to": begun[0]["begun"]["to"]}}))
        again = bench.open()
        assert again.stopped
        assert again.unknown == ends, "the alarm of its watchdog settles it, and nothing else"
        assert_bounds_hold(again, bench)


# -- time --------------------------------------------------------------------------------------------------------------


@BENCHES
def test_asking_a_silent_pump_of_which_nothing_is_known_takes_a_second_at_most(bench: AnyBench) -> None:
    doser = bench.open()
    silent_in_a_dose(bench, doser, 500.0)
    begun_s = bench.world.now_s
    doser.delivered()
    assert bench.world.now_s - begun_s <= 1.2
