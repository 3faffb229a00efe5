"""Camera, tank and projector are found on benches whose truth is hidden; bad pictures are named."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.rig import SIMULATED, load_rig_file
from drivers.simulated.bench_optics import camera_rays, projector_pixels
from drivers.simulated.bench_truth import TANK_MM, TrueOptics, random_bench
from tankrig.calibration.board import BoardView, find_board
from tankrig.calibration.camera import calibrate_camera
from tankrig.calibration.gray_code import decode, gray_code_patterns
from tankrig.calibration.lit_corners import lit_corners
from tankrig.calibration.pictures import Pictures
from tankrig.calibration.projector import calibrate_projector
from tankrig.calibration.tank import calibrate_tank
from tankrig.errors import CalibrationError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, rotation_vector
from tankrig.geometry.refraction import entry_wall
from tankrig.geometry.view import pixels_of
from tankrig.scene.description import Medium
from ui.cli import main

from .calibrated_bench import (
    BOARD,
    SMALL,
    Photographer,
    calibrated,
    light_errors,
    points_and_pixels,
    position_errors_mm,
    shortcut_errors_mm,
)

SATURATION = 4095


@pytest.fixture(scope="module")
def photographer() -> Photographer:
    return Photographer(random_bench(1, *SMALL))


@pytest.fixture(scope="module")
def air_views(photographer: Photographer) -> list[BoardView]:
    return [photographer.view("air", number) for number in range(9)]


# The camera


def test_too_few_or_mixed_views_are_refused(air_views: list[BoardView]) -> None:
    with pytest.raises(CalibrationError, match="3 good views are too few; take at least 6"):
        calibrate_camera(air_views[:3], BOARD)
    with pytest.raises(CalibrationError, match="of different resolutions"):
        calibrate_camera([*air_views[:6], replace(air_views[6], shape=(720, 960))], BOARD)


def test_parallel_views_are_refused(photographer: Photographer) -> None:
    """From them focal length and distance cannot be told apart."""
    laid = [photographer.view("floor", 0) for _ in range(7)]
    with pytest.raises(CalibrationError, match=r"the views are too much alike.*tilt it by 30° to all four sides"):
        calibrate_camera(laid, BOARD)


def test_a_view_that_does_not_fit_is_left_out(air_views: list[BoardView]) -> None:
    """The board moved while it was exposed, say."""
    shaken = air_views[2].corners_px + np.random.default_rng(0).normal(0.0, 1.5, air_views[2].corners_px.shape)
    found = calibrate_camera([*air_views[:2], replace(air_views[2], corners_px=shaken), *air_views[3:]], BOARD)
    assert found.left_out == (2,)
    assert found.rms_px < 0.1
    assert not found.doubts


def test_a_board_seen_in_one_corner_only_leaves_doubts(air_views: list[BoardView]) -> None:
    near = [replace(view, shape=(1080, 1440)) for view in air_views]
    assert any("show it along its edges" in doubt for doubt in calibrate_camera(near, BOARD).doubts)


# The tank


def test_a_moved_board_is_noticed(photographer: Photographer, air_views: list[BoardView]) -> None:
    """Between the empty tank and the flooded one, by 5 mm."""
    lens = calibrate_camera(air_views, BOARD).lens
    floor, flooded = photographer.view("floor", 0), photographer.view("flooded", 0)
    moved = replace(flooded, corners_px=flooded.corners_px + np.array([8.0, 0.0]))
    with pytest.raises(CalibrationError, match="without moving board, tank or camera"):
        calibrate_tank([("floor", floor), ("flooded", moved)], BOARD, lens, TANK_MM)
    for views in ([("flooded", flooded)], [("floor", floor)]):
        with pytest.raises(CalibrationError, match="one view of the board on the floor of the empty tank, and one"):
            calibrate_tank(views, BOARD, lens, TANK_MM)


# The projector


def test_a_board_outside_the_light_is_not_used(photographer: Photographer) -> None:
    patterns = gray_code_patterns(SMALL[1])
    frames = photographer.frames("flooded slant", 1, patterns)
    dark = [frame.copy() for frame in frames]
    for frame in dark[1:]:
        frame[:, :290] = dark[1][:, :290]  # to the left of it the projector's light does not fall
    dark[0][:, :290] = dark[1][:, :290]
    view = find_board(frames[0], BOARD, SATURATION)
    found = lit_corners(view, decode(dark, SMALL[1], SATURATION), BOARD)
    assert found.lit < 0.3
    assert found.fault is not None
    assert "move the board into it" in found.fault
    whole = lit_corners(view, decode(frames, SMALL[1], SATURATION), BOARD)
    assert (whole.lit, whole.fault) == (1.0, None)
    nowhere = Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(CalibrationError, match="3 good views are too few"):
        calibrate_projector([whole] * 3, BOARD, Lens(1, 1, 0, 0), nowhere, None, entry_wall(1.33), SMALL[1], TANK_MM)


# All together


def _believed(optics: TrueOptics) -> tuple[Lens, Pose]:
    x, y, z = optics.translation_mm.tolist()
    return Lens.of(optics.matrix, optics.distortion), Pose(rotation_vector(optics.rotation), (x, y, z))


def test_the_twin_bends_light_as_geometry_does() -> None:
    """Two implementations that share no formula."""
    bench = random_bench(4, *SMALL)
    points, seen_px, lit_px = points_and_pixels(bench, 300)
    wall = entry_wall(bench.water_index, bench.pane_mm, bench.pane_index)
    assert np.abs(pixels_of(*_believed(bench.projector), points, wall) - lit_px).max() < 1e-6
    start, way = camera_rays(bench, seen_px, filled=False)
    in_air = start + 300.0 * way
    assert np.abs(pixels_of(*_believed(bench.camera), in_air) - seen_px).max() < 1e-6
    empty = entry_wall(1.0, bench.pane_mm, bench.pane_index)
    through_glass, _ = projector_pixels(bench, points, filled=False)
    assert np.abs(pixels_of(*_believed(bench.projector), points, empty) - through_glass).max() < 1e-6


@pytest.mark.long
def test_twenty_benches(capsys: pytest.CaptureFixture[str]) -> None:
    """The figures of docs/calibration.md: a camera of 960 × 540, a projector of 512 × 384 pixels."""
    shapes = (540, 960), (384, 512)
    errors: dict[str, list[float]] = {"camera": [], "projector": [], "both": []}
    rms, shortcut, light = [], [], []
    for seed in range(20):
        found = calibrated(seed, shapes)
        rms.append([found.camera.rms_px, found.tank.rms_px, found.projector.rms_px])
        at_95 = {name: float(np.quantile(one, 0.95)) for name, one in position_errors_mm(found).items()}
        for name, value in at_95.items():
            errors[name].append(value)
        light.append(float(np.sqrt(np.mean(light_errors(found) ** 2))))
        shortcut.append([float(np.quantile(shortcut_errors_mm(found.bench, off), 0.95)) for off in (-50.0, 50.0)])
        with capsys.disabled():
            level = found.tank.level_mm - found.bench.level_mm
            print(
                f"bench {seed:2d}: rms px camera {rms[-1][0]:.3f} tank {rms[-1][1]:.3f} projector {rms[-1][2]:.3f}; "
                f"level {level:+.2f} mm; 95 % within mm: camera {at_95['camera']:.2f} projector "
                f"{at_95['projector']:.2f} both {at_95['both']:.2f}; one plane's homography 50 mm off "
                f"{max(shortcut[-1]):.1f}; light {light[-1]:.2%}",
                flush=True,
            )
    assert np.max(rms, axis=0)[0] <= 0.3
    assert np.max(rms, axis=0)[2] <= 0.5
    assert max(max(values) for values in errors.values()) <= 0.5
    assert np.min(shortcut) > 4.0
    assert max(light) < 0.02


# The command line


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    text = SIMULATED.with_name("bench.toml").read_text(encoding="utf-8")
    for old, new in (("[540, 960]", "[360, 480]"), ("[384, 512]", "[192, 256]"), ("0.2 ", "0.01 ")):
        text = text.replace(old, new)
    path = tmp_path / "rig.toml"
    path.write_text(text.replace("time_scale = 0.2\n", "time_scale = 0.01\n"), encoding="utf-8")
    return path


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(["calibrate", *arguments])
    out, err = capsys.readouterr()
    return status, out, err


def test_camera_tank_and_projector_from_the_command_line(
    rig: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """In this order only, each into a dated file that names those it rests on."""
    folder = tmp_path / "simulated" / "bench-calibration"
    for kind in ("tank", "projector"):
        status, _, err = said(capsys, kind, "--rig", str(rig))
        assert (status, "run tankrig calibrate camera first" in err) == (2, True)
    status, out, err = said(capsys, "camera", "--rig", str(rig), "--views", "7", "--json")
    assert status == 0, err
    assert "air 7 of 7" in err
    assert "covers" in err
    first = json.loads(out)
    assert first["in_use"]
    assert Path(first["path"]).with_suffix(".png").stat().st_size > 10_000
    status, out, err = said(capsys, "tank", "--rig", str(rig), "--views", "1")
    assert (status, "water level" in out) == (0, True), err
    status, out, err = said(capsys, "projector", "--rig", str(rig), "--views", "4", "--json")
    assert status == 0, err
    from tankrig.calibration.file import in_force
    from tankrig.calibration.geometry_in_force import measured

    found = in_force(folder)
    assert found["projector"].rests_on == {"camera": first["sha256"], "tank": found["tank"].hash}
    believed = load_rig_file(rig).bench
    bench, truth = measured(believed, found), random_bench(0, *SMALL)
    scene = bench.scene(gray_code_patterns(SMALL[1])[0], Medium(0.0, 0.001, 0.5))
    assert np.allclose(scene.camera.pose.centre_mm, truth.camera.centre_mm, atol=2.0)
    assert np.allclose(scene.projector.pose.centre_mm, truth.projector.centre_mm, atol=10.0)
    assert scene.tank.size_mm[2] == pytest.approx(truth.level_mm, abs=2.0)
    assert measured(believed, {"camera": found["camera"]}) == believed


def test_bad_calibrations_end_with_a_sentence_and_no_file(
    rig: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    cases = {
        ("--board", "seven"): "is not columns x rows",
        ("--dictionary", "DICT_5X5_50"): "0 good views are too few",
        ("--exposure-ms", "400"): "0 good views are too few",
    }
    for arguments, reason in cases.items():
        status, _, err = said(capsys, "camera", "--rig", str(rig), "--views", "6", *arguments)
        assert (status, reason in err) == (2, True), err
    assert "of the picture is saturated; shorten the exposure" in err
    assert not list((tmp_path / "simulated").rglob("*.toml"))


def test_another_resolution_is_refused(rig: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A lens measured in other pixels would put everything in the wrong place."""
    from tankrig.calibration.file import Calibration, save

    lens = {"fx": 800.0, "fy": 800.0, "cx": 240.0, "cy": 180.0, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0}
    device = f"simulated camera of {tmp_path / 'simulated' / 'bench'}"
    folder = tmp_path / "simulated" / "bench-calibration"
    other = save(Calibration("camera", device, (720, 960), lens), folder)
    status, _, err = said(capsys, "tank", "--rig", str(rig))
    assert (status, "was measured with [720, 960] pixels (rows, columns)" in err) == (2, True), err
    camera = save(Calibration("camera", device, (360, 480), lens), folder, accept=True)
    save(Calibration("tank", device, (360, 480), {}, rests_on={"camera": other.hash}), folder)
    assert camera.hash != other.hash
    status, _, err = said(capsys, "projector", "--rig", str(rig))
    assert (status, "rests on another calibration of the camera than" in err) == (2, True), err


def test_a_person_sees_what_the_camera_sees_until_enter(
    photographer: Photographer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a real camera: the board is judged all the time, and the view is taken when Enter is pressed."""
    import os
    import pty
    import sys

    from tankrig.devices import CameraSettings, Frame
    from ui.cli.boards import Holder

    class Camera:
        """Sees the board twice before Enter is pressed."""

        name, shape, saturation, frames = "camera", SMALL[0], SATURATION, 0

        def configure(self, settings: CameraSettings) -> CameraSettings:
            return settings

        def capture(self, after_ns: int, timeout_s: float) -> Frame:
            del timeout_s
            self.frames += 1
            if self.frames == 2:
                os.write(person, b"\n")
            return Frame(photographer.frames("air", 3)[0], after_ns + 1, 0, 0, self.frames)

    person, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        camera = Camera()
        (view,) = Holder(camera, Pictures(camera), BOARD).good_views("air", 1, lambda view: view)
    os.close(person)
    assert len(view.ids) >= 12
    assert camera.frames >= 3
    assert "Hold the board before the camera" in capsys.readouterr().err
