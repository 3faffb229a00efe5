"""A projector's lens is wide: how its blur grows off the focus is measured on boards, and scenes have it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.calibration_health import calibration_checks
from drivers.rig import SIMULATED, load_rig_file
from drivers.simulated.bench_truth import TANK_MM, TrueBench, TrueOptics, random_bench
from tankrig.calibration.blur_in_depth import Way, find_blur_in_depth
from tankrig.calibration.edge_blur import PIXEL_VARIANCE, BlurOverPicture
from tankrig.calibration.file import Calibration, save
from tankrig.calibration.geometry_in_force import measured
from tankrig.calibration.places import believed, measured_places
from tankrig.calibration.projector import ProjectorFound, calibrate_projector
from tankrig.calibration.stripe_blur import seen_spreads
from tankrig.figures.geometry_figure import write_geometry_figure
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose, rotation_vector
from tankrig.geometry.refraction import entry_wall, water_surface
from tankrig.light.entering import entering, through_lens
from tankrig.pattern.kinds import Rays, draw
from tankrig.scene import Medium, load_scene
from tankrig.scene.writing import scene_text

from .calibrated_bench import BOARD, SMALL, Photographer
from .calibration_truth import true_blurs
from .test_measured_optics import bench_of, stored

WAY, FOCAL_PX = Way(380.0, 1.33, 240.0), 900.0


def parts_of(
    blur_px: float,
    lens_mm: float,
    focus_mm: float,
    seed: int,
    noise: float = 0.05,
    depths: tuple[float, float] = (5, 235),
) -> list[np.ndarray]:
    """What eight placings of a board would tell, by formula, each a little off in all of its parts together."""
    random = np.random.default_rng(seed)
    found = []
    for middle in np.linspace(*depths, 8):
        x = np.clip(middle + random.uniform(-25.0, 25.0, 12), *depths)
        camera = random.uniform(0.15, 0.3, 12)
        disc = 0.5 * FOCAL_PX * lens_mm * np.abs(WAY.nearness(x) - WAY.nearness(focus_mm))
        seen = seen_spreads(np.sqrt(blur_px**2 + camera), disc) ** 2
        off = np.exp(noise * random.normal(size=12) + 0.3 * noise * random.normal())
        found.append(np.column_stack([x, seen * off, camera]))
    return found


@given(
    seed=st.integers(0, 10**6),
    blur_px=st.floats(0.5, 1.2),
    lens_mm=st.floats(8.0, 24.0),
    focus_mm=st.floats(30.0, 210.0),
)
@settings(max_examples=8, deadline=None)
def test_width_and_focus_are_found_within_their_errors(
    seed: int, blur_px: float, lens_mm: float, focus_mm: float
) -> None:
    found = find_blur_in_depth(parts_of(blur_px, lens_mm, focus_mm, seed), FOCAL_PX, WAY)
    assert found is not None
    assert found.doubts == ()
    if found.lens_mm == 0.0:  # narrow, and hardly told from none
        assert lens_mm < 4.0 * found.sd[1]
        return
    truth = blur_px, lens_mm, focus_mm
    for value, true, sd in zip((found.blur_px, found.lens_mm, found.focus_mm), truth, found.sd, strict=True):
        assert abs(value - true) < 5.0 * sd
    assert found.sd[1] < 0.5 * lens_mm


@given(seed=st.integers(0, 10**6), blur_px=st.floats(0.5, 1.2))
@settings(max_examples=6, deadline=None)
def test_a_pinhole_has_no_width_and_says_what_it_may_be(seed: int, blur_px: float) -> None:
    found = find_blur_in_depth(parts_of(blur_px, 0.0, 120.0, seed), FOCAL_PX, WAY)
    assert found is not None
    assert found.lens_mm < 6.0
    if found.lens_mm == 0.0:
        assert 0.0 < found.sd[1] < 8.0
        assert np.isnan(found.focus_mm)
    assert abs(found.blur_px - blur_px) < 4.0 * found.sd[0]


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"depths": (100.0, 170.0)}, "near the wall and far from it"),
        ({"noise": 0.7}, "scatters by"),
        ({"focus_mm": 330.0}, "sharp behind the tank"),
        ({"focus_mm": -60.0, "lens_mm": 10.0}, "sharp before the wall"),
    ],
)
def test_what_does_not_tell_a_lens_is_doubted(told: dict, said: str) -> None:
    found = find_blur_in_depth(
        parts_of(**{"blur_px": 0.7, "lens_mm": 18.0, "focus_mm": 110.0, "seed": 4, **told}), FOCAL_PX, WAY
    )
    assert found is not None
    assert said in " ".join(found.doubts)


def test_too_few_parts_tell_nothing() -> None:
    parts = parts_of(0.7, 16.0, 100.0, 2)
    assert find_blur_in_depth(parts[:3], FOCAL_PX, WAY) is None
    assert find_blur_in_depth([one[:0] for one in parts], FOCAL_PX, WAY) is None
    assert find_blur_in_depth([np.full((3, 3), np.nan)] * 8, FOCAL_PX, WAY) is None


def test_edges_of_a_disc_are_found_as_drawn_ones_are() -> None:
    """Beside a square wave drawn on a fine grid, and blurred there by OpenCV's own disc and Gaussian."""
    import cv2

    from tankrig.calibration.edge_blur import spreads
    from tankrig.calibration.stripe_blur import NEAR_PX

    per_px, gauss, disc = 20, 0.8, 2.5
    at = (np.arange(-64 * per_px, 64 * per_px) + 0.5) / per_px
    wave = np.where(np.floor(at / 16.0) % 2 == 0, 1.0, 0.0)
    half = round(disc * per_px)
    chord = np.sqrt(np.maximum(disc**2 - (np.arange(-half, half + 1) / per_px) ** 2, 0.0))
    blurred = cv2.filter2D(wave[None], -1, (chord / chord.sum())[None])
    blurred = cv2.GaussianBlur(blurred, (0, 0), gauss * per_px)[0]
    near = np.abs(at) < NEAR_PX
    drawn = spreads(at[near][None], blurred[near][None], np.ones((1, near.sum())), 1.0)[0]
    assert seen_spreads(np.array([gauss]), np.array([disc]))[0] == pytest.approx(drawn, rel=0.01)
    assert drawn > 1.02 * np.hypot(gauss, disc / 2.0)


def test_stripes_on_a_board_are_blurred_as_its_edges_are() -> None:
    """The twin's stripes were blurred by .05 camera pixels² less than what is printed: the print was sampled, and the
    light was not."""
    bench = random_bench(2, SMALL[0], (384, 512))
    photographer = Photographer(bench, 2, bits=14)
    parts = [part for number in (1, 4) for part in photographer.lit("flooded slant", number).stripes]
    slope2 = np.array([one.camera_px2 for one in parts])
    design = np.column_stack([np.ones(len(parts)), slope2])
    seen = np.array([one.variance_px2 for one in parts])
    of_projector, of_camera = np.linalg.lstsq(design, seen, rcond=None)[0]
    true = true_blurs(bench)
    assert np.ptp(slope2) > 0.8
    assert of_camera == pytest.approx(true["camera"] ** 2 + PIXEL_VARIANCE, abs=0.015)
    assert of_projector == pytest.approx(true["projector"] ** 2, abs=0.03)


def of_truth(bench: TrueBench, views: int, seen_blur: BlurOverPicture | None) -> ProjectorFound:
    """The projector's procedure alone, with camera and water as they truly are."""
    photographer = Photographer(bench, 1, bits=14)
    lens, camera = (
        lens_of(bench.camera),
        Pose(rotation_vector(bench.camera.rotation), tuple(bench.camera.translation_mm)),
    )
    wall = entry_wall(bench.water_index, bench.pane_mm, bench.pane_index)
    boards = [photographer.lit("flooded slant", number) for number in range(views)]
    surface = water_surface(bench.level_mm, bench.water_index)
    return calibrate_projector(
        boards, BOARD, lens, camera, surface, wall, bench.projector.shape, TANK_MM, seen_blur=seen_blur
    )


def lens_of(optics: TrueOptics) -> Lens:
    (fx, _, cx), (_, fy, cy), _ = optics.matrix.tolist()
    return Lens(fx, fy, cx, cy, *optics.distortion.tolist())


@pytest.fixture(scope="module")
def wide() -> tuple[TrueBench, ProjectorFound]:
    """A bench whose projector has a lens of 18 mm, and what was found of it."""
    bench = random_bench(6, *SMALL)
    bench = replace(bench, stray=replace(bench.stray, projector_lens_mm=18.0, projector_focus_mm=80.0))
    blur_px = true_blurs(bench)["camera"]
    return bench, of_truth(bench, 6, BlurOverPicture(blur_px, blur_px, (0.01, 0.01)))


def test_a_wide_lens_is_measured_on_boards(wide: tuple[TrueBench, ProjectorFound], tmp_path: Path) -> None:
    """It was one blur for all depths, of which the pictures at either end had half, and those at the focus twice."""
    bench, found = wide
    told = found.blur_in_depth
    assert told is not None
    assert found.doubts == ()
    truth = true_blurs(bench)["projector"], bench.stray.projector_lens_mm, bench.stray.projector_focus_mm
    for value, true, sd in zip((told.blur_px, told.lens_mm, told.focus_mm), truth, told.sd, strict=True):
        assert abs(value - true) < 4.0 * sd
    assert told.sd[1] < 2.0
    assert told.sd[2] < 10.0
    kept = save(found.calibration("projector", {}), tmp_path)
    assert kept.result["lens_mm"] == told.lens_mm
    assert kept.sd["focus_mm"] == told.sd[2]
    write_geometry_figure(tmp_path / "seen.png", "lens", found, 0.8, told)
    assert (tmp_path / "seen.png").stat().st_size > 20_000


LENS = {"blur_focus_px": 0.7, "lens_mm": 16.0, "focus_mm": 90.0, "in_tank_index": 1.33}
LENS_SD = {"blur_focus_px": 0.03, "lens_mm": 0.5, "focus_mm": 3.0}


def with_lens(**result: float) -> dict[str, Calibration]:
    found = stored()
    projector = found["projector"]
    told = {**projector.result, "blur_px": 1.1, **LENS, **result}
    found["projector"] = replace(projector, result=told, sd={**projector.sd, "blur_px": 0.05, **LENS_SD})
    return found


def test_scenes_of_a_calibrated_bench_have_its_lens(tmp_path: Path) -> None:
    bench = bench_of(with_lens())
    assert bench.projector is not None
    assert bench.projector.wide_lens.diameter_mm == 16.0
    index = bench.tank.refractive_index
    assert bench.projector.wide_lens.focus_mm == pytest.approx(90.0 * index / 1.33)
    emptied = bench_of(with_lens(in_tank_index=1.0)).projector
    assert emptied is not None
    assert emptied.wide_lens.focus_mm == pytest.approx(90.0 * index)
    pinhole = bench_of(with_lens(lens_mm=0.0)).projector
    assert pinhole is not None
    assert pinhole.wide_lens.diameter_mm == 0.0
    assert pinhole.blur.sigma_mm == pytest.approx(1.1 / 0.7 * bench.projector.blur.sigma_mm)
    medium = Medium(0.001, 0.01, 0.5)
    scene = bench.scene(draw(Rays((0.0,), (40.0, 60.0), 8.0), bench.wall), medium)
    assert scene.projector.wide_lens == bench.projector.wide_lens
    (tmp_path / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
    again = load_scene(tmp_path / "scene.toml")
    assert again.projector.wide_lens == scene.projector.wide_lens
    assert len(through_lens(entering(scene, fine=True), fine=True)) > 2


def test_what_is_known_of_it_is_told(tmp_path: Path) -> None:
    rig = load_rig_file(SIMULATED.with_name("bench.toml"))
    bench = measured(rig.bench, with_lens())
    what = {one.what: one.text for one in measured_places(with_lens())}
    assert what["projector's lens is as wide as"] == "16.00 ± 0.50 mm"
    assert what["projector is sharpest at x ="] == "90.0 ± 3.0 mm"
    assert not any("grows with depth" in one for one in believed(bench, with_lens()))
    assert any("grows with depth is not known" in one for one in believed(bench, stored()))
    for found, said in ((with_lens(), "16.0 ± 0.5 mm wide"), (stored(), "calibration is older")):
        folder = tmp_path / said[:4].strip()
        folder.mkdir()
        save(found["projector"], folder)
        checks = calibration_checks(replace(rig, calibration_folder=str(folder)), {})
        assert said in next(one.finding for one in checks if one.what == "projector's blur over depth is measured")


def test_fits_leave_out_what_is_not_known_of_a_wide_lens() -> None:
    """At an end of the tank, where the disc is widest, and the more the less is known of it."""
    bench = bench_of(with_lens())
    assert bench.projector is not None
    found = with_lens()
    projector = found["projector"]
    found["projector"] = replace(projector, sd={**projector.sd, "lens_mm": 2.0, "focus_mm": 12.0})
    worse = bench_of(found).projector
    assert worse is not None
    assert bench.projector.blur_mm is not None
    assert worse.blur_mm == pytest.approx(2.0 * bench.projector.blur_mm, rel=0.25)
