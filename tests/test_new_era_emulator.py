"""The stand-in for a New Era against its manual: bytes and times in, bytes and motion out; no driver takes part."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.new_era.emulator.core import Core, Habits, Syringe
from drivers.new_era.emulator.frames import DAMAGED, Reader, crc, safe


class NewEra:
    """A pump on the bench with a syringe of 12 mm, 20 steps a µl; its memory outlives its power."""

    def __init__(self, memory: dict[str, Any] | None = None, *, counter_survives: bool = False, **habits: Any) -> None:
        self.memory = {} if memory is None else memory
        self.pushed, self.now_s, self._counter_survives = 0, 0.0, counter_survives
        self._habits = Habits(**{"checks_rates": True, **habits})
        self.power_up()

    def power_up(self) -> None:
        """A new life on the same memory; the time goes on."""
        self.core = Core(
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
