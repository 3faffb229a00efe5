"""What earlier versions have stored opens, resumes, is fitted and reported, and nothing in it is doubted."""

import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import tankrig
from drivers.emulation.truth import read_truth
from drivers.rig import SIMULATED, load_rig_file
from tankrig.calibration.file import all_in, in_force
from tankrig.calibration.geometry_in_force import measured
from tankrig.calibration.pump import load_pump_calibration
from tankrig.calibration.radiometry import Radiometry
from tankrig.dosing import TankLedger
from tankrig.errors import StoreError
from tankrig.light.prepared.cache import Place
from tankrig.run.recovery import recover
from tankrig.run.state import RunStates
from tankrig.sequence import load_sequence
from ui.cli import main

from .doser_bench import NewEraBench

STORED = Path(__file__).parent / "data" / "stored"
VERSIONS = sorted(folder.name for folder in STORED.iterdir() if folder.is_dir())
PUMPS = {"1": "3d94436a", "2": "ae8055c3"}
"""Names that the count files give."""


def having(name: str) -> pytest.MarkDecorator:
    """The versions that stored such data in their own way."""
    return pytest.mark.parametrize("stored", [v for v in VERSIONS if (STORED / v / name).exists()], indirect=True)


@pytest.fixture(params=VERSIONS)
def stored(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A copy of what a version has stored."""
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    shutil.copytree(STORED / request.param, tmp_path / "stored")
    yield tmp_path / "stored"
    subprocess.run(["pkill", "-f", f"emulator.*{tmp_path}"], check=False)


def true_ul(folder: Path) -> float:
    """What the simulated doser has really delivered, once it rests."""
    steps = -1
    while steps != (steps := read_truth(folder / "simulated" / "tank" / "state").steps):
        time.sleep(0.3)
    return steps / 10.0


def resumed(folder: Path, *words: str) -> int:
    """`tankrig run --resume`, as a person gives it, beside the rig file; its waits are over at once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(RunStates, "sleep", lambda states, _: states.check())
        return main(["run", "--resume", "run", "--rig", "rig.toml", "--no-fit", *words])


@pytest.mark.parametrize("name", ["finished", "in-a-wait", "in-a-dose"])
def test_runs_open_and_every_frame_is_what_was_recorded(stored: Path, name: str) -> None:
    run = tankrig.open_run(stored / name / "run")
    frames = run.frames
    assert frames.sizes["frame"] == (8 if name == "finished" else 5)
    assert frames.delivered_ul.values.tolist()[:5] == [0.0, 0.0, 200.0, 200.0, 200.0]
    assert frames.pattern.values.tolist()[:5] == ["rays", "rays", "dark", "rays", "rays"]
    assert frames[1].values.mean() < frames[3].values.mean(), "ink scatters"
    found = recover(stored / name / "run")
    assert (found.frames, found.damaged, found.torn_bytes) == (frames.sizes["frame"], (), 0)
    assert found.finished == (name == "finished")
    assert found.open_dose_ul == (900.0 if name == "in-a-dose" else None)


def test_a_run_that_was_killed_in_a_wait_goes_on_and_asks_nothing(stored: Path) -> None:
    folder = stored / "in-a-wait"
    assert resumed(folder) == 0
    assert true_ul(folder) == 900.0
    assert tankrig.open_run(folder / "run").frames.delivered_ul.values.tolist() == [0.0] * 2 + [200.0] * 3 + [900.0] * 3


def test_a_run_that_was_killed_in_a_dose_goes_on_to_its_target(stored: Path) -> None:
    """By the doser's count, or by a person's word where that is asked for; never twice."""
    folder = stored / "in-a-dose"
    before_ul = true_ul(folder)
    assert 200.0 < before_ul < 900.0
    status = resumed(folder)
    if status == 3:
        assert true_ul(folder) == before_ul
        status = resumed(folder, "--delivered-ul", f"{before_ul:g}")
    assert status == 0
    assert true_ul(folder) == 900.0
    assert tankrig.open_run(folder / "run").frames.delivered_ul.values.tolist() == [0.0] * 2 + [200.0] * 3 + [900.0] * 3


@pytest.mark.parametrize(
    ("stored", "name"),
    [
        *((version, "finished") for version in VERSIONS),
        (VERSIONS[0], "in-a-wait"),
        *(pytest.param(version, "in-a-wait", marks=pytest.mark.long) for version in VERSIONS[1:]),
    ],
    indirect=["stored"],
)
def test_runs_are_fitted_and_reported(stored: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One with the fits that were recorded, one that was recorded without."""
    monkeypatch.chdir(stored / name)
    assert main(["report", "run"]) == 0
    page = (stored / name / "run" / "report.html").read_text(encoding="utf-8")
    assert "σs" in page
    assert "0.2 ml" in page


def test_ledgers_rig_files_and_sequences_are_read(stored: Path) -> None:
    ledger = TankLedger(stored / "in-a-dose" / "simulated" / "tank.ledger")
    assert ledger.tank == (200.0, 200.0, 200.0)
    assert ledger.open_dose is not None
    assert ledger.open_dose.total_ul == 900.0
    ledger.close()
    assert load_sequence(stored / "finished" / "sequence.toml").name == "stored"


@having("calibration")
def test_calibrations_are_read_and_used(stored: Path) -> None:
    found = in_force(stored / "calibration")
    assert set(found) == {"camera", "tank", "projector", "radiometry", "latency"}
    assert not [one for one in all_in(stored / "calibration") if isinstance(one, StoreError)]
    assert Radiometry.of(found["radiometry"]).response.curve[-1] == pytest.approx(1.0)
    bench = measured(load_rig_file(SIMULATED.with_name("bench.toml")).bench, found)
    assert bench.camera != load_rig_file(SIMULATED.with_name("bench.toml")).bench.camera
    pump = load_pump_calibration(stored / "pump.toml")
    assert pump.correction_for("doser", {"steps_per_ul": 10.0}) == pytest.approx(pump.correction)


@having("count-files")
def test_count_files_go_on_counting(stored: Path, request: pytest.FixtureRequest) -> None:
    """The counter of this pump has begun at 0 again since."""
    version = request.node.callspec.params["stored"]
    with NewEraBench(stored / "count-files" / "at-rest", counter_survives=False) as bench:
        doser = bench.open()
        assert doser.identity == f"new-era {PUMPS[version]}"
        held = doser.delivered()
        assert held.low_ul <= 49.7 <= held.high_ul
        assert held.high_ul - held.low_ul < 0.1
        assert 59.0 < doser.dose_to(60.0).volume_ul <= 60.0
    with NewEraBench(stored / "count-files" / "unsure", counter_survives=False) as bench:
        doser = bench.open()
        assert doser.unknown
        held = doser.delivered()
        assert (held.low_ul, held.high_ul) == pytest.approx((24.689, 50.0))


@having("cache")
def test_a_prepared_model_is_read_or_counts_as_missing(stored: Path) -> None:
    """Models of other code count as missing and are made again."""
    files = list((stored / "cache" / "prepared").iterdir())
    assert files
    for file in files:
        found = Place(file.parent, file.stem).kept(file)
        assert found is None or found
