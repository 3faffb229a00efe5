"""The rig's own doser keeps the promises of every doser: in this process, as the simulated rig's, and under guard."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.registry import open_device
from tankrig.devices import Doser
from tankrig.dosing import DoseDone, DoseIntent, DoseLimits, GuardedDoser, TankLedger
from tankrig.testing import DoserContract, ReopenDoser

from .doser_bench import Bench


class Nowhere:
    """A journal that nobody reads."""

    def dose_intent(self, intent: DoseIntent) -> None: ...

    def dose_done(self, done: DoseDone) -> None: ...


class TestRigDoser(DoserContract):
    steps_long = 1800  # a busy computer would else come too late to interrupt a dose

    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[ReopenDoser]:
        with Bench(tmp_path) as bench:
            yield bench.open

    @pytest.fixture
    def doser(self, reopen: ReopenDoser) -> Doser:
        return reopen()


class TestSimulatedDoser(DoserContract):
    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[ReopenDoser]:
        opened = []

        def open_again() -> Doser:
            opened.append(open_device("simulated-doser", {"folder": tmp_path, "time_scale": 0.3, "rate": 4000.0}))
            return opened[-1]

        yield open_again
        for doser in opened:
            doser.close()

    @pytest.fixture
    def doser(self, reopen: ReopenDoser) -> Doser:
        return reopen()


class TestGuardedDoser(DoserContract):
    steps_long = 1800  # a busy computer would else come too late to interrupt a dose

    @pytest.fixture
    def reopen(self, tmp_path: Path) -> Iterator[ReopenDoser]:
        opened = []

        def open_again() -> Doser:
            ledger, limits = TankLedger(tmp_path / "tank.jsonl"), DoseLimits(5000.0, 5000.0, 5000.0)
            opened.append(GuardedDoser(bench.open(), limits, ledger, Nowhere(), "run"))
            return opened[-1]

        with Bench(tmp_path) as bench:
            yield open_again
            for doser in opened:
                doser.close()

    @pytest.fixture
    def doser(self, reopen: ReopenDoser) -> Doser:
        return reopen()
