"""The V4L2 camera driver on the real OpenCV backend, with a preloaded library in place of the kernel's driver.

A library is preloaded into a new process only, so each file of tests/preloaded runs in a pytest of its own.
"""

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
def test_the_camera_driver_through_opencv(case, tmp_path):
    done = run_preloaded(case, tmp_path)
    print(done.stdout, done.stderr)
    assert done.returncode == 0, f"see {case}"
