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
