"""The pumps' stand-ins against their manuals: bytes and times in, bytes and motion out; no driver takes part."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import usb.core
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.cavro.emulator.core import SPEED_CODES, XCALIBUR, XLP, Habits, Model
from drivers.cavro.emulator.core import Core as CavroCore
from drivers.cavro.emulator.frames import Command
from drivers.lightcrafter4500.emulator.backend import LightcrafterOnBus
from drivers.lightcrafter4500.emulator.controller import Controller
from drivers.lightcrafter4500.emulator.controller import Habits as LightCrafterHabits
from drivers.new_era.emulator.core import Core as NewEraCore
from drivers.new_era.emulator.core import Habits as NewEraHabits
from drivers.new_era.emulator.core import Syringe
from drivers.new_era.emulator.frames import DAMAGED, Reader, crc, safe
from drivers.rig_doser.emulator.firmware import Firmware
from drivers.rig_doser.emulator.frames import Request, RequestReader, framed
from drivers.rig_doser.emulator.memory import Commissioning, Record, StateFile

MODELS = [pytest.param(XCALIBUR, id="xcalibur"), pytest.param(XLP, id="xlp")]


class Cavro:
    """A pump on the bench: its own clock, and what really left the output."""

    def __init__(self, model: Model = XCALIBUR, *, ready: bool = True, jams_after: int | None = None, **habits: object):
        self.expelled, self.pulses, self.now_s, self._sequence = 0, 0, 0.0, 0
        self._jams_after = jams_after
        settled = Habits(model, **{"speeds_interact": True, **habits})
        self.core = CavroCore(self._pulse, self._expel, lambda: 24, ready, settled)

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


# -- Cavro: speeds and durations ---------------------------------------------------------------------------------------


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


# -- Cavro: programs, T and R ------------------------------------------------------------------------------------------


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


# -- Cavro: errors -----------------------------------------------------------------------------------------------------


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


# -- Cavro: the block's number -----------------------------------------------------------------------------------------


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


# -- New Era -----------------------------------------------------------------------------------------------------------


class NewEra:
    """A pump on the bench with a syringe of 12 mm, 20 steps a µl; its memory outlives its power."""

    def __init__(self, memory: dict[str, Any] | None = None, *, counter_survives: bool = False, **habits: Any) -> None:
        self.memory = {} if memory is None else memory
        self.pushed, self.now_s, self._counter_survives = 0, 0.0, counter_survives
        self._habits = NewEraHabits(**{"checks_rates": True, **habits})
        self.power_up()

    def power_up(self) -> None:
        """A new life on the same memory; the time goes on."""
        self.core = NewEraCore(
            self.memory,
            lambda: None,
            self._pulse,
            syringe=Syringe(20.0, 12.0),
            nearest=True,
            counter_survives=self._counter_survives,
            habits=self._habits,
        )

    def _pulse(self) -> bool:
        self.pushed += 1
        return True

    def send(self, text: str, *, after_s: float = 0.0) -> str | None:
        self.now_s += after_s
        self.core.advance(self.now_s)
        return self.core.obey(text, self.now_s)

    def programmed(self, volume: str = "100.0", rate: str = "600.0UM") -> "NewEra":
        """Alarm acknowledged, phase 1 to a volume, phase 2 stops."""
        assert self.send("") == "00A?R"
        for text in ("PHN2", "FUNSTP", "PHN1", "FUNRAT", f"RAT{rate}", f"VOL{volume}", "DIRINF", "CLDINF"):
            assert self.send(text) == "00S", text
        return self


def test_power_failure_mode_doses_again_by_itself_and_the_alarm_comes_too_late() -> None:
    pump = NewEra(power_failure=True).programmed()
    assert pump.send("PF") == "00S1"
    pump.send("RUN")
    pump.core.advance(8.0)
    first = pump.pushed
    assert 0 < first < 2000
    pump.now_s = 10.0
    pump.power_up()
    pump.core.advance(10.0)
    pump.core.advance(40.0)
    assert pump.pushed == first + 2000, "the whole program again, on top of what was delivered"
    assert pump.send("", after_s=40.0) == "00A?R"
    assert pump.send("") == "00S"


def test_with_power_failure_mode_off_a_power_cut_ends_the_dose() -> None:
    pump = NewEra(power_failure=True).programmed()
    assert pump.send("PF0") == "00S"
    assert pump.send("PF") == "00S0"
    pump.send("RUN")
    pump.core.advance(5.0)
    first = pump.pushed
    pump.power_up()
    pump.core.advance(60.0)
    assert pump.pushed == first


def test_a_program_that_had_ended_does_not_start_again_when_power_comes_back() -> None:
    pump = NewEra(power_failure=True).programmed()
    pump.send("RUN")
    pump.send("", after_s=30.0)
    pump.power_up()
    pump.core.advance(90.0)
    assert pump.pushed == 2000


def test_a_pump_without_power_failure_mode_says_so() -> None:
    assert NewEra(knows_power_failure=False).programmed().send("PF") == "00S?"
    assert NewEra().programmed().send("PF2") == "00S?OOR"


@pytest.mark.parametrize("ignored", [0, 1, 3])
def test_the_first_commands_after_power_up_are_lost_or_answered_by_the_alarm(ignored: int) -> None:
    pump = NewEra(ignored_first=ignored)
    answers = [pump.send("SAF3") for _ in range(ignored + 2)]
    assert answers == [None] * ignored + ["00A?R", "00S"]
    assert pump.core.safe_mode


@pytest.mark.parametrize(
    ("diameter", "rate", "answer"),
    [
        ("12.06", "5.800MM", "00S"),
        ("12.06", "5.900MM", "00S?OOR"),
        ("26.59", "1699MH", "00S"),  # the manual's largest rate
        ("26.59", "1710MH", "00S?OOR"),
        ("4.699", "0.731UH", "00S"),  # and its smallest
        ("4.699", "0.729UH", "00S?OOR"),
    ],
)
def test_a_rate_out_of_range_is_refused_when_it_is_set(diameter: str, rate: str, answer: str) -> None:
    pump = NewEra().programmed()
    pump.send(f"DIA{diameter}")
    assert pump.send(f"RAT{rate}") == answer


def test_a_rate_that_a_new_diameter_puts_out_of_range_does_not_start() -> None:
    pump = NewEra().programmed(rate="5.000MM")
    assert pump.send("DIA5.000") == "00S"
    assert pump.send("RUN") == "00S?OOR"
    pump.core.advance(60.0)
    assert pump.pushed == 0


@pytest.mark.parametrize("number", ["9.9996", "12.345", "0.1234", "12345", "1e3", "1,5", "-1", "", "."])
def test_numbers_of_more_than_four_digits_or_three_decimals_are_refused(number: str) -> None:
    pump = NewEra().programmed()
    before = pump.send("VOL")
    assert pump.send(f"VOL{number}") != "00S"
    assert pump.send("VOL") == before


@settings(deadline=None)
@given(st.integers(0, 9999), st.integers(0, 3))
def test_every_number_of_four_digits_and_three_decimals_is_taken(digits: int, decimals: int) -> None:
    text = f"{digits:04d}"
    pump = NewEra().programmed()
    assert pump.send(f"VOL{text[: 4 - decimals]}.{text[4 - decimals :]}") == "00S"


def test_volume_zero_pumps_for_ever() -> None:
    pump = NewEra().programmed(volume="0")
    pump.send("RUN")
    assert pump.send("", after_s=3600.0) == "00I"
    assert pump.pushed == 3600 * 200


def test_the_first_stop_pauses_run_resumes_and_the_second_stop_resets() -> None:
    pump = NewEra().programmed()
    pump.send("RUN")
    assert pump.send("STP", after_s=2.0) == "00P"
    assert pump.send("RUN", after_s=5.0) == "00I"
    assert pump.send("STP", after_s=2.0) == "00P"
    assert pump.send("STP") == "00S"
    assert pump.send("STP") == "00S?NA"
    assert pump.pushed == 4 * 200
    pump.send("RUN")
    pump.send("", after_s=30.0)
    assert pump.pushed == 4 * 200 + 2000


def test_the_watchdog_sounds_when_idle_too_and_starts_again_only_with_a_valid_packet() -> None:
    pump = NewEra().programmed()
    pump.send("SAF3")
    pump.core.advance(2.9)
    assert not pump.core.believed()["buzzer"]
    pump.core.advance(3.1)
    believed = pump.core.believed()
    assert believed["buzzer"]
    assert believed["alarms"]["T"] == 1
    assert pump.core.unasked == ["00A?T"]
    pump.core.advance(60.0)
    assert pump.core.believed()["alarms"]["T"] == 1
    assert pump.send("", after_s=60.0) == "00A?T"
    pump.core.advance(64.0)
    assert pump.core.believed()["alarms"]["T"] == 2


def test_a_watchdog_is_kept_over_power_loss_and_unarmed_until_the_first_packet() -> None:
    pump = NewEra().programmed()
    pump.send("SAF3")
    pump.power_up()
    assert pump.core.unasked == ["00A?R"]
    pump.core.advance(100.0)
    assert "T" not in pump.core.believed()["alarms"]


def test_a_new_diameter_clears_the_counter_and_sets_the_unit() -> None:
    pump = NewEra().programmed()
    pump.send("RUN")
    assert pump.send("DIS", after_s=30.0) == "00SI100.0W0.000UL"
    assert pump.send("CLDWDR") == "00S"
    assert pump.send("DIS") == "00SI100.0W0.000UL"
    pump.send("DIA20.00")
    assert pump.send("DIS") == "00SI0.000W0.000ML"
    pump.send("VOLUL")
    assert pump.send("VOL") == "00S100.0UL"


def test_what_is_withdrawn_is_counted_for_itself() -> None:
    pump = NewEra().programmed()
    pump.send("DIRWDR")
    assert pump.send("RUN") == "00W"
    assert pump.send("DIS", after_s=30.0) == "00SI0.000W100.0UL"
    assert pump.pushed == 0


def test_a_rate_set_while_pumping_acts_at_once_and_is_not_stored() -> None:
    pump = NewEra().programmed(volume="0")
    pump.send("RUN")
    assert pump.send("RAT60.00", after_s=1.0) == "00I"
    assert pump.send("RAT") == "00I60.00UM"
    assert pump.send("RAT50.00UM") == "00I?NA"
    pump.send("STP", after_s=10.0)
    assert pump.pushed == 200 + 200
    pump.send("STP")
    assert pump.send("RAT") == "00S600.0UM"


def test_phases_pause_jump_and_run_off_the_end() -> None:
    pump = NewEra().programmed()
    for text in ("PHN2", "FUNPAS5", "PHN3", "FUNJMP41", "PHN41", "VOL10.0"):
        assert pump.send(text) == "00S"
    pump.send("RUN")
    assert pump.send("", after_s=12.0) == "00T"
    assert pump.send("", after_s=60.0) == "00A?O"
    assert pump.pushed == 2000 + 200


def test_a_stop_in_a_pause_phase_and_run_again_pumps_nothing_more() -> None:
    pump = NewEra().programmed()
    for text in ("PHN2", "FUNPAS5", "PHN3", "FUNSTP"):
        assert pump.send(text) == "00S"
    pump.send("RUN")
    assert pump.send("STP", after_s=12.0) == "00P"
    assert pump.send("RUN", after_s=1.0) == "00T"
    assert pump.send("", after_s=20.0) == "00S"
    assert pump.pushed == 2000


def test_a_damaged_packet_is_answered_where_the_pump_does_that() -> None:
    packet = bytearray(safe("00RUN"))
    packet[4] ^= 1
    assert Reader().feed(bytes(packet), 0.0, True) is None
    assert Reader(tells_damage=True).feed(bytes(packet), 0.0, True) == DAMAGED
    pump = NewEra()
    assert pump.core.obey(DAMAGED, 0.0) == "00S?COM"
    assert pump.send("") == "00A?R", "it did not acknowledge the alarm"


@pytest.mark.parametrize("length", range(3, 20))
def test_bytes_03_inside_a_packet_do_not_end_it(length: int) -> None:
    text = next(t for i in range(100_000) if 3 in crc((t := f"{i:0{length}d}"[:length]).encode()).to_bytes(2, "big"))
    reader = Reader()
    packet = safe(text)
    assert [reader.feed(packet[i : i + 1], 0.1 * i, True) for i in range(len(packet))][-1] == text


def test_basic_mode_drops_control_characters_and_knows_no_time_out() -> None:
    reader = Reader()
    assert reader.feed(b"\x02d i", 0.0, False) is None
    assert reader.feed(b"a 12\n\r", 60.0, False) == "dia12"


# -- the rig's own doser -----------------------------------------------------------------------------------------------

PAGE = Path(__file__).parents[1] / "firmware_notes" / "rig_doser.md"


class RigDoser:
    """A board on the bench: memory, a shaft that can jam, its own clock; what really was pushed."""

    def __init__(self, path: Path, protocol: int) -> None:
        self.state, self.protocol = StateFile(path, Commissioning("TD000007", 50_000, 10_000_000)), protocol
        self.now_s, self.pushed, self._jams_at, self._asked = 0.0, 0, math.inf, 0
        self.reset()

    def reset(self) -> None:
        self.firmware = Firmware(self.state, 2000.0, 8000.0, self._pulse, self.protocol)
        self.reader = RequestReader(self.protocol)

    def board(self, **record: int) -> None:
        self.state.save(Record(**record))
        self.reset()
        self.firmware.record.boots = 0

    def _pulse(self) -> bool:
        if self.pushed >= self._jams_at:
            return False
        self.pushed += 1
        return True

    def jam(self, steps: int) -> None:
        self._jams_at = self.pushed + steps

    def wait(self, seconds: float) -> None:
        self.now_s += seconds
        self.firmware.advance(self.now_s)

    def send(self, text: str) -> str:
        """What a frame with a right CRC is answered by, without CRC; "nothing" where there is no reply."""
        replies = [
            self.firmware.answer(item, self.now_s).decode().partition("*")[0]
            for item in self.reader.feed(framed(text), self.now_s)
            if isinstance(item, Request)
        ]
        return " ".join(replies) or "nothing"

    def ask(self, text: str) -> str:
        self._asked = (self._asked + 1) % 256
        return self.send(f">{self._asked:02X}{text}")[3:]

    def play(self, line: str) -> None:
        """A line of an exchange that is no frame."""
        word, *arguments = line.split()
        if word == "board":
            self.board(**{key: int(value) for key, value in (argument.split("=") for argument in arguments)})
        elif word == "stop":
            for _ in range(int(arguments[0]) if arguments else 1):
                self.firmware.stop(self.now_s)
        elif word == "forget":
            self.state.forget()
            self.reset()
        elif word == "wait":
            self.wait(float(arguments[0]))
        elif word == "jam":
            self.jam(int(arguments[0]))
        else:
            assert word == "reset", line
            self.reset()


def exchanges() -> Iterator[Any]:
    """The page's exchanges, each for both versions."""
    blocks = PAGE.read_text().split("    exchange ")[1:]
    for i, block in enumerate(blocks):
        number, *lines = block.partition("\n\n")[0].splitlines()
        for protocol in (1, 2):
            yield pytest.param(protocol, [line.strip() for line in lines], id=f"{number}-{i}-{protocol:02d}")


@pytest.mark.parametrize(("protocol", "lines"), list(exchanges()))
def test_the_board_answers_as_on_its_page(tmp_path: Path, protocol: int, lines: list[str]) -> None:
    doser, reply, checked = RigDoser(tmp_path / "state", protocol), "", 0
    for line in lines:
        if line.startswith(">"):
            reply = doser.send(line)
        elif line.startswith(("both ", "01 ", "02 ")):
            version, expected = line.split()
            if version in ("both", f"{protocol:02d}"):
                assert reply == expected
                checked += 1
        else:
            doser.play(line)
    assert checked == sum(line.startswith(">") for line in lines)


def test_the_page_decides_all_eleven_questions() -> None:
    numbers = {int(block.split()[0]) for block in PAGE.read_text().split("    exchange ")[1:]}
    assert numbers == set(range(1, 12))


@pytest.mark.parametrize("protocol", [1, 2])
def test_banner_and_identity_name_the_version(tmp_path: Path, protocol: int) -> None:
    doser = RigDoser(tmp_path / "state", protocol)
    assert doser.firmware.banner().startswith(b"!TANKRIG-DOSER %02X TD000007 0001*" % protocol)
    assert doser.ask("I").startswith(f"I{protocol:02X}TD000007")


@pytest.mark.parametrize("protocol", [1, 2])
@pytest.mark.parametrize("length", [96, 97])
def test_a_frame_has_96_characters_without_its_line_feed(tmp_path: Path, protocol: int, length: int) -> None:
    doser = RigDoser(tmp_path / "state", protocol)
    assert doser.send(">01S" + "0" * (length - 9)) == ("<01E02" if length == 96 else "nothing")


def test_in_version_02_no_late_copy_of_a_clear_or_a_persons_word_undoes_what_came_later(tmp_path: Path) -> None:
    doser = RigDoser(tmp_path / "state", 2)
    doser.board(count=600, doubt=1, life=600, dose_id=5, target=900, flags=6, reason=4, stops=3)
    clear, word = "C0003", "Z000002570003"
    assert doser.ask(word).startswith("S02")
    assert doser.ask(clear).startswith("S00")
    doser.ask("D0000000600002000")
    doser.wait(3.0)
    stopped = doser.ask("S")
    assert stopped.startswith("S0203"), "the watchdog stopped it"
    assert doser.ask(clear) == doser.ask(word) == "E0B"
    assert doser.ask("S") == stopped


RECORDS = st.fixed_dictionaries({"life": st.integers(0, 10_000_000), "stops": st.integers(0, 0xFFFF)})
ORDERS = st.sampled_from(["D", "D", "D again", "C", "C old", "Z", "Z old", "S", "I", "stop", "wait", "reset", "jam"])


@pytest.mark.parametrize("protocol", [1, 2])
@settings(deadline=None)
@given(orders=st.lists(st.tuples(ORDERS, st.integers(0, 3000)), max_size=30), record=RECORDS)
def test_the_plunger_is_always_between_count_less_doubt_and_count(
    tmp_path_factory: pytest.TempPathFactory, protocol: int, orders: list[tuple[str, int]], record: dict[str, int]
) -> None:
    doser = RigDoser(tmp_path_factory.mktemp("doser") / "state", protocol)
    doser.board(**record)
    state, copies, next_id, intended = doser.firmware.record, dict[str, str](), 1, 0
    for order, number in orders:
        record_now = doser.firmware.record
        if order == "D":
            target = record_now.count + number
            copies["D"] = f"D{next_id:08X}{target:08X}"
            next_id += 1
        if order in ("D", "D again") and "D" in copies:  # a copy of a refused one may be accepted later
            if doser.ask(copies["D"]).startswith("S"):
                intended = max(intended, int(copies["D"][9:], 16))
        elif order == "C":
            copies["C"] = f"C{record_now.stops:04X}"
            doser.ask(copies["C"])
        elif order == "Z" and not doser.firmware.moving:
            suffix = f"{record_now.stops:04X}" if protocol == 2 else ""
            copies["Z"] = f"Z{doser.pushed:08X}{suffix}"
            doser.ask(copies["Z"])
        elif order in ("C old", "Z old") and order[0] in copies and protocol == 2:
            doser.ask(copies[order[0]])
        elif order in ("S", "I"):
            doser.ask(order)
        elif order in ("stop", "reset"):
            doser.play(order)
        elif order == "wait":
            doser.wait(number / 1000)
        elif order == "jam":
            doser.jam(number)
        state = doser.firmware.record
        assert state.count - state.doubt <= doser.pushed <= state.count
        assert doser.pushed <= intended
    doser.state.close()


# -- LightCrafter 4500 -------------------------------------------------------------------------------------------------


class LightCrafter:
    """A board on the bus of the real pyusb; time goes on while a read waits, and when a test says so."""

    def __init__(self, **habits: Any) -> None:
        self.now_s, self.edges = 0.0, list[tuple[int, float]]()
        self.controller = Controller(
            LightCrafterHabits(**habits), lambda output, at_s: self.edges.append((output, at_s))
        )
        self.board = LightcrafterOnBus(self.controller, clock=lambda: self.now_s, sleep=self.wait)
        device = usb.core.find(idVendor=0x0451, idProduct=0x6401, backend=self.board)
        assert device is not None
        self.device, self._sequence = device, 0
        device.detach_kernel_driver(0)
        device.set_configuration()

    def wait(self, seconds: float) -> None:
        self.now_s += seconds

    def send(self, flags: int, command: int, data: bytes = b"") -> None:
        self._sequence = (self._sequence + 1) % 256
        message = bytes([flags, self._sequence, *(2 + len(data)).to_bytes(2, "little"), *command.to_bytes(2, "little")])
        message += data
        for start in range(0, len(message), 64):
            self.device.write(0x01, message[start : start + 64].ljust(64, b"\0"))

    def reply(self) -> bytes:
        return bytes(self.device.read(0x81, 64, timeout=500))

    def write(self, command: int, *data: int) -> bool:
        """Whether it was acknowledged and not refused."""
        self.send(0x40, command, bytes(data))
        reply = self.reply()
        assert reply[1] == self._sequence
        return not reply[0] & 0x20

    def read(self, command: int) -> bytes:
        self.send(0xC0, command)
        reply = self.reply()
        assert reply[1] == self._sequence
        assert not reply[0] & 0x20
        return reply[4 : 4 + int.from_bytes(reply[2:4], "little")]

    def configure(
        self,
        *entries: int,
        exposure_us: int = 16667,
        period_us: int = 16667,
        source: int = 0,
        trigger_mode: int = 0,
        repeat: int = 1,
    ) -> None:
        """Locked to its video, pattern mode, and a table; neither validated nor started."""
        assert self.write(0x1A00, 0)
        self.wait(1.0)
        assert self.write(0x1A1B, 1)
        self.wait(1.0)
        assert self.read(0x1A1B) == b"\1"
        assert self.write(0x1A22, source)
        assert self.write(0x1A23, trigger_mode)
        assert self.write(0x1A29, *exposure_us.to_bytes(4, "little"), *period_us.to_bytes(4, "little"))
        assert self.write(0x1A31, len(entries) - 1, repeat, len(entries) - 1, 0)
        assert self.write(0x1A33, 2)
        assert self.write(0x1A32, 0)
        assert self.write(0x1A34, *b"".join(entry.to_bytes(3, "little") for entry in entries))
        assert self.write(0x1A33, 0)

    def validate(self) -> int:
        assert self.write(0x1A1A, 0)
        assert self.read(0x1A1A)[0] & 0x80
        self.wait(1.0)
        return self.read(0x1A1A)[0]

    def start(self) -> int:
        """How many tries it took."""
        for tries in range(1, 5):
            assert self.write(0x1A24, 2)
            if self.read(0x1A24) == b"\2":
                return tries
        raise AssertionError("it never started")


def entry(number: int = 0, bits: int = 8, trigger: int = 1, black: bool = False, shares: bool = False) -> int:
    return trigger | number << 2 | bits << 8 | 7 << 12 | black << 17 | shares << 19


def test_the_pages_vectors_do_what_they_say() -> None:
    board = LightCrafter()
    for text in ("40 07 0A 00 29 1A 1B 41 00 00 1B 41 00 00", "40 01 03 00 24 1A 00"):
        report = bytes.fromhex(text)
        board.device.write(0x01, report.ljust(64, b"\0"))
        assert board.reply()[:4] == bytes([0x40, report[1], 0, 0])
    assert board.read(0x1A29) == bytes.fromhex("1B4100001B410000")
    board.device.write(0x01, bytes.fromhex("C00D02001A1A").ljust(64, b"\0"))
    assert board.reply()[:5] == bytes.fromhex("C00D010000")


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_start_after_video_mode_is_acknowledged_and_may_need_another_try(lost: int) -> None:
    board = LightCrafter(lost_starts=lost)
    board.configure(entry(black=True))
    assert board.validate() == 0
    assert board.start() == lost + 1
    board.wait(1.0)
    assert board.read(0x1A0C)[0] & 2
    assert len(board.controller.shown) == pytest.approx(60, abs=2)
    assert board.write(0x1A24, 0)
    assert board.read(0x1A24) == b"\0"
    assert board.start() == 1


@pytest.mark.parametrize(
    ("entries", "timing", "said"),
    [
        ([entry(black=True)], {}, 0),
        ([entry(black=True)], {"exposure_us": 8000, "period_us": 8000}, 1),  # 8 bits take 8333 µs
        ([entry(black=True)], {"exposure_us": 17000}, 1),  # longer than its period
        ([entry(black=True)], {"period_us": 17000, "exposure_us": 17000}, 1),  # longer than a video frame
        ([entry(number=3, black=True)], {}, 2),  # three 8-bit pictures in 24 planes
        ([entry(number=24, bits=1, black=True)], {}, 0),  # white fill
        ([entry(bits=1, black=True), entry(1, 1, 3, shares=True)], {"exposure_us": 500, "period_us": 1000}, 4 | 8),
        ([entry()], {}, 8),  # a warning: no post vector before an externally triggered one
        ([entry(black=True)], {"exposure_us": 16500}, 16),  # a warning: dark for 167 µs only
        ([entry(black=True)], {"exposure_us": 16437}, 0),
    ],
)
def test_validation_tells_errors_from_warnings_and_only_errors_forbid_a_start(
    entries: list[int], timing: dict[str, int], said: int
) -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(*entries, **timing)
    assert board.validate() == said
    assert board.write(0x1A24, 2)
    assert board.read(0x1A24)[0] == (0 if said & 3 else 2)


def test_it_does_not_start_unvalidated_or_with_settings_changed_since() -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(entry(black=True))
    assert board.write(0x1A24, 2)
    assert board.read(0x1A24) == b"\0"
    board.validate()
    board.write(0x1A29, *bytes.fromhex("1B4100001B410000"))
    assert board.write(0x1A24, 2)
    assert board.read(0x1A24) == b"\0"


@pytest.mark.parametrize("command", [0x1A1B, 0x1A22, 0x1A23, 0x1A29, 0x1A31, 0x1A33, 0x1A1A])
@pytest.mark.parametrize("action", [1, 2])
def test_while_running_or_paused_settings_are_refused(command: int, action: int) -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(entry(black=True))
    board.validate()
    board.start()
    board.write(0x1A24, action)
    assert not board.write(command, *[1] * 8)
    assert board.write(0x1A24, 0)
    assert board.write(0x1A29, *bytes.fromhex("1B4100001B410000"))


def test_in_standby_and_while_waking_it_knows_its_power_only() -> None:
    board = LightCrafter(in_standby=True)
    assert board.read(0x0200) == b"\1"
    board.send(0xC0, 0x1A1B)
    with pytest.raises(usb.core.USBTimeoutError):
        board.reply()
    board.send(0x40, 0x0200, b"\0")
    with pytest.raises(usb.core.USBTimeoutError):
        board.reply()
    assert board.read(0x0200) == b"\1"
    board.wait(2.0)
    assert board.read(0x0200) == b"\0"
    assert board.read(0x1A1B) == b"\0"


def test_the_video_is_locked_only_when_selected_present_and_given_time() -> None:
    board = LightCrafter()
    assert board.read(0x1A00) == b"\1", "a test pattern at first"
    assert board.read(0x071C)[0] & 3 != 2
    board.write(0x1A00, 0)
    assert board.read(0x071C)[0] & 3 != 2
    board.wait(1.0)
    status = board.read(0x071C)
    assert status[0] & 3 == 2
    assert (int.from_bytes(status[1:3], "little"), int.from_bytes(status[3:5], "little")) == (912, 1140)
    board.controller.frame_s = None
    assert board.read(0x071C)[0] & 3 != 2


def test_pattern_mode_without_a_locked_video_says_running_and_shows_nothing() -> None:
    board = LightCrafter(lost_starts=0, lock_s=5.0)
    board.configure(entry(black=True))
    board.validate()
    assert board.start() == 1
    board.wait(1.0)
    assert board.read(0x1A24) == b"\2"
    assert not board.read(0x1A0C)[0] & 2
    assert board.read(0x1A0A)[0] & 0x40
    assert not board.controller.shown


def test_unknown_commands_and_a_closed_mailbox_are_refused_with_the_nack_bit() -> None:
    board = LightCrafter()
    assert not board.write(0x1AEE, 1)
    assert not board.write(0x1A34, 1, 2, 3)
    assert not board.write(0x1A32, 0)
    board.send(0xC0, 0x1AEE)
    assert board.reply()[0] & 0x20


def test_empty_late_and_lost_reports_reach_pyusb_as_they_are() -> None:
    board = LightCrafter()
    board.board.faults.empty_reports = board.board.faults.stale_reports = 1
    board.send(0xC0, 0x1A24)
    assert board.reply() == b""
    assert board.reply()[1] == 0xEE
    assert board.reply()[1] == 1
    board.board.faults.lost_replies = 1
    board.send(0xC0, 0x1A24)
    with pytest.raises(usb.core.USBTimeoutError):
        board.reply()
    board.board.faults.stale_for_ever = True
    board.send(0xC0, 0x1A24)
    assert {board.reply()[1] for _ in range(100)} == {0xEE}
    board.board.faults.unplugged = True
    with pytest.raises(usb.core.USBError, match="No such device"):
        board.reply()
    assert usb.core.find(idVendor=0x0451, backend=board.board) is None


def test_the_kernels_driver_has_to_be_detached() -> None:
    device = usb.core.find(idVendor=0x0451, backend=LightcrafterOnBus(Controller()))
    assert device is not None
    assert device.is_kernel_driver_active(0)
    with pytest.raises(usb.core.USBError, match="busy"):
        device.write(0x01, bytes(64))
    device.detach_kernel_driver(0)
    assert device.write(0x01, bytes(64)) == 64


def test_a_long_table_comes_in_several_reports_and_reads_back() -> None:
    board = LightCrafter(lost_starts=0)
    entries = [entry(number, 1, 3 if number else 0) for number in range(24)] * 2
    board.configure(*entries, exposure_us=300, period_us=300, source=3, trigger_mode=1)
    assert board.validate() == 0
    board.write(0x1A33, 2)
    board.send(0xC0, 0x1A34)
    blocks = [board.reply() for _ in range(3)]
    assert b"".join(blocks)[4 : 4 + 3 * 48] == b"".join(line.to_bytes(3, "little") for line in entries)


@pytest.mark.parametrize("rate_hz", [100, 500, 2000])
def test_each_trigger_shows_the_next_pattern_and_triggers_the_camera(rate_hz: int) -> None:
    board = LightCrafter(lost_starts=0)
    entries = [entry(number, 1, black=True) for number in range(10)]
    board.configure(*entries, exposure_us=235, period_us=465, source=3, trigger_mode=1)
    assert board.validate() == 0
    board.start()
    began_s = board.now_s + 0.01
    shown = [board.controller.trigger_in(began_s + i / rate_hz) for i in range(1000)]
    assert all(shown)
    assert [pattern.line for pattern in board.controller.shown] == [i % 10 for i in range(1000)]
    cameras = [at_s for output, at_s in board.edges if output == 1]
    assert cameras == [pattern.from_s for pattern in board.controller.shown]
    assert sum(output == 2 for output, _ in board.edges) == 100


def test_a_trigger_within_the_period_is_missed_and_falling_edges_are_none() -> None:
    board = LightCrafter(lost_starts=0)
    board.configure(entry(0, 1, black=True), exposure_us=235, period_us=1000, source=3, trigger_mode=1)
    board.validate()
    board.start()
    began_s = board.now_s + 0.01
    edges = [board.controller.trigger_in(began_s + t) for t in (0.0, 0.0005, 0.001)]
    assert edges == [True, False, True]
    assert board.controller.missed_triggers == 1
    assert not board.controller.trigger_in(began_s + 1.0, rising=False)


@settings(deadline=None)
@given(st.lists(st.integers(0, 255), min_size=64, max_size=64), st.integers(0, 3))
def test_no_report_whatsoever_ends_the_board(report: list[int], repeats: int) -> None:
    board = LightCrafter()
    for _ in range(repeats + 1):
        board.device.write(0x01, bytes(report))
    while board.board.waits_for_more:  # the rest of what it takes for a longer message
        board.device.write(0x01, bytes(64))
    board.wait(5.0)
    board.send(0xC0, 0x0200)
    assert any(board.reply()[1] == 1 for _ in range(60))
