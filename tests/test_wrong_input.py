"""Whatever stands in a file, it is read, or refused in one sentence: no traceback, no crash, no wait without end.

`./start test tests/test_wrong_input.py -m long` reads 100,000 mutated files (TANKRIG_FUZZ says how many), and prints
what became of them; the number of a mutation that fails is its seed: python tests/fuzz_batch.py FORMAT NUMBER 1 FOLDER.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from .fuzz_batch import FORMATS

BATCH = 1000
BATCH_S = 600
CHEAP = {"npz", "npy", "png", "tiff", "ledger", "count", "prepared", "pump", "phase-table", "calibration"}
"""Formats that take a millisecond or so, of which more are read."""
OF_RUNS = {"journal", "settings", "frames-metadata", "patterns-metadata", "chunk"}
"""Formats of which reading one means reading a run."""
MANY = int(os.environ.get("TANKRIG_FUZZ", "100000"))
FEW = 40


def share(name: str, of: int) -> int:
    """How many of all mutations a format gets."""
    weights = {one: 6 if one in CHEAP else 1 if one in OF_RUNS else 3 for one in FORMATS}
    return -(-of * weights[name] // sum(weights.values()))


def read_batch(name: str, first: int, count: int, folder: Path) -> dict[str, Any]:
    """What became of some mutations; those that ended the process are among the failed, and it goes on behind them."""
    told: dict[str, Any] = {"refused": 0, "accepted": 0, "used": 0, "failed": []}
    last = first + count
    while first < last:
        words = [sys.executable, str(Path(__file__).with_name("fuzz_batch.py")), name, str(first), str(last - first)]
        try:
            ended = subprocess.run(
                [*words, str(folder)], capture_output=True, text=True, errors="replace", check=False, timeout=BATCH_S
            )
            why = f"the process ended with {ended.returncode}: {ended.stderr[-300:]}"
        except subprocess.TimeoutExpired:
            ended, why = None, "the process did not end"
        if ended is not None and ended.returncode == 0:
            found = json.loads(ended.stdout.splitlines()[-1])
            for key, value in found.items():
                told[key] += value
            return told
        at = folder / "at"
        assert at.exists(), f"{name}: an original is not read: {why}"
        number = int(at.read_text())
        told["failed"].append([number, why])
        first = number + 1
    return told


@pytest.mark.parametrize("name", FORMATS)
def test_a_few_mutated_files_are_read_or_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    told = read_batch(name, 0, FEW, tmp_path)
    assert not told["failed"]
    assert told["refused"] + told["accepted"] == FEW


@pytest.mark.long
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", FORMATS)
def test_many_mutated_files_are_read_or_refused_in_a_sentence(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    total: dict[str, Any] = {"refused": 0, "accepted": 0, "used": 0, "failed": []}
    for first in range(0, share(name, MANY), BATCH):
        for key, value in read_batch(name, first, min(BATCH, share(name, MANY) - first), tmp_path).items():
            total[key] += value
    with capsys.disabled():
        failed = len(total["failed"])
        print(f"\n{name}: {total['refused']} refused, {total['accepted']} read, {total['used']} used, {failed} failed")
    assert not total["failed"]
