"""What is missing before a fitted run is told in order, and what would spoil one is refused before anything moves."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from drivers.check import Check
from drivers.rig import SIMULATED, RigFile, load_rig_file, open_light, open_rig
from drivers.simulated.bench_poses import PLACES, Place
from tankrig.bench import Bench
from tankrig.calibration.board import LEAST_MARKERS, markers_of_any_board
from tankrig.calibration.witness import require_no_board
from tankrig.devices import Delivered
from tankrig.dosing import TankLedger
from tankrig.dosing.records import JointCount
from tankrig.errors import ImageError, SequenceError
from tankrig.live import preparing as live_preparing
from tankrig.live.light_seen import require_light_seen
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import LOOK, is_kept
from tankrig.pattern.kinds import Dark, GrayCode, Sheet
from tankrig.pattern.wall import Wall
from tankrig.run.reading import open_run
from tankrig.run.start import new_run
from tankrig.scene import Camera, Tank
from tankrig.sequence import Capture, ExposureRule, Sequence, load_sequence
from ui.calibration_way import CALIBRATIONS, Step
from ui.cli import main
from ui.cli.way import next_step, way

from .test_calibration_in_force import CALIBRATED

BENCH = SIMULATED.with_name("bench.toml")
SEQUENCE = SIMULATED.with_name("bench_dilution.toml")
NEW_BENCH = load_rig_file(BENCH, beside=Path("/nowhere"))
PARTS = ("devices", "light", *CALIBRATIONS, "exposure", "rig file")


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A bench in a hurry."""
    file = tmp_path / "rig.toml"
    text = BENCH.read_text(encoding="utf-8").replace("time_scale = 0.2", "time_scale = 0.01")
    file.write_text(text, encoding="utf-8")
    return file


# -- the way -----------------------------------------------------------------------------------------------------------


def looked_at(found: dict[str, bool | None]) -> list[Check]:
    return [
        Check(f"{part} looked at", passed, "as found", "mend it --rig FILE", part) for part, passed in found.items()
    ]


def require_typed(steps: list[Step]) -> None:
    """What is to be typed names this rig, and stands where something is left to do."""
    assert not any(step.command for step in steps if step.done)
    assert all(step.command for step in steps if not step.done and step.wanted)
    assert not any("FILE" in step.command for step in steps)


@given(st.fixed_dictionaries({part: st.sampled_from([True, None, False]) for part in PARTS}))
@settings(max_examples=40, deadline=None)
def test_the_next_step_is_the_first_that_has_to_be_done(found: dict[str, bool | None]) -> None:
    """Whoever follows the last line again and again comes to a run, and mends first what is broken."""
    steps = way(NEW_BENCH, looked_at(found), Path("my rig.toml"))
    following = next_step(steps)
    assert following is not None
    broken = [part for part in PARTS if found[part] is False]
    missing = [kind for kind in CALIBRATIONS if found[kind] is None]
    if not broken and not missing:
        assert following.command == "tankrig run SEQUENCE --rig 'my rig.toml' --dry-run"
    else:
        first = broken[0] if broken else missing[0]
        wanted = f"tankrig calibrate {first}" if first in CALIBRATIONS else "mend it"
        assert following.command == f"{wanted} --rig 'my rig.toml'"
    require_typed(steps)


@pytest.mark.parametrize("missing", [None, CALIBRATIONS[0]])
def test_with_a_sequence_that_can_be_carried_out_the_run_comes_after_all_that_is_missing(missing: str | None) -> None:
    checks = looked_at({part: None if part == missing else True for part in PARTS})
    steps = way(NEW_BENCH, checks, Path("my rig.toml"), SEQUENCE)
    following = next_step(steps)
    assert following is not None
    wanted = f"calibrate {missing}" if missing else f"run {SEQUENCE}"
    assert following.command == f"tankrig {wanted} --rig 'my rig.toml'"
    require_typed(steps)


def test_a_new_bench_is_told_to_begin_with_the_lens_cap(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(rig), "--no-light", "--sequence", str(SEQUENCE)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == f"next: tankrig calibrate radiometry --rig {rig}"
    assert [f"    → tankrig calibrate {kind} --rig {rig}" in lines for kind in CALIBRATIONS] == [True] * len(
        CALIBRATIONS
    )
    assert main(["doctor", str(rig), "--no-light", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["next"] == f"tankrig calibrate radiometry --rig {rig}"
    assert [step["done"] for step in told["way"]][-1] is None


def test_a_sequence_that_cannot_be_carried_out_is_found_by_the_doctor(
    rig: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "too much.toml"
    file.write_text('name = "much"\n[[steps]]\ndo = "dose"\ntotal_ul = 3000.0\n')
    assert main(["doctor", str(rig), "--no-light", "--sequence", str(file)]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert f"✗ the sequence can be carried out: {file}: dose to 3000 µl: one dose may have" in told


# -- ink where a board is to be seen -----------------------------------------------------------------------------------


def inked(rig: RigFile, volume_ul: float) -> None:
    ledger = TankLedger(rig.ledger)
    none, held = Delivered(0.0, 0.0, 0.0), Delivered(volume_ul, volume_ul, volume_ul)
    ledger.join(JointCount("doser", none, none))
    ledger.begin("run", volume_ul)
    ledger.end(held)
    ledger.close()


@pytest.mark.parametrize("command", [["tank"], ["projector"]])
def test_boards_are_not_looked_at_through_ink(
    rig: Path, command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A level or a lens measured through ink is wrong, and nothing would say so."""
    words = ["calibrate", *command, "--rig", str(rig)]
    assert main(words) == 2
    assert "no calibration of the camera yet" in capsys.readouterr().err
    inked(load_rig_file(rig), 350.0)
    assert main(words) == 3
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "says that the tank holds 350 µl of ink" in said
    assert main([*words, "--clear-water"]) == 2
    assert "no calibration of the camera yet" in capsys.readouterr().err
    assert not list(rig.parent.rglob("*.png")), "nothing was measured"


# -- a board where ink is to be seen -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory):
    file = tmp_path_factory.mktemp("bench") / "rig.toml"
    file.write_text(BENCH.read_text(encoding="utf-8").replace("time_scale = 0.2", "time_scale = 0.001"))
    with open_light(load_rig_file(file)) as devices:
        yield devices


@given(st.sampled_from(PLACES), st.integers(0, 20))
@settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_board_that_is_left_before_the_camera_is_seen_wherever_it_is(opened, place: Place, number: int) -> None:
    projector, camera = opened
    camera.hold(place, number)
    with pytest.raises(ImageError, match=r"sees a calibration's board, \d+ markers of DICT_4X4_100"):
        require_no_board(projector, camera, ExposureRule())


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.2), st.integers(2, 60))
@settings(max_examples=15, deadline=None)
def test_ink_under_whatever_pattern_is_taken_for_no_board(seed: int, noise: float, period: int) -> None:
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:180, :240]
    lit = (y // period + (x // period if seed % 3 == 0 else 0)) % 2
    picture = 8000.0 * lit * np.exp(-x / 300.0) * (1.0 + noise * random.standard_normal(y.shape)) + 100.0
    assert markers_of_any_board(picture, 16383)[0] < LEAST_MARKERS


def test_a_run_does_not_begin_while_a_board_is_before_the_camera(rig: Path, tmp_path: Path) -> None:
    devices = open_rig(load_rig_file(rig))
    shape = devices.projector.shape
    wall, projector = replace(CALIBRATED.wall, shape=shape), replace(CALIBRATED.projector, shape=shape)
    held = replace(devices, bench=replace(CALIBRATED, wall=wall, projector=projector))
    devices.camera.hold("flooded slant", 2)
    with pytest.raises(ImageError, match="take the board away"):
        new_run(Sequence("one", (Capture("dark"),)), held, tmp_path / "run")
    assert not (tmp_path / "run").exists()


# -- light that the camera does not see --------------------------------------------------------------------------------


@given(st.integers(1, 79), st.floats(-79.0, 70.0), st.floats(2.5, 60.0))
@settings(max_examples=100, deadline=None)
def test_patterns_beside_the_picture_are_refused_and_all_others_taken(rows: int, low: float, width: float) -> None:
    """The camera sees −80 mm … −80 mm + 2 mm · rows; light goes straight along x."""
    bench = Bench(
        Tank(), Wall((120, 160), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (rows, 120), 2.0)
    )
    sheet = Sheet((low, min(low + width, 80.0)), (50.0, 60.0))
    sequence = Sequence("one", (Capture("dark"), Capture("sheet")), {"sheet": sheet})
    lit = sequence.drawn(bench.wall)["sheet"].pixels.any(axis=0)
    first_mm = -80.0 + float(np.flatnonzero(lit)[0])
    beyond_mm = first_mm - (-80.0 + 2.0 * rows)
    assume(abs(beyond_mm) > 1e-6)
    if beyond_mm < 0.0:
        require_light_seen(sequence, bench)
    else:
        with pytest.raises(
            SequenceError, match='one: capture sheet: pattern "sheet" cannot be fitted: it lights nothing that the'
        ):
            require_light_seen(sequence, bench)


def test_a_calibrated_projector_that_lights_beside_the_tank_is_refused_and_what_is_meant_dark_is_not() -> None:
    low = Sheet((-18.0, 18.0), (0.0, 3.0))
    patterns = {"low": low, "black": Dark(), "code": GrayCode(0)}
    beside = replace(CALIBRATED, projector=replace(CALIBRATED.projector, position_mm=(-300.0, 0.0, 400.0)))
    require_light_seen(Sequence("one", (Capture("low"), Capture("black"), Capture("code")), patterns), CALIBRATED)
    require_light_seen(Sequence("one", (Capture("black"),), patterns), beside)
    with pytest.raises(SequenceError, match='pattern "low" cannot be fitted: it lights nothing in the tank'):
        require_light_seen(Sequence("one", (Capture("low"),), patterns), beside)


def test_the_dry_run_and_the_run_name_the_dark_pattern_and_make_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import cv2

    monkeypatch.chdir(tmp_path)
    cv2.imwrite("black.png", np.zeros((480, 640), np.uint8))
    steps = "".join(f'[[steps]]\ndo = "capture"\npattern = "{name}"\n' for name in ("dark", "full", "shape"))
    Path("one.toml").write_text(f'name = "one"\n[patterns.shape]\nkind = "image"\npath = "black.png"\n{steps}')
    there = sorted(tmp_path.rglob("*"))
    for words in (["--dry-run"], []):
        assert main(["run", "one.toml", "--out", "run", *words]) == 2
        said = capsys.readouterr()
        assert re.fullmatch(
            r'tankrig: one.toml: capture shape: pattern "shape" cannot be fitted: it lights nothing, all .*\n',
            said.err,
        )
        assert said.out == ""
    assert sorted(tmp_path.rglob("*")) == there


# -- models before the run ---------------------------------------------------------------------------------------------


def test_what_is_prepared_before_a_run_is_what_its_fit_asks_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Models that were made for nothing would cost the person who waits for the first fit twice."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    rig, sequence = tmp_path / "rig.toml", tmp_path / "sheet.toml"
    rig.write_text(SIMULATED.read_text(encoding="utf-8"), encoding="utf-8")
    sequence.write_text(
        'name = "sheet"\n[patterns.sheet]\nkind = "sheet"\ny_mm = [-60.0, 60.0]\nz_mm = [58.0, 62.0]\n'
        '[[steps]]\ndo = "dose"\ntotal_ul = 100.0\n[[steps]]\ndo = "capture"\npattern = "sheet"\n'
    )
    words = ["prepare", "--sequence", str(sequence), "--rig", str(rig)]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said | {"seconds": 0} == {"models": 1, "kept": 0, "seconds": 0, "notes": []}
    devices = open_rig(load_rig_file(rig))
    runner = new_run(load_sequence(sequence), devices, tmp_path / "run")
    runner.give_up(KeyboardInterrupt())
    plan = PhotographPlan.of_run(open_run(tmp_path / "run"))
    assert [is_kept(scene, LOOK) for scene in plan.scenes.values()] == [True]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kept"] == 1
    monkeypatch.setattr(live_preparing, "unlike_learned", lambda *_: "another bench was learned")
    assert main(words) == 0
    assert capsys.readouterr().out.splitlines()[1:] == ["note     another bench was learned"]
    assert main(["prepare", "--sequence", str(sequence)]) == 2
    assert main(["prepare"]) == 2
