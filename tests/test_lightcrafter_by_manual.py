"""The LightCrafter's driver on a stand-in that does what TI's manual says, at its worst, and on a bad cable."""

import errno
import struct

import numpy as np
import pytest
import usb.core
from hypothesis import event, given, settings
from hypothesis import strategies as st

from drivers.lightcrafter4500 import health
from drivers.lightcrafter4500.usb_link import UsbLink
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern

from .lightcrafter_bench import SHAPE, LightcrafterBench

DARK = Pattern("dark", np.zeros(SHAPE, np.uint8))
FULL = Pattern("full", np.full(SHAPE, 255, np.uint8))
WITHIN_S = 3.0
"""From a reply that is lost to a clear error."""


def test_it_is_set_up_to_show_its_video_input_as_8_bit_patterns_without_gamma():
    bench = LightcrafterBench()
    with_it = bench.open()
    assert bench.displaying
    assert bench.sent(0x1A1B)[-1] == b"\1"
    assert bench.sent(0x1A29)[-1] == struct.pack("<II", 16667, 16667)
    assert bench.sent(0x1A31)[-1] == bytes([0, 1, 0, 0])
    assert bench.sent(0x1A34)[-1] == bytes([1, 0x78, 0])
    assert with_it.show(FULL).pattern_hash == FULL.hash
    with_it.confirm()


def test_a_board_in_standby_is_woken_and_waited_for():
    bench = LightcrafterBench(in_standby=True)
    bench.open()
    assert bench.displaying
    assert bench.sent(0x0200) == [b"\0"], "it was told to wake once"


def test_a_board_that_never_wakes_is_given_up_in_a_sentence():
    bench = LightcrafterBench(in_standby=True, wake_s=60.0)
    began_s = bench.clock.now_s
    with pytest.raises(DeviceError, match="does not wake from standby within 5 s; switch it off and on"):
        bench.open()
    assert bench.clock.now_s - began_s < 7.0


def test_the_hdmi_input_is_chosen_and_locked_before_pattern_mode_is_entered():
    bench = LightcrafterBench(lock_s=1.5)
    bench.open()
    sent = [(number, data) for read, number, data in bench.board.commands if not read]
    assert sent.index((0x1A00, b"\0")) < sent.index((0x1A1B, b"\1"))
    assert bench.displaying, "it says that it runs, and nothing is shown"


def test_without_video_it_is_not_said_to_show_anything():
    bench = LightcrafterBench(frame_s=None)
    with pytest.raises(DeviceError, match="sees no video at its HDMI input; check the HDMI cable"):
        bench.open()
    assert bench.windows[0].closed


def test_video_that_is_lost_later_is_told_by_the_next_confirmation():
    bench = LightcrafterBench()
    projector = bench.open()
    projector.show(FULL)
    bench.controller.frame_s = None
    with pytest.raises(DeviceError, match="LightCrafter 4500: "):
        projector.confirm()


def test_the_mode_is_read_back_until_it_has_changed():
    bench = LightcrafterBench(mode_s=0.8)
    bench.open()
    assert bench.displaying


def test_a_mode_that_does_not_change_is_told():
    with pytest.raises(DeviceError, match=r"does not enter .* mode; switch it off and on"):
        LightcrafterBench(mode_s=30.0).open()


@pytest.mark.parametrize("state", [1, 2])
def test_a_sequence_that_a_killed_program_left_running_or_paused_is_stopped_first(state):
    bench = LightcrafterBench()
    bench.open().close()
    left = UsbLink(bench.board, bench.clock)
    left.write(0x1A24, bytes([state]))
    left.close()
    del bench.board.commands[:]
    bench.open()
    assert bench.displaying
    assert next(number for read, number, _ in bench.board.commands if not read) == 0x1A24


def test_a_refused_command_is_one_sentence_and_leaves_nothing_open():
    bench = LightcrafterBench({9: lambda board: setattr(board.faults, "refuse_next", 1)})
    with pytest.raises(DeviceError, match=r"LightCrafter 4500: refuses command [0-9A-F]{4}.*; end other programs"):
        bench.open()
    assert not bench.displaying
    assert bench.board.is_kernel_driver_active(None, 0), "it was not given back"


def test_validation_is_waited_for():
    bench = LightcrafterBench(validate_s=1.5)
    bench.open()
    assert bench.displaying
    assert len(bench.sent(0x1A1A, read=True)) > 2


def test_validation_without_an_end_is_told():
    with pytest.raises(DeviceError, match="does not come to an end of checking its settings"):
        LightcrafterBench(validate_s=60.0).open()


def test_what_ti_only_warns_of_is_told_and_no_error():
    projector = LightcrafterBench().open()
    assert projector.warnings == ("there is no black after a pattern before an external trigger",)
    (shows, reserve) = health.checks({}, projector)
    assert shows.passed is True
    assert reserve.passed is None
    assert "no black after a pattern" in reserve.finding


def test_exposures_that_end_before_the_period_leave_room_for_black():
    assert LightcrafterBench().open(exposure_us=16000).warnings == ()


@pytest.mark.parametrize("lost", [0, 1])
def test_a_start_that_is_acknowledged_and_lost_is_made_again(lost):
    bench = LightcrafterBench(lost_starts=lost)
    bench.open()
    assert bench.displaying
    assert bench.sent(0x1A24).count(b"\2") == 1 + lost


def test_a_board_that_never_starts_is_told():
    with pytest.raises(DeviceError, match="does not start its patterns, told 2 times; switch it off and on"):
        LightcrafterBench(lost_starts=5).open()


@pytest.mark.parametrize("fault", [{"empty_reports": 3}, {"stale_reports": 3}, {"stale_reports": 40}])
def test_empty_and_late_reports_are_passed_over_at_every_command(fault):
    def spoil(board):
        for name, number in fault.items():
            setattr(board.faults, name, number)

    bench = LightcrafterBench(dict.fromkeys(range(200), spoil))
    projector = bench.open()
    projector.show(FULL)
    projector.confirm()
    assert bench.displaying


def test_a_late_report_that_comes_again_and_again_is_never_taken_for_an_answer():
    bench = LightcrafterBench()
    projector = bench.open()
    for _ in range(300):  # more than there are numbers for a command and its reply
        bench.faults.stale_reports = 2
        projector.confirm()


def test_late_reports_without_end_are_given_up():
    bench = LightcrafterBench()
    projector = bench.open()
    bench.faults.stale_for_ever = True
    began_s = bench.clock.now_s
    with pytest.raises(DeviceError, match="LightCrafter 4500: "):
        projector.confirm()
    assert bench.clock.now_s - began_s <= WITHIN_S


@pytest.mark.parametrize("number", range(0, 40, 3))
def test_a_board_that_falls_silent_is_told_within_3_s(number):
    silent_since = []

    def silence(board):
        board.faults.lost_replies = 10**6
        silent_since.append(bench.clock.now_s)

    bench = LightcrafterBench({number: silence})
    with pytest.raises(DeviceError, match=r"did not answer .* in time"):
        bench.open()
    assert bench.clock.now_s - silent_since[0] <= WITHIN_S


def test_a_read_whose_reply_is_lost_is_asked_again_and_a_write_is_not():
    bench = LightcrafterBench()
    projector = bench.open()
    bench.faults.lost_replies = 1
    projector.confirm()
    projector.close()
    link = UsbLink(bench.board, bench.clock)
    before = len(bench.sent(0x1A24))
    bench.faults.lost_replies = 1
    with pytest.raises(DeviceError, match="did not answer 1A24 in time"):
        link.write(0x1A24, b"\2")
    assert len(bench.sent(0x1A24)) == before + 1
    link.close()


def test_a_pulled_cable_is_told_at_once():
    bench = LightcrafterBench()
    projector = bench.open()
    bench.faults.unplugged = True
    began_s = bench.clock.now_s
    with pytest.raises(DeviceError, match="it is gone; plug it in and open it again"):
        projector.confirm()
    with pytest.raises(DeviceError, match="it is gone; plug it in and open it again"):
        projector.show(FULL)
    projector.close()
    assert bench.clock.now_s - began_s < 0.1


def test_the_kernels_driver_is_detached_and_gets_it_back():
    bench = LightcrafterBench()
    assert bench.board.is_kernel_driver_active(None, 0)
    projector = bench.open()
    assert not bench.board.is_kernel_driver_active(None, 0)
    projector.close()
    assert bench.board.is_kernel_driver_active(None, 0)
    bench.open()


def test_one_that_another_program_holds_is_busy(monkeypatch):
    def busy(*_):
        raise usb.core.USBError("busy", -6, errno.EBUSY)

    bench = LightcrafterBench()
    monkeypatch.setattr(bench.board, "claim_interface", busy)
    with pytest.raises(DeviceError, match="another program uses it; close that one"):
        bench.open()
    assert bench.board.is_kernel_driver_active(None, 0), "it was not given back"


def test_messages_of_several_reports_are_put_together():
    bench = LightcrafterBench()
    link = UsbLink(bench.board, bench.clock)
    lines = bytes(range(96))
    link.write(0x1A31, bytes([31, 1, 31, 0]))
    link.write(0x1A33, b"\2")
    link.write(0x1A32, b"\0")
    link.write(0x1A34, lines)
    assert bench.sent(0x1A34) == [lines]
    assert link.read(0x1A34, len(lines)) == lines


def test_closing_stops_it_and_asks_whether_it_has():
    bench = LightcrafterBench()
    projector = bench.open()
    del bench.board.commands[:]
    projector.close()
    assert not bench.displaying
    assert (False, 0x1A24, b"\0") in bench.board.commands
    assert (True, 0x1A24, b"") in bench.board.commands


def test_closing_stops_it_before_the_desktop_shows_where_the_window_was(monkeypatch):
    bench = LightcrafterBench()
    projector, displayed = bench.open(), []
    monkeypatch.setattr(bench.windows[0], "close", lambda: displayed.append(bench.displaying))
    projector.close()
    assert displayed == [False]


def test_closing_one_that_cannot_be_stopped_says_so_and_ends(caplog):
    bench = LightcrafterBench()
    projector = bench.open()
    bench.faults.lost_replies = 10**6
    began_s = bench.clock.now_s
    projector.close()
    assert "nobody can tell whether it is dark" in caplog.text
    assert bench.clock.now_s - began_s <= WITHIN_S
    assert not bench.displaying, "it was told to stop all the same"


FAULTS = {
    "lost": lambda number: lambda board: setattr(board.faults, "lost_replies", number),
    "empty": lambda number: lambda board: setattr(board.faults, "empty_reports", number),
    "late": lambda number: lambda board: setattr(board.faults, "stale_reports", number),
    "refused": lambda number: lambda board: setattr(board.faults, "refuse_next", number),
    "endless": lambda _: lambda board: setattr(board.faults, "stale_for_ever", True),
    "unplugged": lambda _: lambda board: setattr(board.faults, "unplugged", True),
    "stopped by another": lambda _: lambda board: board.controller.write(0x1A24, b"\0", board.now_s()),
    "no video": lambda _: lambda board: setattr(board.controller, "frame_s", None),
}


SCHEDULE = st.dictionaries(
    st.integers(0, 60), st.tuples(st.sampled_from(sorted(FAULTS)), st.integers(1, 5)), max_size=2
)


@settings(max_examples=400, deadline=None)
@given(SCHEDULE, SCHEDULE, st.booleans(), st.integers(0, 2), st.lists(st.sampled_from([DARK, FULL]), min_size=1))
def test_whatever_goes_wrong_on_the_cable_it_never_claims_what_is_not_shown_and_never_hangs(
    on_opening, afterwards, in_standby, lost_starts, shown
):
    def from_now(faults):
        now = bench.board.arrived
        bench.board.schedule = {now + at: FAULTS[kind](number) for at, (kind, number) in faults.items()}

    bench = LightcrafterBench(in_standby=in_standby, lost_starts=lost_starts)
    clock, began_s = bench.clock, bench.clock.now_s
    from_now(on_opening)
    try:
        projector = bench.open()
    except DeviceError:
        event("refused on opening")
        assert clock.now_s - began_s < 15.0
        assert bench.faults.unplugged or bench.board.is_kernel_driver_active(None, 0)
        return
    assert clock.now_s - began_s < 15.0
    from_now(afterwards)
    for pattern in shown:
        began_s = clock.now_s
        try:
            flip = projector.show(pattern)
            projector.confirm()
        except DeviceError:
            event("refused to claim")
            assert clock.now_s - began_s <= 2 * WITHIN_S
            break
        event("shown")
        assert bench.displaying
        assert flip.pattern_hash == bench.windows[-1].shows == pattern.hash
    began_s = clock.now_s
    projector.close()
    assert clock.now_s - began_s <= WITHIN_S
    assert bench.faults.unplugged or bench.board.is_kernel_driver_active(None, 0)
    if not bench.faults.unplugged and not on_opening and not afterwards:
        assert not bench.displaying
