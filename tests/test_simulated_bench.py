"""The simulated bench shows ink as it shows boards: through its own lens, glass and water, and nothing else."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.registry import open_device
from drivers.rig import SIMULATED, load_rig_file
from drivers.simulated import bench_ink, bench_multiple, bench_single
from drivers.simulated.bench_multiple import Smoother
from drivers.simulated.bench_optics import BACK_MM, DEPTHS_MM, defocus_px, thrown_in_depth
from drivers.simulated.bench_single import mirrored_once, scattered_once, shown_by_floor
from drivers.simulated.bench_tank import InkInView
from drivers.simulated.bench_truth import TrueBench, TrueStray, random_bench
from drivers.simulated.camera import SimulatedCamera
from drivers.simulated.light import frame_buffer
from drivers.simulated.picture_store import PictureStore
from drivers.simulated.settings import Sensor
from tankrig.devices import CameraSettings
from tankrig.errors import SceneError
from tankrig.light.tank import tank_image
from tankrig.montecarlo import Tally, first_order, simulate
from tankrig.pattern import Pattern
from tankrig.scene import Medium
from ui.cli import main

CAMERA, PROJECTOR = (135, 240), (96, 128)
INK = Medium(0.0002, 0.008, 0.6)


def pattern(*lit: tuple[slice, slice], level: int = 255) -> Pattern:
    pixels = np.zeros(PROJECTOR, np.uint8)
    for rows, columns in lit:
        pixels[rows, columns] = level
    return Pattern("spots", pixels)


LEFT, RIGHT = (slice(40, 44), slice(40, 44)), (slice(55, 70), slice(80, 84))


@pytest.fixture(scope="module")
def bench() -> TrueBench:
    return random_bench(5, CAMERA, PROJECTOR)


@pytest.fixture(scope="module")
def small() -> TrueBench:
    """The same in coarser pixels, for what holds of any picture."""
    return random_bench(5, (68, 120), PROJECTOR)


@pytest.fixture(scope="module")
def view(small: TrueBench, tmp_path_factory: pytest.TempPathFactory) -> InkInView:
    """Whose pictures are computed once for all tests."""
    return InkInView(small, 0.02, 0, PictureStore(tmp_path_factory.mktemp("pictures")), "bench 5")


@pytest.fixture
def few_photons(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what holds of noisy pictures as well."""
    monkeypatch.setattr(bench_multiple, "PILOT_PHOTONS", 1_000)


def blocks(image: np.ndarray, side: int = 3) -> np.ndarray:
    rows, columns = (n // side for n in image.shape)
    return np.asarray(image.reshape(rows, side, columns, side).mean(axis=(1, 3)))


def test_order_1_is_the_monte_carlos(bench: TrueBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Followed back from the camera and forth from the projector, with no formula in common; light is neither lost
    nor made, and finer cells on the wall bring the second nearer to the first."""
    light = pattern(LEFT, RIGHT)
    back = blocks(scattered_once(bench, thrown_in_depth(bench, light), INK))
    off = []
    for cell_mm in (2.0, 1.0, 0.5):
        monkeypatch.setattr(bench_ink, "CELL_MM", cell_mm)
        forth = first_order(bench_ink.true_scene(bench, light, INK, 3))
        assert back.sum() == pytest.approx(forth.sum(), rel=0.004)
        off.append(float(np.linalg.norm(back - forth) / np.linalg.norm(forth)))
    assert off[2] < 0.03
    assert off[2] < 0.6 * off[1] < 0.36 * off[0]


def test_light_of_a_halo_is_scattered_too(bench: TrueBench) -> None:
    """Spread over the whole wall, none of its cells has much of it; the Monte Carlo is lit by as much of it as is seen
    where lines of sight are followed back. It was lit by beams alone, and light scattered more than once was a
    hundredth too faint."""
    light, halo = pattern(LEFT, RIGHT), replace(bench, stray=TrueStray(projector_halo=0.02, projector_halo_mm=23.0))
    back, back_without = (blocks(scattered_once(one, thrown_in_depth(one, light), INK), 15) for one in (halo, bench))
    forth, forth_without = (first_order(bench_ink.true_scene(one, light, INK, 15)) for one in (halo, bench))
    beside = back_without < 0.01 * back_without.max()
    assert back.sum() == pytest.approx(forth.sum(), rel=0.004)
    assert (back - back_without)[beside].sum() == pytest.approx((forth - forth_without)[beside].sum(), rel=0.02)


def test_even_light_is_followed_at_few_points_as_at_many(monkeypatch: pytest.MonkeyPatch) -> None:
    """A white picture's, and that of a halo over the whole wall, is even but for its ends; a bench's pictures took
    three times as long."""
    halo = replace(random_bench(5, CAMERA, PROJECTOR), stray=TrueStray(projector_halo=0.02, projector_halo_mm=23.0))
    white = pattern((slice(None), slice(None)))
    few = [scattered_once(halo, thrown_in_depth(halo, light), INK) for light in (white, pattern(LEFT, RIGHT))]
    monkeypatch.setattr(bench_single, "LITTLE", -1.0)
    monkeypatch.setattr(bench_single, "FAINT", -1.0)
    many = [scattered_once(halo, thrown_in_depth(halo, light), INK) for light in (white, pattern(LEFT, RIGHT))]
    for one, other in zip(few, many, strict=True):
        assert 0.0 < np.linalg.norm(one - other) < 1e-4 * np.linalg.norm(other)


def test_even_light_is_put_together_for_the_monte_carlo(bench: TrueBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A white picture had 18,000 beams, and took minutes."""
    white = pattern((slice(None), slice(None)))
    few = bench_ink.true_scene(bench, white, INK, 15)
    monkeypatch.setattr(bench_ink, "EVENLY", -1.0)
    many = bench_ink.true_scene(bench, white, INK, 15)
    assert len(few.projector.beams) < 0.2 * len(many.projector.beams)
    powers = [sum(beam.power for beam in one.projector.beams) for one in (few, many)]
    assert powers[0] == pytest.approx(powers[1], rel=1e-9)
    images = [first_order(one) for one in (few, many)]
    assert np.linalg.norm(images[0] - images[1]) < 0.003 * np.linalg.norm(images[1])


@pytest.mark.parametrize("wall", ["entry", pytest.param("far", marks=pytest.mark.long), "left", "right"])
def test_what_glass_walls_mirror_of_order_1_is_the_monte_carlos(wall: str) -> None:
    """Beams and their mirror images have the same edges; the Monte Carlo's went through what smooths its noise, which
    spread them over millimetres. It sends photons from wall to wall, the twin follows lines of sight back to one; the
    far one shows mirror images in a few rows of pixels, which have to be small."""
    glass = replace(random_bench(5, (270, 480), PROJECTOR), stray=TrueStray(glass=(wall,)))
    light = pattern(LEFT, (slice(30, 60), slice(14, 18)), (slice(30, 60), slice(110, 114)))
    thrown, come_back = (thrown_in_depth(glass, light, depths_mm=mm) for mm in (DEPTHS_MM, BACK_MM))
    mirrored = blocks(mirrored_once(glass, thrown, come_back, INK), 6)
    scene = bench_ink.true_scene(glass, light, INK, 6)
    tally = simulate(scene, 4_000_000, seed=3, max_order=1)
    true, noise = tally.image - first_order(scene), float(np.linalg.norm(tally.stderr))
    assert true.sum() > 0.001 * tally.image.sum()
    assert mirrored.sum() == pytest.approx(true.sum(), abs=0.02 * true.sum() + 3.0 * noise)
    assert np.linalg.norm(mirrored - true) < 0.12 * np.linalg.norm(true) + noise


@pytest.mark.parametrize("walls", [(), pytest.param(("entry", "far", "left", "right"), marks=pytest.mark.long)])
def test_what_the_floor_shows_is_the_monte_carlos(walls: tuple[str, ...]) -> None:
    """In clear water the floor is what the camera sees: sharp, and lit once more by way of glass walls. Photons that
    were never scattered bring it forth, lines of sight back."""
    matt = replace(random_bench(5, CAMERA, PROJECTOR), stray=TrueStray(floor=0.04, glass=walls))
    light, clear = pattern((slice(80, 92), slice(8, 120))), Medium(0.001, 0.0, 0.0)
    thrown, come_back = (thrown_in_depth(matt, light, depths_mm=mm) for mm in (DEPTHS_MM, BACK_MM))
    shown = blocks(shown_by_floor(matt, thrown, come_back, clear))
    scene = bench_ink.true_scene(matt, light, clear, 3)
    tally = simulate(scene, 2_000_000, seed=3)
    noise = float(np.linalg.norm(tally.stderr))
    assert shown.sum() == pytest.approx(tally.image.sum(), abs=0.02 * shown.sum() + 3.0 * noise)
    assert np.linalg.norm(shown - tally.image) < 0.1 * np.linalg.norm(shown) + noise
    assert simulate(scene, 20_000, min_order=2).image.sum() < 0.05 * shown.sum()  # which the floor shows once more


@pytest.mark.long
def test_all_orders_are_the_monte_carlos(bench: TrueBench) -> None:
    """Through a lens that neither blurs nor darkens the corners, in pixels of 4 mm."""
    sharp = replace(bench, camera=replace(bench.camera, blur_px=0.01, vignetting=0.0))
    light = pattern(LEFT, RIGHT)
    seen = InkInView(sharp, 0.01, 0, PictureStore(Path("nowhere")), "sharp").computed(light, INK)
    true = simulate(bench_ink.true_scene(sharp, light, INK, 3), 400_000, seed=9, min_order=2)
    more = blocks(seen.image - scattered_once(sharp, thrown_in_depth(sharp, light), INK))
    assert more.sum() == pytest.approx(true.image.sum(), rel=0.01)
    scale = np.linalg.norm(blocks(seen.image))
    assert np.linalg.norm(more - true.image) / scale < 0.02 + np.linalg.norm(true.stderr) / scale


@pytest.mark.long
def test_what_smooths_the_monte_carlos_noise_leaves_light_where_it_is(bench: TrueBench) -> None:
    """A picture that has next to no noise, by the other program, comes out as it went in, in beams and at walls: when
    it did not, benches fitted by the truth itself found up to 2 % too much ink."""
    ink = Medium(0.0007, 0.019, 0.75)
    light = pattern((slice(48, 50), slice(40, 43)), (slice(48, 50), slice(60, 63)), (slice(48, 50), slice(80, 83)))
    once = scattered_once(bench, thrown_in_depth(bench, light), ink)
    scene = bench_ink.true_scene(bench, light, ink)
    orders = tank_image(scene, tolerance=0.005, seed=3).orders
    second, more = np.asarray(orders[2]), sum(np.asarray(one) for order, one in orders.items() if order not in (1, 2))
    smoothed = Smoother(bench, once, 1, scene.camera.pixel_mm)(
        Tally({2: second, 3: more}, np.zeros_like(second), 1, 0.0, 0.0)
    )
    assert np.linalg.norm(blocks(smoothed - second - more)) < 0.003 * np.linalg.norm(blocks(once + second + more))


@pytest.mark.usefixtures("few_photons")
def test_light_of_two_patterns_adds_up_and_levels_follow_gamma(view: InkInView, small: TrueBench) -> None:
    left, right, both = (view.radiance(pattern(*lit), INK).image for lit in ((LEFT,), (RIGHT,), (LEFT, RIGHT)))
    assert np.linalg.norm(left + right - both) < 0.03 * np.linalg.norm(both)
    half = view.radiance(pattern(LEFT, level=128), INK).image
    np.testing.assert_allclose(half, (128 / 255) ** small.gamma * left, rtol=1e-6, atol=0.0)


@pytest.mark.usefixtures("few_photons")
def test_level_0_leaks_part_of_whites_light(tmp_path: Path) -> None:
    """By a projector of few pixels, for all of them are lit."""
    bench = random_bench(5, (34, 60), (24, 32))
    leaking = InkInView(replace(bench, leak=0.01), 0.5, 0, PictureStore(tmp_path), "leaking")
    evenly = (Pattern("even", np.full((24, 32), level, np.uint8)) for level in (255, 0))
    white, dark = (leaking.radiance(one, INK).image for one in evenly)
    assert white.max() > 0.0
    np.testing.assert_allclose(dark, white * 0.01 / 1.01, rtol=1e-6)


def test_clear_water_shows_next_to_nothing(view: InkInView) -> None:
    water, ink = (view.radiance(pattern(LEFT), one).image.max() for one in (Medium(5.65e-5, 1.9e-6, 0.0), INK))
    assert 0.0 < water < 1e-3 * ink


def test_a_plume_lies_about_its_inlet_and_keeps_the_mean(view: InkInView, small: TrueBench) -> None:
    blob = view.blob((60.0, 20.0), 15.0)
    row, column = np.unravel_index(np.argmax(blob), blob.shape)
    from drivers.simulated.bench_optics import camera_rays

    start, way = camera_rays(small, np.array([float(column), float(row)]), filled=True)
    middle = start + (small.level_mm / 2 - start[2]) / way[2] * way
    np.testing.assert_allclose(middle[:2], (60.0, 20.0), atol=1.5)
    assert blob.max() == pytest.approx(240.0 * 160.0 / (2.0 * np.pi * 15.0**2), rel=0.02)


@pytest.mark.usefixtures("few_photons")
def test_a_picture_is_computed_once_for_all_who_ask(
    small: TrueBench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = InkInView(small, 0.5, 0, PictureStore(tmp_path), "bench 5").radiance(pattern(LEFT), INK)
    later = InkInView(small, 0.5, 0, PictureStore(tmp_path), "bench 5")
    monkeypatch.setattr(later, "computed", None)
    np.testing.assert_array_equal(later.radiance(pattern(LEFT), INK).image, first.image)
    other = InkInView(small, 0.5, 1, PictureStore(tmp_path), "bench 5").radiance(pattern(LEFT), INK)
    assert (other.image != first.image).any()


def test_a_store_keeps_no_more_than_it_may_and_survives_damage(tmp_path: Path) -> None:
    store, picture = PictureStore(tmp_path, most_bytes=10_000), np.ones((20, 20))
    for number in range(12):
        store.put(str(number), picture)
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 10_000
    assert store.get("11") is not None
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:100])
    assert store.get("11") is None
    store.put("11", picture)
    np.testing.assert_array_equal(store.get("11"), picture)


@pytest.fixture
def camera(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[SimulatedCamera]:
    request.getfixturevalue("few_photons")
    settings = {
        "folder": str(tmp_path),
        "time_scale": 0.001,
        "boards": {"seed": 5, "camera_shape": [68, 120], "projector_shape": list(PROJECTOR)},
        "truth": {"water": {"sigma_a": 2e-4, "sigma_s": 0.008, "g": 0.6}, "tolerance": 0.5},
    }
    opened = open_device("simulated-camera", settings)
    yield opened  # type: ignore[misc]
    opened.close()


def test_a_board_is_seen_while_it_is_held_and_then_the_tank(camera: SimulatedCamera, tmp_path: Path) -> None:
    camera.configure(CameraSettings(2000.0))
    frame_buffer(tmp_path).show(pattern(LEFT, RIGHT), lit_ns=1)
    tank = camera.capture(0, 60.0).pixels.astype(float)
    camera.configure(CameraSettings(20.0))
    camera.hold("air", 0)
    board = camera.capture(0, 60.0).pixels.astype(float)
    camera.hold("nothing")
    camera.configure(CameraSettings(2000.0))
    again = camera.capture(0, 60.0).pixels.astype(float)
    assert np.corrcoef(tank.ravel(), again.ravel())[0, 1] > 0.9
    assert abs(np.corrcoef(tank.ravel(), board.ravel())[0, 1]) < 0.5


def test_twice_the_exposure_is_twice_the_light(camera: SimulatedCamera, tmp_path: Path) -> None:
    frame_buffer(tmp_path).show(pattern(LEFT, RIGHT), lit_ns=1)
    black = Sensor().black
    light = []
    for exposure_ms in (100.0, 200.0):
        camera.configure(CameraSettings(exposure_ms))
        light.append(np.mean([camera.capture(0, 60.0).pixels for _ in range(4)]) - black)
    assert light[1] == pytest.approx(2.0 * light[0], rel=0.02)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("[camera.truth]\n", '[camera.truth]\nbench = "."\n', "camera.truth.bench|truth.bench"),
        ("[camera.truth]\n", "[camera.truth]\ninlet_mm = [300.0, 0.0]\n", "outside the tank"),
        ("projector_shape = [384, 512]", "projector_shape = [768, 1024]", "the same projector's"),
        ("camera_shape = [540, 960]", "camera_shape = [270, 480]", "are the same camera's"),
        ("camera_shape = [540, 960]", "camera_shape = [540, 960]\nlevel_mm = 130.0", "above the tank"),
        ('driver = "simulated-camera"\nfolder = "./simulated/bench"', 'driver = "simulated-camera"\nfolder = "./b"',
         "two tanks"),
    ],
)  # fmt: skip
def test_a_bench_that_contradicts_itself_is_refused_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, told: str
) -> None:
    text = SIMULATED.with_name("bench.toml").read_text(encoding="utf-8")
    assert old in text
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(SceneError, match=told):
        load_rig_file(rig)
    assert main(["doctor", str(rig)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not (tmp_path / "simulated").exists()


def _ways(angles: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


@pytest.mark.long
def test_light_scattered_more_often_is_that_of_all_points_of_a_wide_lens(bench: TrueBench) -> None:
    """Beside the Monte Carlo's mean over points all over the lens, whose light is moved by the paraxial
    formula rather than along rays: four pinholes at half its radius are as good as the disc, and no light is lost."""
    sharp = replace(bench, camera=replace(bench.camera, blur_px=0.01, vignetting=0.0))
    lens_mm, focus_mm = 60.0, 200.0
    wide = replace(sharp, stray=replace(sharp.stray, projector_lens_mm=lens_mm, projector_focus_mm=focus_mm))
    light = pattern((slice(46, 50), slice(60, 66)))

    def more(one: TrueBench) -> np.ndarray:
        once = scattered_once(one, thrown_in_depth(one, light), INK)
        return blocks(bench_multiple.scattered_more(one, light, INK, once, 0.01, 4)[0], 15)

    scene = bench_ink.true_scene(sharp, light, INK, 3)
    before = -bench.projector.centre_mm[0] - bench.pane_mm + bench.pane_mm / bench.pane_index
    found, rings, turns = [], (np.arange(8) + 0.5) / 8, (np.array([0, 5, 3, 6, 1, 4, 2, 7]) + 0.5) / 8
    drawn = 0.5 * lens_mm * np.sqrt(rings)[:, None] * _ways(0.5 * np.pi * turns)
    sides = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    for number, aside in enumerate((drawn[:, None] * sides).reshape(-1, 2)):
        on_wall = aside * (focus_mm / bench.water_index) / (before + focus_mm / bench.water_index)
        beams = tuple(
            replace(beam, y_mm=(beam.y_mm[0] + on_wall[0], beam.y_mm[1] + on_wall[0]),
                    z_mm=(beam.z_mm[0] + on_wall[1], beam.z_mm[1] + on_wall[1]))
            for beam in scene.projector.beams
        )  # fmt: skip
        x, y, z = scene.projector.position_mm or (0.0, 0.0, 0.0)
        projector = replace(scene.projector, beams=beams, position_mm=(x, y + aside[0], z + aside[1]))
        found.append(
            blocks(simulate(replace(scene, projector=projector), 12_000, seed=4000 + number, min_order=2).image, 5)
        )
    true, soft, plain = np.mean(found, axis=0), more(wide), more(sharp)
    assert soft.sum() == pytest.approx(true.sum(), rel=0.012)
    assert soft.sum() == pytest.approx(plain.sum(), rel=0.01)
    changed = float(np.linalg.norm(true - plain))
    assert changed > 0.015 * np.linalg.norm(plain)
    assert np.linalg.norm(soft - true) < 0.5 * changed
    assert np.sum((soft - plain) * (true - plain)) / changed**2 == pytest.approx(1.0, abs=0.25)


def test_two_truths_of_one_bench_are_refused(tmp_path: Path) -> None:
    text = SIMULATED.with_name("bench.toml").read_text(encoding="utf-8")
    bench = text[text.index("[bench]") :].replace("[bench", "[camera.truth.bench")
    rig = tmp_path / "rig.toml"
    rig.write_text(text + bench, encoding="utf-8")
    with pytest.raises(SceneError, match="two truths of one bench"):
        load_rig_file(rig)


def test_a_wide_lens_is_sharp_at_its_focus_alone(bench: TrueBench) -> None:
    """Followed back from the camera through pictures by depth, and forth from four points of the lens; off the focus
    rays from the rim and the paraxial formula that models use have the same disc."""
    wide = replace(bench, stray=replace(bench.stray, projector_lens_mm=24.0, projector_focus_mm=80.0))
    before = -bench.projector.centre_mm[0] - bench.pane_mm + bench.pane_mm / bench.pane_index
    nearness, at_focus = (1.0 / (before + depth / bench.water_index) for depth in (DEPTHS_MM, 80.0))
    paraxial = bench.projector.matrix[0, 0] * 12.0 * np.abs(nearness - at_focus)
    np.testing.assert_allclose(defocus_px(wide, DEPTHS_MM, filled=True), paraxial, rtol=0.02, atol=0.005)
    light = pattern((slice(50, 53), slice(60, 63)))
    sharp, soft = (blocks(scattered_once(one, thrown_in_depth(one, light), INK)) for one in (bench, wide))
    scene = bench_ink.true_scene(wide, light, INK, 3)
    plain = first_order(scene)
    forth = np.mean([first_order(one) for one in bench_ink.through_lens(wide, scene)], axis=0)
    assert soft.sum() == pytest.approx(sharp.sum(), rel=0.002)
    changed = float(np.linalg.norm(soft - sharp) / np.linalg.norm(sharp))
    assert changed > 0.02
    assert np.linalg.norm((soft - sharp) - (forth - plain)) / np.linalg.norm(sharp) < 0.35 * changed
