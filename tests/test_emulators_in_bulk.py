"""A stand-in is the same pump whether it makes its steps one by one or at once, and whether it is looked at often.

On the injected clock a stand-in lives only when bytes come, and makes the steps at once that nothing befalls; in its
own process it lives every few milliseconds and makes them one by one. A test of one would say nothing of the other if
answers or ink differed.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.cavro.emulator.core import XCALIBUR, XLP, Model
from drivers.cavro.emulator.core import Core as CavroCore
from drivers.cavro.emulator.core import Habits as CavroHabits
from drivers.cavro.emulator.frames import Command
from drivers.new_era.emulator.core import Core as NewEraCore
from drivers.new_era.emulator.core import Syringe
from drivers.rig_doser.emulator.firmware import Firmware
from drivers.rig_doser.emulator.frames import Request
from drivers.rig_doser.emulator.memory import STOPPED, Commissioning, StateFile

LOOKS_S = 0.037
History = list[tuple[str, float]]
CASES = settings(deadline=None, max_examples=60)


class Motor:
    """Counts the steps that the plunger has followed, and jams."""

    def __init__(self, jams_after: int | None) -> None:
        self.made, self.jams_after = 0, jams_after

    def pulse(self) -> bool:
        followed = self.jams_after is None or self.made < self.jams_after
        self.made += followed
        return followed

    def run(self, steps: int) -> int:
        at_once = steps if self.jams_after is None else min(steps, self.jams_after - self.made)
        self.made += at_once
        return at_once


def lived(core: Any, history: History, ask: Callable[[str, float], object], *, looks: bool) -> list[object]:
    """What it answers to each text, so long after the one before."""
    now_s, answers = 0.0, []
    for text, after_s in history:
        if looks:
            for i in range(1, int(after_s / LOOKS_S) + 1):
                core.advance(now_s + i * LOOKS_S)
        now_s += after_s
        core.advance(now_s)
        answers.append(ask(text, now_s))
    return answers


def histories(texts: list[str]) -> st.SearchStrategy[History]:
    return st.lists(st.tuples(st.sampled_from(texts), st.floats(0.0, 4.0)), min_size=1, max_size=14)


JAMS = st.none() | st.integers(0, 3000)


# -- Cavro -------------------------------------------------------------------------------------------------------------

PROGRAMS = "OR IR A0R A1501R A3000R D100R P101R OgD20M50G3R N1A101N0OA0R X ZR T R Q ? ?2"
SETTINGS = "N1R N0R V100R V600R v50R c500V2000R L5R K20R"
CAVRO = [*PROGRAMS.split(), *SETTINGS.split()]


def cavro(model: Model, history: History, jams_after: int | None, *, as_process: bool) -> tuple[object, ...]:
    motor, expelled, sequence = Motor(jams_after), [0], [0]
    habits = CavroHabits(model, speeds_interact=True)

    def ask(text: str, now_s: float) -> object:
        sequence[0] = sequence[0] % 7 + 1
        return core.obey(Command(1, sequence[0], False, text), now_s)

    def out(fine: int) -> None:
        expelled[0] += fine

    run = {} if as_process else {"run": motor.run}
    core = CavroCore(motor.pulse, out, lambda: 24, True, habits, **run)
    answers = lived(core, [*history, ("?", 300.0), ("Q", 0.0), ("Q", 0.0)], ask, looks=as_process)
    assert answers[-1][0] & 0x20, f"busy for ever: {history}"
    return answers, expelled[0], motor.made, core.believed()


@pytest.mark.parametrize("model", [pytest.param(XCALIBUR, id="xcalibur"), pytest.param(XLP, id="xlp")])
@CASES
@given(history=histories(CAVRO), jams_after=JAMS)
def test_a_cavro(model: Model, history: History, jams_after: int | None) -> None:
    made = [cavro(model, history, jams_after, as_process=as_process) for as_process in (False, True)]
    assert made[0] == made[1]


# -- New Era -----------------------------------------------------------------------------------------------------------


def new_era(history: History, jams_after: int | None, *, as_process: bool) -> tuple[object, ...]:
    motor, memory = Motor(jams_after), dict[str, Any]()
    given = {"syringe": Syringe(20.0, 12.0), "nearest": True, "counter_survives": False}
    run = {} if as_process else {"run": motor.run}
    core = NewEraCore(memory, lambda: None, motor.pulse, **run, **given)
    return lived(core, [*history, ("DIS", 100.0)], core.obey, looks=as_process), motor.made, core.believed()


@CASES
@given(
    rates=st.lists(st.sampled_from(["600.0UM", "2.000MM", "37.00MH"]), min_size=2, max_size=2),
    volumes=st.lists(st.sampled_from(["1.000", "10.00", "33.30"]), min_size=2, max_size=2),
    between=st.sampled_from(["FUNRAT", "FUNPAS1", "FUNJMP1"]),
    history=histories(["RUN", "STP", "", "DIS", "RAT500.0", "CLDINF", "SAF2", "SAF0", "PHN", "RUN2"]),
    jams_after=JAMS,
)
def test_a_new_era(
    rates: list[str], volumes: list[str], between: str, history: History, jams_after: int | None
) -> None:
    """Two phases with another between them, and the stop."""
    program = ["", "PHN1", "FUNRAT", f"RAT{rates[0]}", f"VOL{volumes[0]}", "PHN2", between, "VOL1.000", "PHN3"]
    program += ["FUNRAT", f"RAT{rates[1]}", f"VOL{volumes[1]}", "DIRWDR", "PHN4", "FUNSTP", "RUN"]
    whole = [(text, 0.0) for text in program] + history
    made = [new_era(whole, jams_after, as_process=as_process) for as_process in (False, True)]
    assert made[0] == made[1]


# -- the rig's own doser -----------------------------------------------------------------------------------------------


def rig_doser(protocol: int, history: History, jams_after: int | None, *, as_process: bool) -> tuple[object, ...]:
    motor, dose = Motor(jams_after), [0]

    def ask(text: str, now_s: float) -> object:
        if text == "stop":
            return firmware.stop(now_s)
        if text == "C":
            return firmware.answer(Request("01", "C", f"{firmware.record.stops:04X}"), now_s)
        if text == "S":
            return firmware.answer(Request("01", "S", ""), now_s)
        dose[0] += 1
        target = firmware.record.count + int(text)
        return firmware.answer(Request("01", "D", f"{dose[0]:08X}{target:08X}"), now_s)

    with tempfile.TemporaryDirectory() as folder:
        state = StateFile(Path(folder) / "state", Commissioning("TD000007", 50_000, 10_000_000))
        run = {} if as_process else {"run": motor.run}
        firmware = Firmware(state, 2000.0, 8000.0, motor.pulse, protocol, **run)
        firmware.record.flags &= ~STOPPED
        answers = lived(firmware, [*history, ("S", 60.0)], ask, looks=as_process)
        state.close()
    return answers, motor.made, firmware.believed()


@pytest.mark.parametrize("protocol", [1, 2])
@CASES
@given(history=histories(["1", "500", "4000", "S", "stop", "C"]), jams_after=JAMS)
def test_the_rigs_own_doser(protocol: int, history: History, jams_after: int | None) -> None:
    made = [rig_doser(protocol, history, jams_after, as_process=as_process) for as_process in (False, True)]
    assert made[0] == made[1]
