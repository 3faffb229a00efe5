"""What the pages show in Python runs: each block, with what its page takes for granted.

Blocks that ask a model of light, or prepare one, are `long`; they are read and their names looked up in every run.
"""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import drivers
import tankrig
from tankrig.calibration import Radiometry, load
from tankrig.devices import CameraSettings
from tankrig.pattern import Sheet, draw
from tankrig.run.journal_io import JOURNAL
from tests.test_docs import BLOCKS, TREE, Block

RUN = TREE / "tests" / "data" / "stored" / "2" / "finished"
CALIBRATION = TREE / "tests" / "data" / "stored" / "1" / "calibration"
SMALL = tankrig.Scene(
    tankrig.Tank(),
    tankrig.Medium(0.002, 0.018, 0.5),
    tankrig.Projector("collimated", tuple(tankrig.Beam((y, y + 16.0), (52.0, 68.0)) for y in (-40.0, 16.0))),
    tankrig.Camera("orthographic", (20, 30), 8.0),
)
"""What a page calls `scene`, in few pixels."""

Names = dict[str, Any]


def nothing() -> Names:
    """The block needs nothing but itself."""
    return {}


def a_run() -> Names:
    """A recorded run under the names that pages give theirs, in this folder."""
    for name in ("runs/2026-11-20T10-00-00", "first"):
        shutil.copytree(RUN / "run", name)
    return {}


def a_line_of_a_journal() -> Names:
    """As it stands in the file."""
    import google_crc32c

    return {"line": (RUN / "run" / JOURNAL).read_bytes().splitlines(keepends=True)[3], "google_crc32c": google_crc32c}


def a_bench() -> Names:
    """A rig file, a pattern, a liquid and an image of it."""
    shutil.copy(RUN / "rig.toml", "rig.toml")
    bench = drivers.load_rig_file("rig.toml").bench
    pattern = draw(Sheet((-60.0, 60.0), (40.0, 80.0)), bench.wall)
    image = tankrig.predict(bench.scene(pattern, SMALL.medium)).image
    return {"drivers": drivers, "tankrig": tankrig, "pattern": pattern, "medium": SMALL.medium, "image": image}


def a_calibrated_camera() -> Names:
    """The file of its radiometry, and raw frames of two exposures."""
    (path,) = CALIBRATION.glob("radiometry-*.toml")
    shape = Radiometry.of(load(path)).hot.shape
    frames = [(np.full(shape, counts, np.uint16), CameraSettings(ms)) for counts, ms in ((400, 20.0), (1000, 60.0))]
    return {"path": path, "pixels": frames[0][0], "frames": frames, "wanted": np.linspace(0.0, 1.0, 5)}


def patterns_for_flash() -> Names:
    """A sequence with three patterns, and a rig."""
    shutil.copy(RUN / "rig.toml", "rig.toml")
    Path("flash").mkdir()
    sheets = "".join(
        f'[patterns.{name}]\nkind = "sheet"\ny_mm = [-60.0, 60.0]\nz_mm = [{z}, {z + 4.0}]\n'
        for name, z in (("a", 40.0), ("b", 50.0), ("c", 60.0))
    )
    step = '[[steps]]\ndo = "burst"\npatterns = ["a", "b", "c"]\n'
    Path("bursts.toml").write_text(f'name = "bursts"\nexposure_ms = 8.6\n{sheets}{step}', encoding="utf-8")
    return {}


def a_scene() -> Names:
    """A scene and its image, with noise."""
    noise = np.random.default_rng(1).normal(0.0, 2e-7, SMALL.camera.shape)
    image = tankrig.predict(SMALL, tolerance=0.002).image + noise
    return {"tankrig": tankrig, "scene": SMALL, "image": image, "medium": SMALL.medium}


LONG = pytest.mark.long
NEEDS: dict[tuple[str, int], tuple[Callable[[], Names], bool]] = {
    ("docs/sequences.md", 0): (nothing, False),
    ("docs/runs.md", 0): (a_run, False),
    ("docs/runs.md", 1): (a_line_of_a_journal, False),
    ("docs/calibration.md", 0): (a_bench, True),
    ("docs/calibration.md", 1): (a_calibrated_camera, False),
    ("docs/devices.md", 0): (patterns_for_flash, False),
    ("docs/estimation.md", 0): (a_scene, True),
    ("docs/prepare.md", 0): (a_scene, True),
    ("docs/advise.md", 0): (nothing, False),
    ("docs/archive.md", 0): (a_run, False),
    ("docs/archive.md", 1): (nothing, False),
    ("docs/first_hour.md", 0): (a_run, False),
}
"""By page and number of the block in it: what it takes for granted, and whether it takes long."""
ELSEWHERE = {
    ("README.md", 0): "below",
    ("docs/archive.md", 2): "needs Tiled, which tankrig does not bring; its names are looked up in test_docs.py",
    ("docs/prepare.md", 1): "test_prepared_phases.py prepares, predicts and fits for any phase function",
    ("docs/separation.md", 1): "test_separation.py fits order 1 of a run's sheets",
    ("docs/separation.md", 0): "test_separation.py has the command do the same to a run with waves",
    **{("docs/write_a_driver.md", number): "test_other_peoples_drivers.py" for number in range(3)},
}


def numbered() -> dict[tuple[str, int], Block]:
    """All Python blocks, by page and number."""
    found: dict[tuple[str, int], Block] = {}
    for block in BLOCKS:
        if block.language == "python":
            found[block.page, sum(page == block.page for page, _ in found)] = block
    return found


PYTHON = numbered()


def test_every_python_block_is_run() -> None:
    assert PYTHON.keys() == NEEDS.keys() | ELSEWHERE.keys()


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=LONG) if takes_long else key for key, (_, takes_long) in NEEDS.items()], ids=str
)
@pytest.mark.timeout(1800)
def test_a_block_runs(key: tuple[str, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    names = NEEDS[key][0]()
    text = PYTHON[key].text
    if NEEDS[key][0] is a_run:
        text = text.replace('"sheet"', '"rays"')  # the pattern of the run that is stored
    exec(compile(text, f"{key[0]} block {key[1]}", "exec"), names)
    if check := CHECKS.get(key):
        check(names)


def flash_has_its_picture(_: Names) -> None:
    assert cv2.imread("flash/0.png").shape == (60, 80, 3)


def file_and_python_say_the_same(names: Names) -> None:
    (shown,) = [block for block in BLOCKS if block.page == "docs/sequences.md" and block.text.startswith("name = ")]
    Path("shown.toml").write_text(shown.text, encoding="utf-8")
    assert tankrig.load_sequence("shown.toml").steps == names["sequence"].steps


def the_liquid_is_found(names: Names) -> None:
    assert names["e"].medium.sigma_s == pytest.approx(SMALL.medium.sigma_s, rel=0.05)


def a_prepared_model_agrees(names: Names) -> None:
    error = np.linalg.norm(names["image"] - a_scene()["image"]) / np.linalg.norm(names["image"])
    assert error < 0.03
    assert names["slopes"].shape == (3, *SMALL.camera.shape)


def certificates_are_private(_: Names) -> None:
    assert [oct(Path(f"{name}.pem").stat().st_mode & 0o777) for name in ("ca", "cert", "key")] == ["0o600"] * 3


def the_sheet_is_there(names: Names) -> None:
    assert names["sheets"].sizes["frame"] == 6
    assert names["run"].events("dose_done")


CHECKS: dict[tuple[str, int], Callable[[Names], None]] = {
    ("docs/devices.md", 0): flash_has_its_picture,
    ("docs/sequences.md", 0): file_and_python_say_the_same,
    ("docs/estimation.md", 0): the_liquid_is_found,
    ("docs/prepare.md", 0): a_prepared_model_agrees,
    ("docs/archive.md", 1): certificates_are_private,
    ("docs/runs.md", 0): the_sheet_is_there,
}


def test_the_readmes_python_runs_and_finds_the_medium(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(TREE)
    names: Names = {}
    exec(compile(PYTHON["README.md", 0].text, "README.md", "exec"), names)
    estimate = names["estimate"]
    assert isinstance(estimate, tankrig.Estimate)
    assert estimate.medium.sigma_s == pytest.approx(0.004, rel=0.03)
    assert sys.modules["tankrig"] is tankrig
