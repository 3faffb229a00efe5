"""The V4L2 camera driver with a preloaded library in place of the kernel's.

A library is preloaded into a new process only, so each file of tests/preloaded runs in a pytest of its own.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from .preloaded.fake_v4l2 import build, preloaded

CASES = Path(__file__).parent / "preloaded"


def run_preloaded(
    case: Path, folder: Path, *options: str, timeout_s: float = 120.0
) -> subprocess.CompletedProcess[str]:
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc, to build the camera's stand-in")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", *options, case]
    environment = preloaded(build(folder), folder / "video0")
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=timeout_s, cwd=CASES.parents[1]
    )


@pytest.mark.parametrize("case", sorted(CASES.glob("v4l2_*.py")), ids=lambda case: case.stem)
def test_the_camera_driver_on_a_stand_in_for_the_kernels(case, tmp_path):
    done = run_preloaded(case, tmp_path)
    print(done.stdout, done.stderr)
    assert done.returncode == 0, f"see {case}"


def at_full_rate(folder: Path, *options: str, timeout_s: float) -> None:
    done = run_preloaded(CASES / "full_rate.py", folder, "-s", *options, timeout_s=timeout_s)
    print(done.stdout, done.stderr)
    assert done.returncode == 0, "see tests/preloaded/full_rate.py"


def test_thousands_of_frames_at_full_rate(tmp_path, monkeypatch):
    monkeypatch.setenv("FRAMES", "3000")
    at_full_rate(tmp_path, "-k", "many", timeout_s=120.0)


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_a_million_frames_at_full_rate(tmp_path, monkeypatch):
    monkeypatch.setenv("FRAMES", os.environ.get("FRAMES", "1000000"))
    at_full_rate(tmp_path, "-k", "many", "--timeout=7000", timeout_s=7000.0)


@pytest.mark.long
def test_frames_a_second_beside_opencv(tmp_path):
    at_full_rate(tmp_path, "-k", "beside", timeout_s=280.0)
