"""What lenses do is measured on the bench: blur over the picture, halo, veil, black level; and scenes have it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulated.bench_optics import vignetting
from drivers.simulated.bench_trap import TrapInView
from drivers.simulated.bench_truth import TrueBench, TrueStray, random_bench
from tankrig.bench import Bench
from tankrig.calibration.edge_blur import BlurOverPicture
from tankrig.calibration.file import Calibration, load, save
from tankrig.calibration.geometry_in_force import measured, projector_pixel_mm, white_on_wall
from tankrig.calibration.gray_code import decode, gray_code_patterns
from tankrig.calibration.projector_halo import CameraStray, find_halo, half_patterns, seen_of_halves
from tankrig.calibration.stray_light import StrayFound, find_stray
from tankrig.errors import CalibrationError
from tankrig.geometry.shading import shading_terms
from tankrig.scene.outline import edge_reach_mm

from .calibrated_bench import SMALL, Photographer

COARSE = (180, 240)
FULL_WELL, READ_NOISE, FRAMES = 20_000.0, 3.0, 8


def flat_of(bench: TrueBench) -> np.ndarray:
    rows, columns = bench.camera.shape
    return vignetting(bench.camera, *np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float)))


def photographed(bench: TrueBench, card: int | None, random: np.random.Generator, lamp: float = 1.0) -> np.ndarray:
    """Counts as radiometry corrects them: linear, the flat taken off, the mean of some frames."""
    electrons = lamp * TrapInView(bench, card).radiance() * FULL_WELL / bench.room
    noise = np.sqrt((np.maximum(electrons, 0.0) + READ_NOISE**2) / FRAMES)
    return (electrons + noise * random.normal(size=electrons.shape)) / flat_of(bench)


def stray_of(bench: TrueBench, seed: int = 0) -> StrayFound:
    random = np.random.default_rng(seed)
    cards = [photographed(bench, number, random) for number in range(4)]
    return find_stray(cards, [photographed(bench, None, random) for _ in range(2)])


def px_per_mm(bench: TrueBench) -> float:
    """Of the camera's picture at the water's level."""
    return float(bench.camera.matrix[0, 0] / (bench.camera.centre_mm[2] - bench.level_mm))


@given(seed=st.integers(0, 30), share=st.floats(0.004, 0.05), sigma_mm=st.floats(12.0, 45.0), veil=st.floats(0.0, 0.05))
@settings(max_examples=6, deadline=None)
def test_halo_and_veil_are_found_within_their_errors(seed: int, share: float, sigma_mm: float, veil: float) -> None:
    """A halo of 2 % that is not known moves σs by ten standard deviations and looks like noise."""
    bench = random_bench(seed, COARSE, SMALL[1])
    bench = replace(bench, stray=TrueStray(camera_halo=share, camera_halo_mm=sigma_mm, veil=veil))
    found = stray_of(bench, seed)
    assert not found.doubts
    truth = share, sigma_mm * px_per_mm(bench), veil
    for value, true, sd in zip((found.share, found.sigma_px, found.veil), truth, found.sd, strict=True):
        assert abs(value - true) < 5.0 * sd
    assert found.sd[0] < 0.05 * share + 2e-4
    assert found.sd[2] < 0.05 * veil + 1e-3


def test_a_lens_without_halo_has_none() -> None:
    found = stray_of(random_bench(4, COARSE, SMALL[1]))
    assert found.share < 3.0 * found.sd[0] + 1e-4
    assert found.veil < 3.0 * found.sd[2] + 1e-4


def test_a_lamp_that_changes_is_told() -> None:
    bench = replace(random_bench(2, COARSE, SMALL[1]), stray=TrueStray(camera_halo=0.02, veil=0.01))
    random = np.random.default_rng(1)
    cards = [photographed(bench, number, random) for number in range(4)]
    traps = [photographed(bench, None, random, lamp) for lamp in (1.0, 1.4)]
    assert "keep the lamp steady" in " ".join(find_stray(cards, traps).doubts)


@pytest.mark.parametrize("what", ["no card", "few", "cut"])
def test_pictures_that_show_no_card_on_a_trap_are_refused(what: str) -> None:
    bench = random_bench(2, COARSE, SMALL[1])
    random = np.random.default_rng(1)
    trap = photographed(bench, None, random)
    cards = [photographed(bench, number, random) for number in range(4)]
    if what == "no card":
        cards[1] = photographed(bench, None, random)
    elif what == "few":
        cards = cards[:2]
    else:
        cards[2] = np.roll(cards[2], COARSE[1] // 2, axis=1)
    with pytest.raises(CalibrationError, match="card"):
        find_stray(cards, [trap])


@pytest.mark.parametrize("corner", [1.0, 1.7])
def test_a_cameras_blur_is_found_from_the_middle_to_the_corners(corner: float) -> None:
    """Off by a tenth, it would be several per cent of the light at the sides of beams."""
    bench = random_bench(4, *SMALL)
    bench = replace(bench, stray=TrueStray(camera_blur_corner=corner))
    photographer = Photographer(bench, 4, bits=14)
    views = [photographer.view("air", number) for number in range(9)]
    found = BlurOverPicture.of([view.edges for view in views], SMALL[0])
    assert found is not None
    assert abs(found.middle_px - bench.camera.blur_px) < 4.0 * found.sd_px[0]
    assert abs(found.corner_px - corner * bench.camera.blur_px) < 4.0 * found.sd_px[1]
    assert found.varies == (corner != 1.0)


@pytest.mark.parametrize("seed", [1, 5])
def test_the_projectors_halo_is_told_from_the_cameras(seed: int) -> None:
    """Both put light beside what is lit; taken together they would count twice, or neither."""
    stray = TrueStray(camera_halo=0.02, camera_halo_mm=25.0, veil=0.01, projector_halo=0.015, projector_halo_mm=20.0)
    bench = replace(random_bench(seed, *SMALL), stray=stray, leak=0.001)
    photographer, (rows, columns) = Photographer(bench, seed, bits=14), SMALL[1]
    camera = CameraStray(stray.camera_halo, stray.camera_halo_mm * px_per_mm(bench), stray.veil)
    code, halves = gray_code_patterns(SMALL[1]), half_patterns(SMALL[1])
    samples = []
    for number in range(4):
        frames = photographer.frames("flooded slant", number, (*code, *halves))
        decoded = decode(frames[: len(code)], SMALL[1], photographer.sensor.saturation)
        white, left, right = (
            ((frames[k].astype(float) - frames[1]) / flat_of(bench)).astype(np.float32) for k in (0, -2, -1)
        )
        samples.append(seen_of_halves((white, left, right), decoded, camera, columns // 2 - 0.5))
    y, x = np.mgrid[0:rows:8, 0:columns:8].astype(float)
    terms = shading_terms(np.stack([x.ravel(), y.ravel()], axis=-1), SMALL[1])
    fall_off = np.linalg.lstsq(terms, np.log(vignetting(bench.projector, x, y)).ravel(), rcond=None)[0]
    found = find_halo(samples, SMALL[1], fall_off.tolist())
    assert found is not None
    sigma_px = stray.projector_halo_mm * bench.projector.matrix[0, 0] / -bench.projector.centre_mm[0]
    assert abs(found.share - stray.projector_halo) < 4.0 * found.sd[0]
    assert abs(found.sigma_px - sigma_px) < 4.0 * found.sd[1]
    assert found.sd[0] < 0.1 * stray.projector_halo


STORED = Path(__file__).parent / "data" / "stored" / "1" / "calibration"


def stored() -> dict[str, Calibration]:
    """Files of the first version, which knew neither halo nor where blur is wider."""
    return {one.kind: one for one in (load(path) for path in sorted(STORED.glob("*.toml")))}


def bench_of(found: dict[str, Calibration]) -> Bench:
    from drivers.rig import SIMULATED, load_rig_file

    return measured(load_rig_file(SIMULATED.with_name("bench.toml")).bench, found)


def test_files_of_before_make_scenes_as_they_are() -> None:
    bench = bench_of(stored())
    assert bench.camera.halo.share == 0.0
    assert bench.camera.veil == 0.0
    assert bench.camera.blur.corner_mm is None


def test_what_was_measured_is_in_the_bench(tmp_path: Path) -> None:
    found = stored()
    camera, projector = found["camera"], found["projector"]
    camera_px, projector_px = 0.6, 0.7
    found["camera"] = replace(
        camera,
        result={**camera.result, "blur_px": camera_px, "blur_middle_px": 0.5, "blur_corner_px": 0.8},
        sd={**camera.sd, "blur_px": 0.02},
    )
    found["projector"] = replace(
        projector,
        result={**projector.result, "blur_px": projector_px, "halo_share": 0.012, "halo_sigma_px": 50.0},
        sd={**projector.sd, "blur_px": 0.04},
    )
    told = StrayFound(0.02, 90.0, 0.01, (1e-4, 1.0, 1e-4), camera.shape, 0.0, 1e-4, 0.0, np.zeros((1, 3)))
    found["stray"] = save(told.calibration(camera.device, {}), tmp_path)
    assert load(found["stray"].path).result == {"halo_share": 0.02, "halo_sigma_px": 90.0, "veil": 0.01}
    bench = bench_of(found)
    pixel_mm = bench.camera.pixel_mm
    assert bench.camera.blur.sigma_mm == pytest.approx(0.5 * pixel_mm)
    assert bench.camera.blur.corner_mm == pytest.approx(0.8 * pixel_mm)
    assert (bench.camera.halo.share, bench.camera.veil) == (0.02, 0.01)
    assert bench.camera.halo.sigma_mm == pytest.approx(90.0 * pixel_mm)
    side_mm = projector_pixel_mm(bench.projector, bench.tank)
    assert bench.projector.blur.sigma_mm == pytest.approx(projector_px * side_mm)
    assert bench.projector.halo.share == 0.012
    assert bench.projector.halo.sigma_mm == pytest.approx(50.0 * side_mm)
    leak = found["radiometry"].result["projector"]["leak"]
    assert bench.projector.black_level == pytest.approx(max(leak, 0.0) * white_on_wall(bench.projector, bench.tank))


@given(blur_px=st.floats(0.3, 2.0), share=st.floats(0.01, 0.1))
@settings(max_examples=4, deadline=None)
def test_fits_leave_out_no_more_than_what_is_not_known_of_the_blur(blur_px: float, share: float) -> None:
    """All that is blurred was left out, as if nothing were known of it."""
    found = stored()
    camera = found["camera"]
    sd = {**camera.sd, "blur_px": share * blur_px}
    found["camera"] = replace(camera, result={**camera.result, "blur_px": blur_px}, sd=sd)
    bench = bench_of(found)
    sharp = replace(bench, projector=replace(bench.projector, blur_mm=0.0))
    from tankrig.pattern.kinds import Rays, draw
    from tankrig.scene import Medium

    scene = sharp.scene(draw(Rays((0.0,), (40.0, 60.0), 20.0), sharp.wall), Medium(0.001, 0.01, 0.5))
    assert edge_reach_mm(scene) == pytest.approx(2.5 * blur_px * np.sqrt(2.0 * share) * bench.camera.pixel_mm)
