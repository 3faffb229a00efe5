"""Starting stays cheap: nothing heavy is imported before it is used."""

import subprocess
import sys

import pytest

HEAVY = {"numba", "scipy", "cv2", "matplotlib", "zarr", "xarray", "pydantic", "PySide6", "pyqtgraph", "serial", "usb"}
HEAVY |= {"pytest", "tankrig.testing"}


def run(code: str) -> str:
    """Output of `code` in a fresh Python."""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120).stdout


@pytest.mark.parametrize(
    "code",
    [
        "import tankrig",
        "import tankrig; tankrig.Scene, tankrig.Medium, tankrig.Prediction, tankrig.TankrigError, tankrig.load_scene",
        "import tankrig.calibration.pump",
        "from ui.cli import main; main(['--help'])",
        "from ui.cli import main; main(['predict', '--help'])",
        "from ui.cli import main; main(['predict', 'nowhere.toml'])",
    ],
)
def test_nothing_heavy_is_loaded(code: str) -> None:
    loaded = run(f"{code}\nimport sys; print('\\nloaded', *sys.modules)").split("\nloaded ")[1].split()
    assert HEAVY.isdisjoint(loaded), HEAVY.intersection(loaded)


@pytest.mark.long
def test_import_costs_at_most_half_a_second_beyond_numpy() -> None:
    """The fastest of five, as other work on the machine only ever adds."""
    code = "import numpy, time; start = time.perf_counter(); import tankrig; print(time.perf_counter() - start)"
    assert min(float(run(code)) for _ in range(5)) <= 0.5
