"""New Era and Cavro pumps keep the promises of every doser."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tankrig.devices import Doser

from .contracts.doser import DoserContract, Reopen
from .doser_bench import AnyBench, CavroBench, NewEraBench


class PumpContract(DoserContract):
    bench: type[AnyBench]

    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[Reopen]:
        with self.bench(tmp_path) as bench:
            yield bench.open

    @pytest.fixture
    def doser(self, reopen: Reopen) -> Doser:
        return reopen()


class TestNewEra(PumpContract):
    bench = NewEraBench


class TestCavro(PumpContract):
    bench = CavroBench
