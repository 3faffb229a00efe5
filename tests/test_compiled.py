"""Compiled kernels on disk outlive the version of the program that compiled them."""

import subprocess
import sys
from pathlib import Path

KERNEL = """
from tankrig.compiled import kernel
from {module} import Pair

@kernel
def added(pair):
    return pair.one + pair.two

print(added(Pair(1.0, 2.0)))
"""
PAIR = "from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    one: float\n    two: float\n"


def run(folder: Path, module: str) -> subprocess.CompletedProcess[str]:
    (folder / f"{module}.py").write_text(PAIR)
    (folder / "uses_pair.py").write_text(KERNEL.format(module=module))
    return subprocess.run([sys.executable, "uses_pair.py"], cwd=folder, capture_output=True, text=True, check=False)


def test_a_class_of_arguments_may_move_to_another_module_between_versions(tmp_path):
    """The person who updates has the old version's compiled code on disk, which names the module that is gone."""
    assert run(tmp_path, "before").stdout == "3.0\n"
    assert list(tmp_path.rglob("*.nbi"))
    (tmp_path / "before.py").unlink()
    for stale in tmp_path.rglob("before*.pyc"):
        stale.unlink()
    said = run(tmp_path, "after")
    assert said.stdout == "3.0\n", said.stderr


TWICE = """
import gc
import numpy as np
from tankrig.compiled import kept, kernel, part

@part
def doubled(x, times):
    return x * 2.0**times

@kernel
def first(values):
    return values[0]

@kernel
def total(values):
    return doubled(first(values), 1) + doubled(first(values), 2) + doubled(values[1], 3)

@kernel
def wrong(values):
    return values.nothing

before = gc.get_threshold()
values = np.array([1.0, 10.0])
print(kept(total), kept(wrong))
print(total(values), first(values), doubled(3.0, 1), len(doubled.linked.signatures))
try:
    wrong(values)
except Exception as error:
    print(type(error).__name__)
print(gc.get_threshold() == before, gc.isenabled())
"""


def test_kernels_call_each_other_and_are_called_from_python_in_every_later_process_too(tmp_path: Path) -> None:
    """Code for kernels that Python took for its own, from the disk, would crash the program without a word."""
    (tmp_path / "twice.py").write_text(TWICE)
    said = [
        subprocess.run([sys.executable, "twice.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
        for _ in range(2)
    ]
    (kept, *first), (kept_again, *again) = (one.stdout.split("\n") for one in said)
    assert (kept, kept_again) == ("False False", "True False"), said[0].stderr
    assert first == ["86.0 1.0 6.0 1", "TypingError", "True True", ""], said[0].stderr
    assert again[0].startswith("86.0 1.0 6.0"), said[1].stderr
    assert again[1:] == first[1:]


AT_ONCE = """
import sys, time
from pathlib import Path
import numpy as np
from tankrig.compiled import kernel

@kernel
def first_and(values, more):
    return values[0] + more

file = first_and._cache._cache_file
write = file._save_index
file._save_index = lambda index: (time.sleep(0.2), write(index))
count, *names = sys.argv[2:]
Path(f"ready-{names[0]}").touch()
while len(list(Path().glob("ready-*"))) < int(count):
    time.sleep(0.01)
for name in names:
    assert first_and(np.array([1.0], name), 1.5) == 2.5
print(sum(first_and.stats.cache_hits.values()))
"""


def test_processes_that_compile_a_kernel_at_the_same_time_all_keep_their_code(tmp_path: Path) -> None:
    """A run and its live fit compile side by side; one must not find the other's code in place of its own."""
    (tmp_path / "at_once.py").write_text(AT_ONCE)
    kinds = ["int8", "int32", "float64"]

    def begun(*kinds: str) -> "subprocess.Popen[str]":
        words = [sys.executable, "at_once.py", "--", "3", *kinds]
        return subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    for process in [begun(kind) for kind in kinds]:
        assert process.communicate(timeout=120.0) == ("0\n", "")
    assert begun(*kinds).communicate(timeout=120.0) == (f"{len(kinds)}\n", "")


RECORDS = """
import os, sys
os.environ["NUMBA_NRT_STATS"] = "1"
from typing import NamedTuple
import numpy as np
from numba.core.runtime import rtsys
from tankrig.compiled import kernel

class Inner(NamedTuple):
    values: np.ndarray
    factor: float

class Outer(NamedTuple):
    inner: Inner
    more: np.ndarray

@kernel
def borrows(outer, either):
    inner = outer.inner
    if either:
        inner = Inner(outer.more, 10.0)
    total = 0.0
    for i in range(inner.values.size):
        outer.more[i] += 1.0
        total += inner.values[i] * inner.factor * outer.inner.factor**2
    return total

@kernel
def gives_back(outer):
    return outer.inner.values

@kernel
def makes(outer):
    return gives_back(outer) + np.ones(outer.more.size)

outer = Outer(Inner(np.array([1.0, 2.0]), 3.0), np.array([5.0, 7.0]))
held = [sys.getrefcount(one) for one in (outer.inner.values, outer.more)]
print(borrows(outer, False), outer.more, borrows(outer, True), gives_back(outer), makes(outer))
print(held == [sys.getrefcount(one) for one in (outer.inner.values, outer.more)])
made = rtsys.get_allocation_stats()
print(made.alloc > 0, made.alloc == made.free, made.mi_alloc == made.mi_free)
"""


def test_records_are_read_as_python_reads_them_and_their_arrays_stay_with_who_holds_them(tmp_path: Path) -> None:
    """An array that nobody counts would be gone while in use, and one that is counted twice never."""
    (tmp_path / "records.py").write_text(RECORDS)
    for _ in range(2):  # compiled, then from the disk
        said = subprocess.run([sys.executable, "records.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert said.stdout == "81.0 [7. 9.] 1440.0 [1. 2.] [2. 3.]\nTrue\nTrue True True\n", said.stdout + said.stderr
