"""Replies of pumps that are lost, or never come, are told within three seconds."""

import itertools
import os
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.cavro.doser import CavroDoser
from drivers.cavro.settings import CavroSettings
from drivers.new_era.doser import NewEraDoser
from drivers.new_era.settings import NewEraSettings
from drivers.rig_doser.doser import RigDoser
from drivers.rig_doser.settings import RigDoserSettings
from tankrig.errors import DeviceError

from .doser_bench import AnyBench, Bench
from .strict_pumps import XLP, cavro, new_era
from .virtual_time import World

TOLD_WITHIN_S = 3.0
BOARD_BOOTS_S = 2.0
"""The boot loader of a board that opening its port has reset; the driver waits 3 s at most for the first word."""
DOSERS: dict[str, Callable[[Path], AnyBench]] = {
    "rig 01": lambda folder: Bench(folder, world=World(), rate=400.0),
    "rig 02": lambda folder: Bench(folder, world=World(), rate=400.0, protocol=2),
    "New Era": lambda folder: new_era(folder, rate_ml_per_min=2.4),
    "XCalibur": lambda folder: cavro(folder, speed_ul_per_s=40.0, syringe_ul=250.0),
    "XLP": lambda folder: cavro(folder, XLP, speed_ul_per_s=40.0, syringe_ul=250.0),
}


@pytest.mark.parametrize("deaf", [False, True])
@pytest.mark.parametrize("kind", list(DOSERS))
def test_a_lost_reply_is_told_within_three_seconds(kind: str, deaf: bool, tmp_path: Path) -> None:
    """Whichever write of a dose is the first that is not answered: it took a New Era 40 s."""
    longest_s, number = 0.0, 0
    while True:
        (folder := tmp_path / str(number)).mkdir()
        with DOSERS[kind](folder) as bench:
            doser = bench.open()
            silent_s = self_silencing(bench, doser, after_writes=number, deaf=deaf)
            try:
                doser.dose_to(40.0)
                break
            except DeviceError:
                assert silent_s, "it failed before anything was lost"
                longest_s = max(longest_s, bench.world.now_s - silent_s[0])
            low_ul, high_ul = doser.last_known[1:]
            assert low_ul - 1e-9 <= bench.true_ul <= high_ul + 1e-9
        number += 1
    print(f"{kind}: {number} writes, longest {longest_s:.2f} s")
    assert number >= 8
    assert longest_s <= TOLD_WITHIN_S


@pytest.mark.parametrize("what", ["delivered", "clear_stop", "open"])
@pytest.mark.parametrize("kind", list(DOSERS))
def test_silence_outside_a_dose_is_told_soon(kind: str, what: str, tmp_path: Path) -> None:
    """Opening too, though a pump just switched on ignores some commands; a board that resets has its banner's time."""
    with DOSERS[kind](tmp_path) as bench:
        doser = bench.open()
        doser.dose_to(10.0)
        doser.stop()
        if what == "open":
            doser.close()
        bench.faults(mute=True)
        begun_s = bench.world.now_s
        with pytest.raises(DeviceError):
            bench.open() if what == "open" else getattr(doser, what)()
        took_s = bench.world.now_s - begun_s
        print(f"{kind}, {what}: {took_s:.2f} s")
        boots_s = (
            BOARD_BOOTS_S if what == "open" and isinstance(bench, Bench) else 0.0
        )  # opening the port resets the board
        assert took_s <= boots_s + TOLD_WITHIN_S


SILENT: dict[str, Callable[[str, Path], object]] = {
    "rig": lambda port, _: RigDoser(RigDoserSettings(port=port, steps_per_ul=10.0)),
    "New Era": lambda port, count: NewEraDoser(
        NewEraSettings(port=port, diameter_mm=12.0, rate_ml_per_min=5.0, count_file=count)
    ),
    "Cavro": lambda port, count: CavroDoser(
        CavroSettings(port=port, model="xcalibur", syringe_ul=250.0, speed_ul_per_s=40.0, count_file=count)
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", list(SILENT))
def test_a_pseudo_terminal_where_nobody_answers_is_told_within_three_seconds(kind: str, tmp_path: Path) -> None:
    """By this computer's clock; the rig's board has its banner's time besides."""
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        begun_s = time.monotonic()
        with pytest.raises(DeviceError, match=r"no .* answers there; check|answers there at .* check port"):
            SILENT[kind](os.ttyname(slave), tmp_path / "count")
        took_s = time.monotonic() - begun_s
    finally:
        os.close(master)
        os.close(slave)
    print(f"{kind}: {took_s:.2f} s")
    assert took_s <= TOLD_WITHIN_S + (BOARD_BOOTS_S if kind == "rig" else 0.0)


def self_silencing(bench: AnyBench, doser: Any, after_writes: int, deaf: bool) -> list[float]:
    """Nothing is heard any more from the n-th write on; when that was."""
    port, since = bench.port_of(doser), []
    write, left = port.write, itertools.count(after_writes, -1)

    def silencing(data: bytes) -> int:
        if next(left) == 0:
            since.append(bench.world.now_s)
            bench.faults(mute=True, deaf=deaf)
        return write(data)

    port.write = silencing
    return since
