"""What every doser promises, real or simulated.

Volumes are relative to what the doser has counted, and small, so that the same tests run on a real syringe.
"""

import math
import threading
import time
from collections.abc import Callable

import pytest

from tankrig.devices import Doser
from tankrig.errors import DeviceError

ReopenDoser = Callable[[], Doser]


class DoserContract:
    """Subclass it and give it the fixture `reopen`: a function that opens the doser, and again after `close`.

    The doser is then idle and not latched. `steps_short` and `steps_long` count increments; a dose of `steps_long`
    takes long enough to be interrupted.
    """

    steps_short = 20
    steps_long = 600

    @pytest.fixture
    def doser(self, reopen: ReopenDoser) -> Doser:
        """Open, and closed by `reopen`'s own end."""
        return reopen()

    def far(self, doser: Doser) -> float:
        """A total that takes long enough to be interrupted."""
        return doser.delivered().volume_ul + self.steps_long * doser.increment_ul

    def near(self, doser: Doser) -> float:
        return doser.delivered().volume_ul + self.steps_short * doser.increment_ul

    def test_is_a_doser_that_can_be_told_from_others(self, doser: Doser) -> None:
        assert isinstance(doser, Doser)
        assert doser.name
        assert doser.identity
        assert doser.increment_ul > 0

    def test_delivers_the_total_and_never_more(self, doser: Doser) -> None:
        total = self.near(doser)
        after = doser.dose_to(total)
        assert total - doser.increment_ul < after.volume_ul <= total + 1e-9
        assert after.low_ul <= after.volume_ul <= after.high_ul <= total + 1e-9
        assert doser.delivered() == after

    def test_the_same_total_again_moves_nothing(self, doser: Doser) -> None:
        after = doser.dose_to(self.near(doser))
        assert doser.dose_to(after.volume_ul) == after

    def test_fractions_of_an_increment_do_not_add_up(self, doser: Doser) -> None:
        start, step = doser.delivered().volume_ul, doser.increment_ul
        for part in (1.7, 3.4, 5.1):
            after = doser.dose_to(start + part * step)
        assert after.volume_ul == pytest.approx(start + 5 * step, abs=step)

    def test_ink_cannot_be_taken_back(self, doser: Doser) -> None:
        after = doser.dose_to(self.near(doser))
        with pytest.raises(DeviceError):
            doser.dose_to(after.volume_ul - 5 * doser.increment_ul)
        assert doser.delivered() == after

    @pytest.mark.parametrize("total", [math.nan, math.inf, -math.inf, -1e6, 1e12])
    def test_what_is_no_volume_is_refused_before_anything_moves(self, doser: Doser, total: float) -> None:
        before = doser.delivered()
        with pytest.raises(DeviceError):
            doser.dose_to(total)
        assert doser.delivered() == before

    def test_stop_is_latched_until_it_is_cleared(self, doser: Doser) -> None:
        total = self.near(doser)
        before = doser.delivered()
        doser.stop()
        doser.stop()
        latched = doser.stopped
        assert latched
        with pytest.raises(DeviceError):
            doser.dose_to(total)
        assert doser.delivered() == before
        doser.clear_stop()
        assert not doser.stopped
        assert doser.delivered() == before
        assert doser.dose_to(total).volume_ul > before.volume_ul

    def test_a_stop_ends_a_dose_and_what_was_delivered_is_known(self, doser: Doser) -> None:
        total, before = self.far(doser), doser.delivered()
        stopper = threading.Thread(target=_when_moving, args=(doser, before.volume_ul, doser.stop))
        stopper.start()
        with pytest.raises(DeviceError):
            doser.dose_to(total)
        stopper.join()
        after = doser.delivered()
        assert before.volume_ul < after.volume_ul < total
        assert doser.stopped
        assert not doser.unknown
        doser.clear_stop()
        time.sleep(0.05)
        assert doser.delivered() == after, "it went on by itself"
        assert doser.dose_to(total).volume_ul == pytest.approx(total, abs=doser.increment_ul)

    def test_what_is_told_while_dosing_holds_the_truth_between_bounds(self, doser: Doser) -> None:
        total, lowest = self.far(doser), doser.delivered().low_ul
        seen = []
        done = threading.Event()

        def watch() -> None:
            while not done.is_set():
                seen.append(doser.delivered())
                time.sleep(0.002)

        watcher = threading.Thread(target=watch)
        watcher.start()
        doser.dose_to(total)
        done.set()
        watcher.join()
        assert len(seen) > 2
        assert all(lowest - 1e-9 <= low <= volume <= high <= total + 1e-9 for volume, low, high in seen)
        lows = [low for _, low, _ in seen]
        assert lows == sorted(lows)

    def test_a_second_dose_at_the_same_time_is_refused(self, doser: Doser) -> None:
        total, start = self.far(doser), doser.delivered().volume_ul
        refused = []

        def intrude() -> None:
            try:
                doser.dose_to(total)
            except DeviceError as error:
                refused.append(error)

        intruder = threading.Thread(target=_when_moving, args=(doser, start, intrude))
        intruder.start()
        assert doser.dose_to(total).volume_ul <= total + 1e-9
        intruder.join()
        assert refused

    def test_there_is_nothing_to_resolve_when_all_is_known(self, doser: Doser) -> None:
        before = doser.delivered()
        with pytest.raises(DeviceError):
            doser.resolve(before.volume_ul + 10 * doser.increment_ul)
        assert doser.delivered() == before

    def test_the_count_outlives_the_program(self, doser: Doser, reopen: ReopenDoser) -> None:
        after, identity = doser.dose_to(self.near(doser)), doser.identity
        doser.close()
        again = reopen()
        assert again.identity == identity
        assert again.delivered() == after
        assert not again.stopped

    def test_close_may_be_called_again_and_ends_everything(self, doser: Doser) -> None:
        total = self.near(doser)
        doser.close()
        doser.close()
        doser.stop()
        with pytest.raises(DeviceError):
            doser.dose_to(total)

    def test_close_ends_a_dose(self, doser: Doser, reopen: ReopenDoser) -> None:
        total, start = self.far(doser), doser.delivered().volume_ul
        closer = threading.Thread(target=_when_moving, args=(doser, start, doser.close))
        closer.start()
        with pytest.raises(DeviceError):
            doser.dose_to(total)
        closer.join()
        again = reopen()
        assert start < again.delivered().volume_ul < total
        again.clear_stop()


def _when_moving(doser: Doser, start_ul: float, act: Callable[[], object]) -> None:
    """Call `act` once the doser has moved a little."""
    deadline = time.monotonic() + 20.0
    while doser.delivered().volume_ul <= start_ul + 2 * doser.increment_ul and time.monotonic() < deadline:
        time.sleep(0.001)
    act()
