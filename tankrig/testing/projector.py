"""What every projector promises, real or simulated."""

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from tankrig.devices import Flip, Projector
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

ReopenProjector = Callable[[], Projector]


def plain(projector: Projector, level: int) -> Pattern:
    """A pattern of one level, in the projector's shape."""
    return Pattern(f"level {level}", np.full(projector.shape, level, np.uint8))


class ProjectorContract:
    """Subclass it and give it the fixture `reopen`: a function that opens the projector, and again after `close`."""

    @pytest.fixture
    def projector(self, reopen: ReopenProjector) -> Projector:
        """Open, and closed by `reopen`'s own end."""
        return reopen()

    def test_is_a_projector_with_a_name_and_a_shape(self, projector: Projector) -> None:
        assert isinstance(projector, Projector)
        assert projector.name
        assert len(projector.shape) == 2
        assert min(projector.shape) >= 1

    def test_a_flip_says_when_it_happened_and_from_when_on_frames_count(self, projector: Projector) -> None:
        pattern, before = plain(projector, 255), time.monotonic_ns()
        flip = projector.show(pattern)
        assert isinstance(flip, Flip)
        assert flip.pattern_hash == pattern.hash
        assert before <= flip.settled_ns <= time.monotonic_ns(), "it returned before the frame was on the output"
        assert flip.bound_ns > flip.settled_ns

    def test_flips_follow_each_other(self, projector: Projector) -> None:
        flips = [projector.show(plain(projector, level)) for level in (0, 255, 0, 128, 128)]
        settled = [flip.settled_ns for flip in flips]
        assert settled == sorted(set(settled))

    def test_a_pattern_is_left_as_it_was(self, projector: Projector) -> None:
        pattern = Pattern("ramp", np.random.default_rng(1).integers(0, 256, projector.shape, np.uint8))
        before = pattern.pixels.copy()
        projector.show(pattern)
        np.testing.assert_array_equal(pattern.pixels, before)

    def test_a_pattern_of_another_shape_is_refused(self, projector: Projector) -> None:
        rows, columns = projector.shape
        with pytest.raises(DeviceError, match="shape"):
            projector.show(Pattern("too wide", np.zeros((rows, columns + 1), np.uint8)))
        projector.show(plain(projector, 0))

    def test_two_threads_may_ask_and_each_gets_its_flip(self, projector: Projector) -> None:
        flips: list[Flip] = []
        threads = [
            threading.Thread(target=lambda level=level: flips.append(projector.show(plain(projector, level))))
            for level in (10, 20, 30)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(10.0)
        assert {flip.pattern_hash for flip in flips} == {plain(projector, level).hash for level in (10, 20, 30)}
        assert len({flip.settled_ns for flip in flips}) == 3

    def test_after_close_it_shows_nothing_and_says_so_by_name(self, projector: Projector) -> None:
        pattern = plain(projector, 0)
        projector.close()
        projector.close()
        with pytest.raises(DeviceError, match=projector.name[:12]):
            projector.show(pattern)

    def test_it_can_be_opened_again(self, projector: Projector, reopen: ReopenProjector) -> None:
        shape = projector.shape
        projector.close()
        again = reopen()
        assert again.shape == shape
        assert again.show(plain(again, 0)).settled_ns > 0
