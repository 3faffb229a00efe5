"""What the calibration says is what is exported, and what cannot be of this bench is refused before anything moves."""

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import tankrig
from drivers.calibration_health import calibration_checks
from drivers.rig import SIMULATED, calibrated_bench, load_rig_file, simulated_rig
from tankrig.bench import Bench
from tankrig.calibration.board import Board
from tankrig.calibration.camera import LENS, CameraFound
from tankrig.calibration.edge_blur import Blur
from tankrig.calibration.file import Calibration, in_force, load, save
from tankrig.calibration.places import believed, measured_places
from tankrig.calibration.projector import ProjectorFound
from tankrig.calibration.tank import TankFound
from tankrig.calibration.uncertainty import Named
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose
from tankrig.geometry.refraction import entry_wall
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.loading import whole_scene
from tankrig.scene.writing import scene_text
from ui.cli import main
from ui.cli.raw_picture import Measured, RawPicture

SEQUENCE = """name = "one"
[patterns.ray]
kind = "sheet"
y_mm = [-4.0, 4.0]
z_mm = [40.0, 60.0]
[[steps]]
do = "capture"
pattern = "ray"
"""
CAMERA, PROJECTOR = (540, 960), (384, 512)
NONE = np.zeros((1, 2))


def found_by_hand(
    name: str = "simulated bench",
) -> tuple[Calibration, Callable[[str], Calibration], Callable[..., Calibration]]:
    """Of camera, tank and projector, as the procedures would write them of a bench that needs no picture."""
    lens = Lens(1700.0, 1701.0, 479.0, 270.0)
    known = Named(
        LENS, np.array([1700.0, 1701.0, 479.0, 270.0, 0, 0, 0, 0]), np.diag([0.25, 0.25, 1, 1, 1e-6, 1e-4, 1e-8, 1e-8])
    )
    camera = CameraFound(lens, known, CAMERA, (0.02,), (), NONE, NONE, 0.9, 40.0, Blur(0.6, 0.01)).calibration(
        "camera A"
    )
    names = ("camera.rotation_x", "camera.rotation_y", "camera.rotation_z", "camera.x_mm", "camera.y_mm", "camera.z_mm")
    pose = Pose.looking([120.0, 1.5, 650.0], [120.0, 1.5, 0.0], [0.0, -1.0, 0.0])
    six = np.array([*pose.rotation, *pose.centre_mm, 112.0])
    tank_known = Named((*names, "level_mm"), six, np.diag([1e-6] * 3 + [0.09, 0.16, 0.25, 0.04]))
    tank = TankFound(pose, 112.0, 1.33, tank_known, 0.02, 0.02, (0.03,), NONE, NONE, CAMERA)
    beam = Pose.looking([-400.0, 3.0, 55.0], [0.0, 0.0, 57.0], [0.0, 0.0, -1.0])
    own = (*LENS, "rotation_x", "rotation_y", "rotation_z", "x_mm", "y_mm", "z_mm", "wall_mm", "wall_index")
    light = Named(own, np.zeros(len(own)), np.eye(len(own)) * 0.01)
    projector = ProjectorFound(
        Lens(1000.0, 1000.0, 255.0, 191.0), beam, entry_wall(1.33, 6.0, 1.52), PROJECTOR, light, (0.03,), NONE, NONE,
        0.5, blur=Blur(0.7, 0.02),
    )  # fmt: skip
    return (
        replace(camera, rig=name),
        lambda hashed: replace(tank.calibration("camera A", {"camera": hashed}), rig=name),
        lambda camera, tank: replace(projector.calibration("projector A", {"camera": camera, "tank": tank}), rig=name),
    )


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A rig file with calibrations of its geometry; not of its radiometry."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "rig.toml"
    file.write_text(SIMULATED.with_name("bench.toml").read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "one.toml").write_text(SEQUENCE, encoding="utf-8")
    folder = Path(load_rig_file(file).calibration_folder)
    first, second, third = found_by_hand()
    camera = save(first, folder)
    tank = save(second(camera.hash), folder)
    save(third(camera.hash, tank.hash), folder)
    return file


def exported(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    assert main(["scene", "--pattern", "ray", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_scene_that_is_exported_is_the_one_that_a_run_is_fitted_by(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = exported(capsys, "--rig", str(rig), "--sequence", "one.toml", "--bin", "12", "--medium", "0.0003,0.02,0.6")
    assert told["binning"] == 12
    read = tankrig.load_scene(told["path"])
    bench, medium = calibrated_bench(load_rig_file(rig)), Medium(0.0003, 0.02, 0.6)
    from tankrig.sequence import load_sequence

    pattern = load_sequence("one.toml").drawn(bench.wall)["ray"]
    used = bench.scene(pattern, medium)
    assert read.medium == medium
    assert read.tank == used.tank
    assert read.camera == replace(used, camera=used.camera.binned(12)).camera
    assert whole_scene(told["path"]).camera == replace(used.camera, bin=12)
    assert read.camera.blur.sigma_mm == pytest.approx(0.6 * used.camera.pixel_mm)
    assert read.projector.blur.sigma_mm == pytest.approx(0.7 * 0.4, rel=0.05)  # 400 mm away, 1000 px of focal length
    left_px = math.sqrt(2.0 * 0.6 * 0.01), math.sqrt(2.0 * 0.7 * 0.02)  # by so much these may be off
    assert read.camera.blur_mm == pytest.approx(left_px[0] * used.camera.pixel_mm)
    assert read.projector.blur_mm == pytest.approx(left_px[1] * 0.4, rel=0.05)
    ours, theirs = (
        [(*one.y_mm, *one.z_mm, one.irradiance) for one in each.projector.beams] for each in (read, used)
    )  # through a picture of 16 bits
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-4)
    (camera_file,) = Path(load_rig_file(rig).calibration_folder).glob("camera-*.toml")
    text = Path(told["path"]).read_text(encoding="utf-8")
    assert f"# Rests on the calibration of the camera, {camera_file.name} ({load(camera_file).hash[:12]}" in text
    assert "# Measured: camera stands at (120.00 ± 0.30, 1.50 ± 0.40, 650.00 ± 0.50) mm." in text
    assert "# Each ± above is a standard deviation." in text
    assert "there is no calibration of the radiometry" in text
    assert not any("placeholder" in line for line in told["believed"])
    assert any(
        "placeholder" in line for line in exported(capsys, "--rig", str(rig), "--sequence", "one.toml")["believed"]
    )


def test_what_was_not_measured_is_said_and_the_believed_is_used(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(load_rig_file(rig).calibration_folder)
    told = exported(capsys, "--rig", str(rig), "--sequence", "one.toml", "--bin", "auto")
    assert (told["measured"], told["rests_on"]) == ([], {})
    assert "no calibration of the camera or the tank or the projector" in told["believed"][0]
    assert tankrig.load_scene(told["path"]).projector.kind == "pinhole"
    assert told["binning"] > 1


def test_without_a_rig_the_scene_is_of_the_rig_that_a_run_without_one_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was of the simulated bench, with a glass wall and a gamma: a prediction was not of the run just made."""
    monkeypatch.chdir(tmp_path)
    assert main(["scene", "--pattern", "full", "--json"]) == 0
    told = capsys.readouterr()
    assert "the simulated rig" in told.err
    bench = simulated_rig(tmp_path / "run.rig").bench
    read = tankrig.load_scene(json.loads(told.out)["path"])
    assert (read.tank, read.camera, read.projector.kind) == (bench.tank, bench.camera, bench.light)


def test_a_pattern_that_is_not_there_is_named(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "--rig", str(rig), "--pattern", "rays", "--sequence", "one.toml"]) == 2
    assert 'one.toml: pattern "rays" is unknown; did you mean "ray"?' in capsys.readouterr().err
    for words in (["--bin", "0"], ["--medium", "1,2"]):
        assert main(["scene", "--rig", str(rig), "--pattern", "full", *words]) == 2


def text_of_a_scene() -> str:
    beams = (Beam((-2.0, 2.0), (58.0, 62.0)),)
    camera = Camera("orthographic", (80, 120), 2.0)
    return scene_text(Scene(Tank(), Medium(0.0, 0.01, 0.3), Projector("collimated", beams), camera))


def damaged(folder: Path, how: str) -> str:
    """Spoil the calibrations; what must be said."""
    kind = {"chain": "camera", "gone": "camera", "covariance": "tank"}.get(how, "projector")
    (file,) = folder.glob(f"{kind}-*.toml")
    one = load(file)
    if how == "rig":
        again, said = replace(one, rig="rig of next door"), "was measured on rig rig of next door, and this is rig"
    elif how == "resolution":
        again, said = replace(one, shape=(768, 1024)), "was measured with [768, 1024] pixels (rows, columns)"
    elif how == "device":
        file, one = (found := next(folder.glob("tank-*.toml"))), load(found)
        again, said = replace(one, device="camera B"), "so they are not of one bench"
    elif how == "covariance":
        spoilt = one.arrays["covariance"].copy()
        spoilt[0, 1] = spoilt[1, 0] = 5.0
        again, said = replace(one, arrays={**one.arrays, "covariance": spoilt}), "its covariance is damaged (it is not"
    elif how == "chain":
        again, said = replace(one, date="2027-01-01T00:00:00+00:00"), "rests on another calibration of the camera"
    else:
        again, said = None, "rests on a calibration of the camera that is not there"
    if how != "chain":
        file.unlink()
    if again is not None:
        kept = save(again, folder, accept=True)
        if file.stem.startswith("tank") and how in ("device", "covariance"):  # what rests on it follows
            (on_it,) = folder.glob("projector-*.toml")
            follows = load(on_it)
            on_it.unlink()
            save(replace(follows, rests_on={**follows.rests_on, "tank": kept.hash}), folder, accept=True)
    return said


@pytest.mark.parametrize("how", ["rig", "resolution", "device", "covariance", "chain", "gone"])
def test_calibrations_that_cannot_be_of_this_bench_are_refused_before_anything_moves(
    rig: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, how: str
) -> None:
    """A lens of another camera would put everything in the wrong place, and the fit would look fine."""
    said = damaged(Path(load_rig_file(rig).calibration_folder), how)
    (tmp_path / "scene.toml").write_text(text_of_a_scene(), encoding="utf-8")
    np.save(tmp_path / "frame.npy", np.full((80, 120), 500, np.uint16))
    there = sorted(tmp_path.rglob("*"))
    for command in (
        ["scene", "--rig", str(rig), "--pattern", "full"],
        ["run", "one.toml", "--rig", str(rig), "--out", "run"],
        ["run", "one.toml", "--rig", str(rig), "--out", "run", "--dry-run"],
        ["fit", "frame.npy", "--scene", "scene.toml", "--rig", str(rig), "--exposure-ms", "20"],
    ):
        assert main(command) == 2
        told = capsys.readouterr().err
        assert said in told
        assert told.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == there
    failed = [check for check in calibration_checks(load_rig_file(rig), {}) if check.passed is False]
    assert any(said in check.finding for check in failed)


LENSES: list[tuple[str, dict[str, Any], str]] = [
    ("camera", {"blur_px": -1.0}, "sigma_mm = -0.3"),
    ("camera", {"blur_px": "wide"}, "is no calibration of the camera"),
    ("projector", {"halo_share": 0.4, "halo_sigma_px": 40.0}, "share = 0.4 is outside 0 … 0.2"),
    ("projector", {"halo_share": 0.1}, "has no 'halo_sigma_px'"),
    ("projector", {"pane_mm": -6.0}, "wall_mm = -6.0 is negative"),
    ("stray", {"halo_share": 0.3, "halo_sigma_px": 50.0, "veil": 0.0}, "share = 0.3 is outside 0 … 0.2"),
    ("stray", {"halo_share": 0.02, "halo_sigma_px": 0.0, "veil": 0.0}, "sigma_mm = 0.0 is not positive"),
    ("stray", {"halo_share": 0.02, "halo_sigma_px": 50.0, "veil": 2.0}, "veil = 2.0 is outside 0 … 0.5"),
    ("stray", {"halo_share": "much", "halo_sigma_px": 50.0, "veil": 0.0}, "is no calibration of the stray"),
    ("stray", {"halo_share": 0.02}, "has no 'halo_sigma_px'"),
]


@pytest.mark.parametrize(("kind", "told", "said"), LENSES)
def test_a_lens_that_cannot_be_is_refused_with_the_file_that_says_it(
    rig: Path, capsys: pytest.CaptureFixture[str], kind: str, told: dict[str, Any], said: str
) -> None:
    """Whole files of another program, or of an older one: a share of 30 % was refused without saying of what."""
    folder = Path(load_rig_file(rig).calibration_folder)
    (camera,) = folder.glob("camera-*.toml")
    if kind == "stray":
        one = load(camera)
        save(replace(one, kind="stray", result=told, arrays={}, rests_on={}), folder, accept=True)
    else:
        file = next(folder.glob(f"{kind}-*.toml"))
        one = load(file)
        file.unlink()
        hashes = {"camera": save(replace(one, result={**one.result, **told}), folder, accept=True).hash}
        for other in ("tank", "projector") if kind == "camera" else ():
            file = next(folder.glob(f"{other}-*.toml"))
            follows = load(file)
            file.unlink()
            resting = {**follows.rests_on, **{name: hashes[name] for name in follows.rests_on}}
            hashes[other] = save(replace(follows, rests_on=resting), folder, accept=True).hash
    assert main(["scene", "--rig", str(rig), "--pattern", "ray", "--sequence", "one.toml"]) == 2
    told_so = capsys.readouterr().err
    assert said in told_so
    assert f"{kind}-" in told_so
    assert told_so.count("\n") == 1


def test_files_from_before_covariances_are_used_and_say_so(rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(load_rig_file(rig).calibration_folder)
    hashes: dict[str, str] = {}
    for kind in ("camera", "tank", "projector"):
        (file,) = folder.glob(f"{kind}-*.toml")
        one = load(file)
        file.unlink()
        result = {name: value for name, value in one.result.items() if name not in ("covariance_of", "blur_px")}
        older = replace(
            one, result=result, arrays={}, rig="", rests_on={other: hashes[other] for other in one.rests_on}
        )
        hashes[kind] = save(older, folder).hash
    told = exported(capsys, "--rig", str(rig), "--sequence", "one.toml")
    assert sum("blur of the" in line for line in told["believed"]) == 2
    notes = {one.note for one in measured_places(in_force(folder)) if one.what == "camera stands at"}
    assert any("errors of what it rests on" in note for note in notes)
    assert tankrig.load_scene(told["path"]).camera.blur_mm is None


def test_scene_files_are_read_as_the_scene_that_was_written(tmp_path: Path) -> None:
    """Of plain benches, too, whose beams stand in the file."""
    text = SIMULATED.read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    bench: Bench = load_rig_file(tmp_path / "rig.toml").bench
    from tankrig.sequence import Capture, Sequence

    pattern = Sequence("one", (Capture("full"),)).drawn(bench.wall)["full"]
    scene = bench.scene(pattern, Medium(0.0, 0.01, 0.3))
    file = tmp_path / "scene.toml"
    file.write_text(scene_text(scene, ["what it is"]), encoding="utf-8")
    assert tankrig.load_scene(file) == scene
    assert believed(bench, {})[0].startswith("where camera, water and projector are is only believed")


def test_report_and_window_show_what_was_measured_and_not_what_was_believed(
    rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With its uncertainty and its file; the rig file's place of the light is not shown any more."""
    from dataclasses import asdict

    from tankrig.calibration.file import FOLDER, copy_to
    from tankrig.report.settings import settings_of
    from tankrig.run.reading import Run
    from tankrig.sequence import load_sequence
    from tankrig.sequence.loading import sequence_table
    from ui.window.calibration_known import known_of

    description = load_rig_file(rig)
    lines = {one.what: (one.value, one.note) for one in known_of(description, rig, tmp_path)}
    assert lines["camera stands at"][0] == "(120.00 ± 0.59, 1.50 ± 0.78, 650.00 ± 0.98) mm (95 %)"
    assert lines["camera stands at"][1].startswith("tank-")
    assert "light" not in lines
    found = in_force(Path(description.calibration_folder))
    bench = json.loads(json.dumps(asdict(calibrated_bench(description))))
    settings = {
        "bench": bench, "sequence": sequence_table(load_sequence("one.toml")), "rig": description.name,
        "calibrations": {kind: one.hash for kind, one in found.items()},
    }  # fmt: skip
    for one in found.values():
        copy_to(one, tmp_path / "run" / FOLDER)
    run = Run(tmp_path / "run", settings, ())
    monkeypatch.setattr(Run, "frames", np.zeros((0, *CAMERA)), raising=False)
    monkeypatch.setattr(Run, "patterns", {}, raising=False)
    _, geometry, measured = (dict(pairs) for pairs in settings_of(run))
    assert geometry["light"] == "calibrated at (-400, 3, 55) mm"
    assert "-16" not in geometry["projector"]
    assert measured["camera stands at"].startswith("(120.00 ± 0.30, 1.50 ± 0.40, 650.00 ± 0.50) mm (tank-")
    assert measured["water level"].startswith("112.00 ± 0.20 mm (tank-")
    assert measured["each ±"] == "is a standard deviation"
    shutil.rmtree(tmp_path / "run" / FOLDER)
    assert "cannot be told" in settings_of(run)[2][0][1]


def test_the_scene_of_a_run_is_the_one_that_it_was_recorded_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the rig file has become since."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "rig.toml"
    file.write_text(SIMULATED.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "one.toml").write_text(SEQUENCE, encoding="utf-8")
    assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", "--no-fit"]) == 0
    capsys.readouterr()
    then = load_rig_file(file).bench
    file.write_text(file.read_text(encoding="utf-8").replace("[240.0, 160.0, 120.0]", "[240.0, 160.0, 118.0]"))
    told = exported(capsys, "run", "--out", "of_run.toml", "--medium", "0.0,0.01,0.3")
    assert tankrig.load_scene("of_run.toml").tank == then.tank
    assert told["believed"][0].startswith("where camera, water and projector are is only believed")
    assert main(["scene", "run", "--pattern", "stripes"]) == 2
    assert 'has no pattern "stripes"; it has ray' in capsys.readouterr().err


def test_a_fit_tells_a_board_from_ink_and_a_camera_that_has_moved(
    rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A fit of the wrong picture, or by the wrong place of the camera, ends in numbers that look like any others."""
    import cv2

    scene = exported(capsys, "--rig", str(rig), "--sequence", "one.toml")["path"]
    print_out = np.pad(Board().picture(2.0), 60, constant_values=255)
    frame = np.full(CAMERA, 200, np.uint8)
    frame[: print_out.shape[0], : print_out.shape[1]] = print_out[: CAMERA[0], : CAMERA[1]]
    cv2.imwrite("board.png", frame.astype(np.uint16) * 60)
    words = ["fit", "board.png", "--scene", scene, "--exposure-ms", "10", "--out", "out"]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "board.png: it shows a calibration's board" in said
    assert main([*words, "--rig", str(rig)]) == 2
    assert "radiometry is not calibrated" in capsys.readouterr().err
    assert not Path("out").exists()
    there = whole_scene(scene)
    camera = there.camera
    measured = Measured(rig, cast(Any, None), "radiometry.toml", camera)
    assert RawPicture(10.0, 1.0, None, measured, False).notes(there, Path(scene)) == []
    x, y, z = camera.position_mm or (0.0, 0.0, 0.0)
    moved = replace(there, camera=replace(camera, position_mm=(x + 3.0, y, z + 4.0)))
    (note,) = RawPicture(10.0, 1.0, None, measured, False).notes(moved, Path(scene))
    assert "stands 5 mm from where" in note
    assert "export the scene anew" in note
    assert "radiometry is not applied" in RawPicture(10.0, 1.0, None, None, False).notes(there, Path(scene))[0]
