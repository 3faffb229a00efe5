"""Loss is what the device's count says, and no late stamp, jitter or change of rate makes a frame begin too late."""

from itertools import accumulate

from hypothesis import given
from hypothesis import strategies as st

from drivers.v4l2.times import FrameCount, FrameTimes

REMEMBERED = 8
PACES_NS = st.integers(1_000_000, 100_000_000)


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 2**31 - 1), max_size=50))
def test_the_count_rises_by_the_frames_lost_and_one_through_every_wrap(first, steps):
    count = FrameCount()
    began = count.next(first)
    for total in accumulate(steps):
        assert count.next((first + total) % 2**32) == began + total


@given(st.lists(st.integers(0, 2**32 - 1), min_size=2))
def test_whatever_the_device_counts_every_frame_has_a_number_of_its_own(device):
    count = FrameCount()
    numbers = [count.next(number) for number in device]
    assert numbers == sorted(set(numbers))


@given(st.lists(st.lists(st.integers(1, 5), max_size=5), min_size=1, max_size=5))
def test_a_stream_that_was_interrupted_shows_as_one_frame_lost(streams):
    count, last = FrameCount(), 0
    for steps in streams:
        count.interrupted()
        count.interrupted()
        device, before = 0, last
        for step in [0, *steps]:
            device += step
            number = count.next(device)
            assert number == last + (step or (2 if before else 1))
            last = number


@st.composite
def lateness_ns(draw: st.DrawFn) -> list[int]:
    """Of forty frames; of any eight in a row three at least are not late."""
    late: list[int] = []
    for _ in range(40):
        may = late[1 - REMEMBERED :].count(0) >= 3
        late.append(draw(st.one_of(st.just(0), st.integers(0, 300_000_000))) if may else 0)
    return late


@given(PACES_NS, st.floats(0.0, 1.0), st.lists(st.integers(1, 4), min_size=40, max_size=40), lateness_ns())
def test_no_frame_begins_too_late_while_three_of_eight_stamps_are_true(pace_ns, known, steps, late_ns):
    times = FrameTimes(int(known * pace_ns))
    for frame, late in zip(accumulate(steps), late_ns, strict=True):
        began_ns = times.began_ns(frame, 10**12 + frame * pace_ns + late)
        assert began_ns is None or began_ns <= 10**12 + frame * pace_ns


@given(PACES_NS, PACES_NS, st.lists(st.integers(1, 4), min_size=40, max_size=40), lateness_ns())
def test_after_eight_true_stamps_nothing_is_left_of_what_was_before(was_ns, is_ns, steps, late_ns):
    """No error accumulates: not from late stamps, lost frames or a change of the rate, up or down."""
    times, stamped_ns, frame = FrameTimes(min(was_ns, is_ns)), 10**12, 0
    for step, late in zip(steps, late_ns, strict=True):
        frame, stamped_ns = frame + step, stamped_ns + step * was_ns
        times.began_ns(frame, stamped_ns + late)
    stamped_ns += max(late_ns)
    for since in range(2 * REMEMBERED):
        frame, stamped_ns = frame + 1, stamped_ns + is_ns
        began_ns = times.began_ns(frame, stamped_ns)
        assert began_ns is None or since < REMEMBERED or began_ns == stamped_ns
        assert began_ns is not None or since < REMEMBERED


@given(st.integers(0, 10**8), st.lists(st.tuples(st.integers(1, 9), st.integers(-(10**9), 10**9)), max_size=50))
def test_frames_begin_in_order_and_never_after_their_stamp(period_ns, frames):
    times, frame, stamped_ns, before_ns = FrameTimes(period_ns), 0, 10**12, 0
    for step, since_ns in frames:
        frame, stamped_ns = frame + step, stamped_ns + since_ns
        began_ns = times.began_ns(frame, stamped_ns)
        if began_ns is None:
            assert stamped_ns <= before_ns
        else:
            assert before_ns < began_ns <= stamped_ns
            before_ns = began_ns
