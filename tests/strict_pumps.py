"""Pumps that do as their manuals say; what these leave open they do in the way that is hardest for a driver."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from drivers.cavro.emulator.core import MODELS
from drivers.cavro.emulator.core import Habits as CavroHabits
from drivers.new_era.emulator.core import Habits as NewEraHabits

from .doser_bench import CavroBench, NewEraBench
from .virtual_time import World

BY_MANUAL = CavroHabits(speeds_interact=True, speed_rounding=1, repeat_flag_decides=True, overload_stays=True)
XLP = replace(BY_MANUAL, model=MODELS["xlp"])
NEW_ERA = NewEraHabits(checks_rates=True)


def cavro(folder: Path, habits: CavroHabits = BY_MANUAL, **how: Any) -> CavroBench:
    return CavroBench(folder, world=World(), habits=habits, **how)


def new_era(folder: Path, **how: Any) -> NewEraBench:
    return NewEraBench(folder, world=World(), **({"habits": NEW_ERA} | how))
