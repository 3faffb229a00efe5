"""The stand-in for a Cavro against its manual: bytes and times in, bytes and motion out; no driver takes part."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.cavro.emulator.core import SPEED_CODES, XCALIBUR, XLP, Core, Habits, Model
from drivers.cavro.emulator.frames import Command

MODELS = [pytest.param(XCALIBUR, id="xcalibur"), pytest.param(XLP, id="xlp")]


class Cavro:
    """A pump on the bench: its own clock, and what really left the output."""

    def __init__(self, model: Model = XCALIBUR, *, ready: bool = True, jams_after: int | None = None, **habits: object):
        self.expelled, self.pulses, self.now_s, self._sequence = 0, 0, 0.0, 0
        self._jams_after = jams_after
        settled = Habits(model, **{"speeds_interact": True, **habits})
        self.core = Core(self._pulse, self._expel, lambda: 24, ready, settled)

    def _pulse(self) -> bool:
        self.pulses += 1
        return self._jams_after is None or self.pulses <= self._jams_after

    def _expel(self, fine: int) -> None:
        self.expelled += fine

    def send(self, text: str, *, after_s: float = 0.0) -> tuple[int, str]:
        """Error and data of the answer to a new command, `after_s` later."""
        self.now_s += after_s
        self._sequence = self._sequence % 7 + 1
        return self.send_block(self._sequence, text)

    def send_block(self, sequence: int, text: str, *, repeated: bool = False) -> tuple[int, str]:
        status, data = self.core.obey(Command(1, sequence, repeated, text), self.now_s)
        return status & 0x0F, data

    @property
    def ready(self) -> bool:
        """What `Q` says; it clears an error, so ask for that first."""
        self._sequence = self._sequence % 7 + 1
        return bool(self.core.obey(Command(1, self._sequence, False, "Q"), self.now_s)[0] & 0x20)

    def takes(self, text: str, most_s: float = 100.0) -> float:
        """How long it is busy with a program, s (to 1 ms)."""
        assert self.send(text)[0] == 0
        began_s = self.now_s
        while not self.ready:
            self.now_s += 0.001
            assert self.now_s - began_s < most_s
        return self.now_s - began_s


# -- speeds and durations ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("settings", "pulses", "duration_s"),
    [
        ("v900V900c900L14", 6000, 6.667),  # manual B.2.2, case 1
        ("v50V5800c500L14", 6000, 1.185),  # case 2 (the manual adds rounded parts: 1.18)
        ("v50V5800c900L14", 10, 0.023),  # case 3
        ("v50V5800c900L14", 700, 0.258),  # case 4
    ],
)
def test_a_dispense_takes_as_long_as_the_manual_calculates(
    model: Model, settings: str, pulses: int, duration_s: float
) -> None:
    pump = Cavro(model)
    pump.send(settings + "OR")
    pump.now_s += 1.0
    assert pump.takes(f"D{pulses // model.pulses}R") == pytest.approx(duration_s, abs=0.003)
    assert pump.expelled == pulses * 8 // model.pulses


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(("code", "stroke_s"), [(11, 4.30), (12, 5.00), (13, 6.00), (15, 10.0), (17, 30.0)])
def test_speed_codes_take_the_seconds_of_the_manuals_table(model: Model, code: int, stroke_s: float) -> None:
    pump = Cavro(model)
    pump.send("OR")
    pump.now_s += 1.0
    assert pump.takes(f"S{code}A0R") == pytest.approx(stroke_s, rel=0.01)


def test_an_xlp_behind_an_xcaliburs_rig_file_moves_half_and_twice_as_fast_per_increment() -> None:
    moved = {}
    for model in (XCALIBUR, XLP):
        pump = Cavro(model)
        pump.send("v100V600OR")
        pump.now_s += 1.0
        duration_s = pump.takes("D600R")
        moved[model.name] = (pump.expelled / (8 * model.increments), duration_s)
        assert pump.send("&")[1] == model.firmware
    assert moved["xlp"][0] == moved["xcalibur"][0] / 2
    assert moved["xlp"][1] == pytest.approx(moved["xcalibur"][1] / 2, rel=0.05)


def test_start_and_cutoff_above_the_top_speed_become_equal_to_it() -> None:
    pump = Cavro()
    pump.send("V400R")
    pump.send("v850R")
    pump.send("c900R")
    assert [pump.send(f"?{n}")[1] for n in (1, 2, 3)] == ["400", "400", "400"]
    pump.send("V1000R")
    assert [pump.send(f"?{n}")[1] for n in (1, 2, 3)] == ["400", "1000", "400"]


def test_a_lower_top_speed_only_hides_the_start_speed_and_a_speed_code_changes_it() -> None:
    pump = Cavro()
    pump.send("v750V1200c1200R")
    pump.send("V100R")
    assert [pump.send(f"?{n}")[1] for n in (1, 3)] == ["100", "100"]
    pump.send("V1200R")
    assert pump.send("?1")[1] == "750", "the stored start speed is not modified (3.5.4, rule 2)"
    pump.send("S27R")
    pump.send("V1200R")
    assert pump.send("?1")[1] == str(SPEED_CODES[27]) == "100"


@settings(deadline=None)
@given(st.lists(st.tuples(st.sampled_from("vVc"), st.integers(0, 7000)) | st.tuples(st.just("S"), st.integers(0, 50))))
def test_speeds_stay_in_order_and_in_range_whatever_is_asked(settings: list[tuple[str, int]]) -> None:
    ranges = {"v": (50, 1000), "V": (5, 6000), "c": (50, 2700), "S": (0, 40)}
    pump = Cavro()
    for letter, value in settings:
        error = pump.send(f"{letter}{value}R")[0]
        assert (error == 3) == (not ranges[letter][0] <= value <= ranges[letter][1])
        v, top, c = (int(pump.send(f"?{n}")[1]) for n in (1, 2, 3))
        assert v <= c <= top


@pytest.mark.parametrize("rounding", [-1, 1])
def test_reported_speeds_may_be_rounded_but_not_the_speed_itself(rounding: int) -> None:
    pump, exact = Cavro(speed_rounding=rounding), Cavro()
    assert pump.send("?2")[1] == str(1400 + rounding)
    assert pump.takes("OA0R") == exact.takes("OA0R")


def test_the_top_speed_changes_on_the_fly_only_without_ramps_and_for_this_move() -> None:
    pump = Cavro()
    pump.send("v100V100c100OR", after_s=1.0)
    pump.send("D100R", after_s=1.0)
    assert pump.send("V600R", after_s=1.0)[0] == 0
    pump.now_s += 100 / 600 + 0.01
    assert pump.ready
    assert pump.send("?2")[1] == "100"


# -- programs, T and R -------------------------------------------------------------------------------------------------


def test_r_after_t_goes_on_to_the_old_target() -> None:
    pump = Cavro()
    pump.send("OR", after_s=1.0)
    pump.send("A0R", after_s=1.0)
    pump.send("T", after_s=1.0)
    at, truth = int(pump.send("?")[1]), pump.expelled
    assert 0 < at < 3000
    assert truth < (3000 - at) * 8, "increments are lost that were counted"
    assert pump.ready
    assert pump.send("?", after_s=20.0)[1] == str(at)
    pump.send("R")
    assert not pump.ready
    assert pump.send("?", after_s=20.0)[1] == "0"
    assert pump.expelled > truth


def test_a_new_program_replaces_a_terminated_one() -> None:
    pump = Cavro()
    pump.send("OA0R", after_s=1.0)
    pump.send("T", after_s=1.0)
    pump.send("V1400R")
    at = pump.send("?")[1]
    pump.send("R")
    assert pump.send("?", after_s=20.0)[1] == at


def test_t_does_not_end_a_valve_move_and_the_rest_of_the_program_waits_for_r() -> None:
    pump = Cavro()
    pump.send("OA2000R")
    pump.send("T", after_s=0.05)
    assert pump.send("?6", after_s=5.0)[1] == "o"
    assert pump.send("?")[1] == "3000"
    pump.send("R")
    assert pump.send("?", after_s=5.0)[1] == "2000"


def test_a_program_without_r_is_loaded_and_executed_once_by_r() -> None:
    pump = Cavro()
    pump.send("OD100")
    assert pump.send("F")[1] == "1"
    assert pump.send("?", after_s=5.0)[1] == "3000"
    pump.send("R")
    assert (pump.send("?", after_s=5.0)[1], pump.send("F")[1]) == ("2900", "0")
    pump.send("R")
    assert pump.send("?", after_s=5.0)[1] == "2900"
    pump.send("X")
    assert pump.send("?", after_s=5.0)[1] == "2800"


@pytest.mark.parametrize("interrupted", ["HA1000R", "M20000A1000R"])
def test_what_goes_on_after_r_takes_its_time_from_then(interrupted: str) -> None:
    pump = Cavro()
    pump.send("OR", after_s=1.0)
    pump.send(interrupted, after_s=1.0)
    pump.send("T" if interrupted[0] == "M" else "Q", after_s=10.0)
    pump.send("R", after_s=50.0)
    assert not pump.ready
    assert int(pump.send("?", after_s=1.0)[1]) == pytest.approx(3000 - 700, abs=20)
    assert pump.send("?", after_s=5.0)[1] == "1000"


@pytest.mark.parametrize(("loop", "position"), [("A1000gD10G5R", 950), ("A1000gP50gP100D100G10G5R", 1250)])
def test_loops_repeat_as_often_as_they_say(loop: str, position: int) -> None:
    pump = Cavro()
    pump.send("OR", after_s=1.0)
    pump.send(loop, after_s=1.0)
    assert pump.send("?", after_s=200.0)[1] == str(position)


def test_steps_of_a_program_follow_each_other_at_their_true_times_however_rarely_it_is_looked_at() -> None:
    often, rarely = Cavro(), Cavro()
    program = "IA1000M500OA500gD10G3R"
    took_s = often.takes(program)
    rarely.send(program)
    rarely.now_s += took_s + 0.002
    assert rarely.ready
    assert rarely.expelled == often.expelled == (500 + 30) * 8


# -- errors ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "immediate", "queried", "position"),
    [
        ("A4000R", 3, 0, 3000),  # the manual's examples, p. 3-52
        ("A2000A3500R", 0, 3, 2000),
        ("E2000R", 2, 0, 3000),
        ("A2000E2000R", 2, 0, 3000),
        ("P200R", 3, 0, 3000),
        ("D3001R", 3, 0, 3000),
        ("P150R", 0, 0, 3150),
    ],
)
def test_errors_come_at_the_time_that_the_manual_says(text: str, immediate: int, queried: int, position: int) -> None:
    pump = Cavro()
    assert pump.send(text)[0] == immediate
    assert pump.send("Q", after_s=10.0)[0] == queried
    assert pump.send("Q")[0] == 0
    assert pump.send("?")[1] == str(position)


def test_the_plunger_does_not_move_in_bypass() -> None:
    pump = Cavro()
    pump.send("BR", after_s=1.0)
    assert pump.send("A1000R", after_s=1.0)[0] == 11
    assert pump.send("Q")[0] == 0


@pytest.mark.parametrize(("text", "error"), [("A5R", 15), ("IR", 15), ("v100R", 15), ("c100R", 15), ("V100R", 0)])
def test_a_moving_pump_takes_nothing_but_a_top_speed(text: str, error: int) -> None:
    pump = Cavro()
    pump.send("OA0R")
    assert pump.send(text, after_s=1.0)[0] == error
    assert pump.send("?", after_s=20.0)[1] == "0"


def test_before_initialising_nothing_moves_and_q_says_so() -> None:
    pump = Cavro(ready=False)
    assert pump.send("Q")[0] == 7
    for move in ("A100R", "IR", "OR"):
        assert pump.send(move)[0] == 7
    pump.send("ZR")
    assert not pump.ready
    pump.now_s += 2.0
    assert pump.send("Q")[0] == 0


def test_initialising_a_full_syringe_takes_its_stroke_at_500_pulses_a_second() -> None:
    assert Cavro().takes("ZR") == pytest.approx(6000 / 500 + 1.0, abs=0.01)


@pytest.mark.parametrize("stays", [False, True])
def test_after_an_overload_nothing_moves_until_initialised(stays: bool) -> None:
    pump = Cavro(jams_after=100, overload_stays=stays)
    pump.send("OA0R")
    assert pump.send("Q", after_s=5.0)[0] == 9
    assert pump.send("Q")[0] == (9 if stays else 0)
    assert pump.send("A10R")[0] == 9
    assert pump.send("IR")[0] == 9
    pump.send("ZR")
    assert pump.send("Q", after_s=20.0)[0] == 0


# -- the block's number ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flag_decides", [False, True])
def test_a_repeated_block_is_acknowledged_and_not_obeyed_again(flag_decides: bool) -> None:
    pump = Cavro(repeat_flag_decides=flag_decides)
    pump.send("OR", after_s=1.0)
    pump.now_s += 1.0
    pump.send_block(5, "D100R")
    pump.now_s += 5.0
    pump.send_block(5, "D100R", repeated=True)
    pump.now_s += 5.0
    assert pump.send("?")[1] == "2900"


@pytest.mark.parametrize(("flag_decides", "position"), [(False, "2900"), (True, "2800")])
def test_an_unflagged_block_with_a_known_number(flag_decides: bool, position: str) -> None:
    pump = Cavro(repeat_flag_decides=flag_decides)
    pump.send("OR", after_s=1.0)
    for _ in range(2):
        pump.now_s += 5.0
        pump.send_block(5, "D100R")
    assert pump.send("?", after_s=5.0)[1] == position


def test_a_flagged_block_that_the_pump_never_had_is_obeyed() -> None:
    pump = Cavro()
    pump.send_block(4, "Q")
    pump.send_block(5, "OD100R", repeated=True)
    assert pump.send("?", after_s=5.0)[1] == "2900"


@settings(deadline=None)
@given(
    st.lists(st.sampled_from(["D100R", "P50R", "A2000R", "A0R", "T", "R", "V300R", "S20R", "OR", "IR", "N1R", "N0R"])),
    st.lists(st.floats(0.0, 3.0), min_size=1),
)
def test_the_plunger_stays_in_the_syringe_and_expels_only_what_it_counts(texts: list[str], pauses: list[float]) -> None:
    pump = Cavro()
    for i, text in enumerate(texts):
        pump.send(text, after_s=pauses[i % len(pauses)])
        assert 0 <= pump.core.believed()["position"] <= 3150 * 8
    assert pump.expelled <= pump.pulses * 8
    assert math.isfinite(pump.now_s)
