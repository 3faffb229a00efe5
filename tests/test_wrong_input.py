"""Whatever stands in a file, it is read, or refused in one sentence: no traceback, no crash, no wait without end.

`./start test tests/test_wrong_input.py -m long` reads 100,000 mutated files (TANKRIG_FUZZ says how many), and prints
what became of them; the number of a mutation that fails is its seed: python tests/fuzz_batch.py FOLDER FORMAT NUMBER 1.
"""

import errno
import json
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest

from tankrig.errors import ImageError, StoreError
from ui.cli import exit_status, main

from .fuzz_batch import FORMATS

TREE = Path(__file__).parents[1]

BATCH = 1000
BATCH_S = 600
CHEAP = {"npz", "npy", "png", "tiff", "ledger", "count", "prepared", "pump", "phase-table", "calibration"}
"""Formats that take a millisecond or so, of which more are read."""
OF_RUNS = {"journal", "settings", "frames-metadata", "patterns-metadata", "chunk"}
"""Formats of which reading one means reading a run."""
MANY = int(os.environ.get("TANKRIG_FUZZ", "100000"))
FEW = 40
"""Mutated files of a cheap format that are read by the test that everybody runs; of others a half or a quarter."""


def share(name: str, of: int) -> int:
    """How many of all mutations a format gets."""
    weights = {one: 6 if one in CHEAP else 1 if one in OF_RUNS else 3 for one in FORMATS}
    return -(-of * weights[name] // sum(weights.values()))


def read_batch(name: str, first: int, count: int, folder: Path) -> dict[str, Any]:
    """What became of some mutations; those that ended the process are among the failed, and it goes on behind them."""
    told: dict[str, Any] = {"refused": 0, "accepted": 0, "used": 0, "failed": []}
    last = first + count
    while first < last:
        words = [sys.executable, str(Path(__file__).with_name("fuzz_batch.py")), str(folder), name, str(first)]
        try:
            ended = subprocess.run(
                [*words, str(last - first)], capture_output=True, text=True, errors="replace", check=False,
                timeout=BATCH_S,
            )  # fmt: skip
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


ONCE_FAILED = [
    *[("pump", 321), ("calibration", 1491), ("journal", 108), ("journal", 113)],
    *[("prepared", 575), ("prepared", 2227), ("prepared", 5290), ("settings", 448)],
]
"""Mutations that ended in a traceback, or in a sentence of thousands of letters, before they were mended."""


def test_a_few_mutated_files_and_those_that_once_failed_are_read_or_refused_in_a_sentence(tmp_path: Path) -> None:
    """In one process, which takes longer to start than to read a few; when it ends early, we are told where."""
    few = {name: FEW if name in CHEAP else FEW // 4 if name in OF_RUNS else FEW // 2 for name in FORMATS}
    batches = [*((name, 0, count) for name, count in few.items()), *((name, number, 1) for name, number in ONCE_FAILED)]
    words = [sys.executable, str(Path(__file__).with_name("fuzz_batch.py")), str(tmp_path)]
    words += [str(word) for batch in batches for word in batch]
    ended = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False, timeout=250)
    told = [json.loads(line) for line in ended.stdout.splitlines() if line.startswith("{")]
    ended_in = batches[len(told) : len(told) + 1], (tmp_path / "at").read_text()
    assert ended.returncode == 0, (ended_in, ended.stderr[-2000:])
    failed = {name: found["failed"] for (name, *_), found in zip(batches, told, strict=True) if found["failed"]}
    assert failed == {}
    assert [found["refused"] + found["accepted"] for found in told] == [count for *_, count in batches]


def png_header(columns: int, rows: int) -> bytes:
    """A PNG that says it is so large, and holds next to nothing."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    size = struct.pack(">IIBBBBB", columns, rows, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", size) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


SCENE = (TREE / "tests" / "data" / "reference" / "pub02.toml").read_text(encoding="utf-8")
SEQUENCE = (TREE / "docs" / "examples" / "dilution.toml").read_text(encoding="utf-8")
RIG = (TREE / "drivers" / "simulated" / "rig.toml").read_text(encoding="utf-8")
LOOP = '[[steps]]\ndo = "repeat"\ntimes = 1000000000\nsteps = [{ do = "note", text = "x" }]\n'
WRONG: dict[str, tuple[list[str], dict[str, str | bytes], str]] = {
    "a folder as an image": (["fit", ".", "--scene", "s.toml"], {"s.toml": SCENE}, "is a folder; give an image"),
    "a folder that is no run": (["run", "--resume", "."], {}, "is not a run"),
    "no folder for a run": (["run", "q.toml", "--out", "/"], {"q.toml": SEQUENCE}, "give another"),
    "a name of 300 letters": (["predict", "s.toml", "--out", "x" * 300], {"s.toml": SCENE}, "File name too long"),
    "a seed below zero": (["predict", "s.toml", "--seed", "-1"], {"s.toml": SCENE}, "-1"),
    "a picture that bursts": (
        ["fit", "p.png", "--scene", "s.toml"],
        {"s.toml": SCENE, "p.png": png_header(100_000, 100_000)},
        "100000 × 100000",
    ),
    "inf in a sequence": (
        ["run", "q.toml", "--dry-run"],
        {"q.toml": SEQUENCE.replace("width_mm = 4.0", "width_mm = inf")},
        "patterns.rays",
    ),
    "a billion repeats": (["run", "q.toml", "--dry-run"], {"q.toml": 'name = "x"\n' + LOOP}, "1000000000 actions"),
    "a key with a newline": (["predict", "s.toml"], {"s.toml": '"a\\nb" = 1\n' + SCENE}, "a\\nb"),
    "a number of 4000 digits": (["predict", "s.toml"], {"s.toml": f"x = {'9' * 4000}\n" + SCENE}, "x"),
    "a coefficient of 1e300": (
        ["predict", "s.toml"], {"s.toml": SCENE.replace("sigma_s = 0.0018", "sigma_s = 1e300")}, "medium.sigma_s"
    ),
    "a wall of a million pixels a side": (
        ["run", "q.toml", "--dry-run", "--rig", "r.toml"],
        {"q.toml": SEQUENCE, "r.toml": RIG.replace("shape = [480, 640]", "shape = [1000000, 1000000]")},
        "bench.wall",
    ),
    "a projector where the doser is": (
        ["run", "q.toml", "--no-fit", "--rig", "r.toml"],
        {
            "q.toml": 'name = "n"\n[[steps]]\ndo = "note"\ntext = "x"\n',
            "r.toml": RIG.replace('driver = "simulated-doser"', 'driver = "simulated-projector"').replace(
                "steps_per_ul = 10.0", ""
            ),
        },
        "[doser]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_ends_in_one_sentence(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words, files, said = WRONG[case]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(words) == 2
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("tankrig: ")]
    assert len(errors) == 1
    assert said in errors[0]
    assert "unexpectedly" not in errors[0]


def test_a_disk_that_is_full_is_a_failure_however_often_it_was_put_into_words() -> None:
    full = StoreError("the run cannot be written")
    full.__cause__ = StoreError("a frame cannot be written")
    full.__cause__.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    assert exit_status(full) == 1
    itself = ImageError("no image")
    itself.__cause__ = itself
    assert exit_status(itself) == 2


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


def test_a_file_of_another_kind_is_said_to_be_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A scene that was given as a sequence was told that its first key is "unknown; remove it"."""
    scene, sequence = tmp_path / "scene.toml", tmp_path / "first.toml"
    scene.write_text("[tank]\n[medium]\nsigma_a = 0.0\nsigma_s = 0.01\ng = 0.0\n")
    sequence.write_text('name = "a note"\n[[steps]]\ndo = "note"\ntext = "x"\n')
    for command, said in (
        (["run", str(scene)], "scene.toml: is a scene file, where a sequence file is wanted"),
        (["run", str(sequence), "--rig", str(scene)], "scene.toml: is a scene file, where a rig file is wanted"),
        (["predict", str(sequence)], "first.toml: is a sequence file, where a scene file is wanted"),
    ):
        assert main(command) == 2
        assert said in capsys.readouterr().err
