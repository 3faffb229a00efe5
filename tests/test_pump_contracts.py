"""New Era and Cavro pumps keep the promises of every doser."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tankrig.devices import Doser
from tankrig.testing import DoserContract, ReopenDoser

from .doser_bench import AnyBench, CavroBench, NewEraBench


class PumpContract(DoserContract):
    bench: type[AnyBench]

    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[ReopenDoser]:
        with self.bench(tmp_path, time_scale=0.5) as bench:  # at a fifth a busy computer is late for replies
            yield bench.open

    @pytest.fixture
    def doser(self, reopen: ReopenDoser) -> Doser:
        return reopen()


class TestNewEra(PumpContract):
    bench = NewEraBench


class TestCavro(PumpContract):
    bench = CavroBench
    steps_long = 1800  # a busy computer would else come too late to interrupt a dose
