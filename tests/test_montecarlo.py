"""The Monte Carlo: right in every geometry, honest about its noise, the same on every machine."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tankrig.geometry.optics import fresnel_reflectance, mirror, refract
from tankrig.montecarlo import Tally, first_order, simulate, simulate_to
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank, load_scene
from tankrig.scene.phase_functions import phase_function

REFERENCE = Path(__file__).parent / "data" / "reference"
CASES = sorted(path.stem for path in REFERENCE.glob("*.npz"))
ARRAYS: dict[int | str, str] = {2: "order2", 3: "order3", "4-20": "order4_20", ">20": "order_gt20"}
BLOCK = 4


def case(name: str) -> tuple[Scene, dict[str, NDArray[np.float64]]]:
    with np.load(REFERENCE / f"{name}.npz") as arrays:
        return load_scene(REFERENCE / f"{name}.toml"), {
            key: arrays[key].astype(float) for key in ("order1", "total", "stderr", *ARRAYS.values())
        }


def in_blocks(image: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, columns = image.shape
    return image.reshape(rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).mean(axis=(1, 3))


def seen_in_blocks(scene: Scene) -> Scene:
    """The same camera with pixels of BLOCK × BLOCK: little noise from few photons, and nearly normal."""
    rows, columns = scene.camera.shape
    camera = replace(scene.camera, shape=(rows // BLOCK, columns // BLOCK), pixel_mm=BLOCK * scene.camera.pixel_mm)
    return replace(scene, camera=camera)


def rms_z(tally: Tally, image: NDArray[np.float64], stderr: NDArray[np.float64] | float) -> float:
    combined = np.sqrt(tally.stderr**2 + np.square(stderr))
    return float(np.sqrt(np.mean(((tally.image - image)[combined > 0] / combined[combined > 0]) ** 2)))


@pytest.fixture
def slanted() -> Scene:
    """A pinhole projector below the beam's height whose light rises to a water surface that reflects it."""
    return Scene(
        tank=Tank(size_mm=(120.0, 80.0, 60.0), surface="fresnel"),
        medium=Medium(sigma_a=0.001, sigma_s=0.019, g=0.4),
        projector=Projector("pinhole", (Beam((-12.0, 3.0), (40.0, 52.0), 1.3),), position_mm=(-70.0, 4.0, 10.0)),
        camera=Camera("orthographic", shape=(20, 30), pixel_mm=4.0),
    )


PINHOLE_ABOVE = Camera("pinhole", shape=(20, 30), pixel_mm=4.0, position_mm=(90.0, -25.0, 200.0))


# --- against the reference -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
def test_order_one_is_the_reference_within_half_a_thousandth(name: str) -> None:
    scene, reference = case(name)
    error = np.linalg.norm(first_order(scene) - reference["order1"]) / np.linalg.norm(reference["order1"])
    assert error < 5e-4


@pytest.mark.parametrize("name", CASES)
def test_reference_is_met_within_noise(name: str) -> None:
    scene, reference = case(name)
    tally = simulate_to(seen_in_blocks(scene), tolerance=0.02, seed=1)
    assert rms_z(tally, in_blocks(reference["total"]), in_blocks(reference["stderr"]) / BLOCK) < 1.3
    for order, array in ARRAYS.items():  # loose on the few photons of rare orders; `long` is strict
        share = reference[array].sum() / reference["total"].sum()
        ratio = tally.orders[order].mean() / max(reference[array].mean(), 1e-300)
        assert share < 0.01 or abs(ratio - 1.0) < 0.02 + 0.002 / share, order


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_reference_is_met_pixel_by_pixel(name: str) -> None:
    scene, reference = case(name)
    started = time.process_time()
    tally = simulate(scene, photons=2_000_000, seed=2)
    seconds = time.process_time() - started
    combined = np.sqrt(tally.stderr**2 + reference["stderr"] ** 2)
    z = (tally.image - reference["total"]) / combined
    print(
        f"{name}: RMS z {np.sqrt(np.mean(z**2)):.3f}, mean z {z.mean():+.3f}, noise {100 * tally.noise:.2f} %, ", end=""
    )
    print(f"{tally.photons / seconds:.3g} photons per core second, noise² · s = {tally.noise**2 * seconds:.2e}")
    assert np.sqrt(np.mean(z**2)) <= 1.1
    assert abs(z.mean()) < 0.15
    for order, array in ARRAYS.items():
        share = reference[array].sum() / reference["total"].sum()
        ratio = tally.orders[order].mean() / max(reference[array].mean(), 1e-300)
        print(f"    order {order}: sum over the reference's {ratio:.4f}, share {share:.4f}")
        assert share < 1e-3 or abs(ratio - 1.0) < 0.004 + 3e-4 / share


# --- what the reference lacks ----------------------------------------------------------------------------------------


def lit(scene: Scene, points: NDArray[np.float64], toward_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Order-1 emission at (…, 3) points, of the direct beam and of its mirror image in the water surface."""
    total = np.zeros(points.shape[:-1])
    apex = np.array(scene.projector.position_mm)
    height = scene.tank.size_mm[2]
    for reflected in (False, True):
        place = points * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * height] if reflected else points
        ray = place - apex
        forward = ray[..., 0] / np.linalg.norm(ray, axis=-1)
        wall = apex + ray * (-apex[0] / ray[..., 0])[..., None]
        direction = ray / np.linalg.norm(ray, axis=-1)[..., None]
        irradiance = np.zeros(total.shape)
        for beam in scene.projector.beams:
            within = (wall[..., 1:] >= [beam.y_mm[0], beam.z_mm[0]]) & (wall[..., 1:] <= [beam.y_mm[1], beam.z_mm[1]])
            irradiance += beam.irradiance * within.all(axis=-1)
        spread = (-apex[0] / (place[..., 0] - apex[0])) ** 2 / forward
        path = np.linalg.norm(place - wall, axis=-1)
        if reflected:
            irradiance *= fresnel_reflectance(np.abs(direction[..., 2]), scene.tank.surface_index)
            direction = mirror(direction, [0.0, 0.0, 1.0])
        cosine = np.sum(direction * toward_camera, axis=-1)
        total += irradiance * spread * np.exp(-scene.medium.sigma_t * path) * phase_function(cosine, scene.medium.g)
    inside = (np.abs(points[..., 1]) <= scene.tank.size_mm[1] / 2) & (points[..., 0] <= scene.tank.size_mm[0])
    return scene.medium.sigma_s * total * (inside & (points[..., 0] >= 0.0))


def order_one_along_sight_lines(scene: Scene, fineness: int, steps: int) -> NDArray[np.float64]:
    """Order 1 the other way round: from the camera through points of each pixel, bent by Snell's law, step by step."""
    rows, columns = scene.camera.shape
    pixel, n = scene.camera.pixel_mm, scene.tank.surface_index
    x = (np.arange(columns * fineness) + 0.5) * pixel / fineness
    y = (np.arange(rows * fineness) + 0.5) * pixel / fineness - scene.tank.size_mm[1] / 2
    surface = np.stack(np.broadcast_arrays(x, y[:, None], scene.tank.size_mm[2]), axis=-1)
    down = np.broadcast_to([0.0, 0.0, -1.0], surface.shape)
    if scene.camera.kind == "pinhole":
        down = surface - np.array(scene.camera.position_mm)
        down = down / np.linalg.norm(down, axis=-1)[..., None]
    transmitted = (1.0 - fresnel_reflectance(-down[..., 2], 1.0 / n)) / n**2 if n > 1.0 else np.ones(down.shape[:-1])
    ray = refract(down, [0.0, 0.0, 1.0], 1.0 / n)
    step = scene.tank.size_mm[2] / steps
    image = np.zeros(transmitted.shape)
    for depth in (np.arange(steps) + 0.5) * step:
        path = depth / -ray[..., 2]
        emitted = lit(scene, surface + ray * path[..., None], -ray)
        image += emitted * np.exp(-scene.medium.sigma_t * path) * step / -ray[..., 2]
    blocks = (transmitted * image).reshape(rows, fineness, columns, fineness)
    return blocks.mean(axis=(1, 3))


@pytest.mark.parametrize("surface", ["matched", "fresnel"])
@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
def test_order_one_of_light_that_rises_to_the_surface(slanted: Scene, camera: str, surface: str) -> None:
    """A beam reflected from below lights the tank again; a perspective camera sees it along a bent line of sight."""
    tank = replace(slanted.tank, surface=surface)
    scene = replace(slanted, tank=tank, camera=PINHOLE_ABOVE if camera == "pinhole" else slanted.camera)
    expected = order_one_along_sight_lines(scene, fineness=5, steps=120)
    found = first_order(scene)
    assert np.linalg.norm(found - expected) / np.linalg.norm(expected) < 0.04  # its own error: 0.011 when twice as fine
    assert found.sum() / expected.sum() == pytest.approx(1.0, abs=0.003)


def analog_sums(scene: Scene, photons: int, orders: int, seed: int) -> NDArray[np.float64]:
    """Sum of the image by order, by a simulator of its own: single collisions, numpy, no forced flight, no lobe.

    A perspective camera over water is found by bisection on Snell's law, and its Jacobian by differences.
    """
    draw = np.random.default_rng(seed)
    (length, width, height), n, medium = scene.tank.size_mm, scene.tank.surface_index, scene.medium
    beam, apex = scene.projector.beams[0], np.array(scene.projector.position_mm)
    place = np.stack([np.zeros(photons), draw.uniform(*beam.y_mm, photons), draw.uniform(*beam.z_mm, photons)], axis=-1)
    ray = place - apex
    ray /= np.linalg.norm(ray, axis=-1)[:, None]
    sums = []
    for _ in range(orders):
        place = place + ray * draw.exponential(1.0 / medium.sigma_t, len(ray))[:, None]
        crossing = place - ray * ((place[:, 2] - height) / ray[:, 2])[:, None]
        above = place[:, 2] > height
        at_surface = (np.abs(crossing[:, 1]) <= width / 2) & (crossing[:, 0] >= 0.0) & (crossing[:, 0] <= length)
        back = draw.random(len(ray)) < (fresnel_reflectance(np.abs(ray[:, 2]), n) if n > 1.0 else 0.0)
        place[:, 2] = np.where(above, 2.0 * height - place[:, 2], place[:, 2])
        ray[:, 2] = np.where(above, -ray[:, 2], ray[:, 2])
        inside = np.all((place >= [0.0, -width / 2, 0.0]) & (place <= [length, width / 2, height]), axis=-1)
        alive = inside & (~above | (at_surface & back))
        place, ray = place[alive], ray[alive]
        toward, factor = sight(scene, place)
        cosine = np.sum(ray * toward, axis=-1)
        sums.append(medium.albedo ** (len(sums) + 1) * np.sum(phase_function(cosine, medium.g) * factor))
        mu = 2.0 * draw.random(len(ray)) - 1.0
        g = medium.g
        cosine = (1.0 + g * g - ((1.0 - g * g) / (1.0 + g * mu)) ** 2) / (2.0 * g)
        side = np.cross(ray, draw.normal(size=ray.shape))
        side /= np.linalg.norm(side, axis=-1)[:, None]
        ray = cosine[:, None] * ray + np.sqrt(1.0 - cosine**2)[:, None] * side
    return np.array(sums) * beam.power / photons / scene.camera.pixel_mm**2


def sight(scene: Scene, place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Direction from points towards the camera, and what becomes of light sent there (see `analog_sums`)."""
    n, depth = scene.tank.surface_index, scene.tank.size_mm[2] - place[:, 2]
    if scene.camera.kind == "orthographic":
        transmitted = (1.0 - fresnel_reflectance(1.0, n)) / n**2 if n > 1.0 else 1.0
        return np.broadcast_to([0.0, 0.0, 1.0], place.shape), transmitted * np.exp(-scene.medium.sigma_t * depth)
    camera = np.array(scene.camera.position_mm)
    height = camera[2] - scene.tank.size_mm[2]
    apart = camera[:2] - place[:, :2]
    distance = np.linalg.norm(apart, axis=-1)

    def landing(rho: NDArray[np.float64]) -> NDArray[np.float64]:
        sine = np.sin(np.arctan(rho / height)) / n
        return np.asarray(rho + depth * np.tan(np.arcsin(sine)))

    low, high = np.zeros(len(place)), distance.copy()
    for _ in range(40):
        middle = 0.5 * (low + high)
        short = landing(middle) < distance
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    slope = (landing(low + 1e-4) - landing(low - 1e-4)) / 2e-4
    in_air = np.arctan(low / height)
    in_water = np.arcsin(np.sin(in_air) / n)
    transmitted = (1.0 - fresnel_reflectance(np.cos(in_air), 1.0 / n)) / n**2 if n > 1.0 else 1.0
    jacobian = low / (distance * slope * np.cos(in_water))
    toward = np.column_stack([apart / distance[:, None] * np.sin(in_water)[:, None], np.cos(in_water)])
    return toward, transmitted * jacobian * np.exp(-scene.medium.sigma_t * depth / np.cos(in_water))


@pytest.mark.parametrize("camera", ["orthographic", "pinhole"])
def test_higher_orders_under_water_agree_with_an_analog_simulator(slanted: Scene, camera: str) -> None:
    """Were a reflection or a bent line of sight wrong for photons, the simulated camera would teach a wrong medium."""
    scene = replace(slanted, camera=PINHOLE_ABOVE if camera == "pinhole" else slanted.camera)
    expected = analog_sums(scene, photons=200_000, orders=3, seed=3)
    tally = simulate(scene, photons=100_000, seed=4)
    found = [tally.orders[order].sum() for order in (1, 2, 3)]
    assert found == pytest.approx(expected, rel=0.015)


def test_a_pinhole_camera_far_above_sees_what_an_orthographic_one_sees(slanted: Scene) -> None:
    far = Camera("pinhole", shape=(20, 30), pixel_mm=4.0, position_mm=(60.0, 0.0, 1e7))
    near, distant = (simulate(s, 40_000, seed=5) for s in (slanted, replace(slanted, camera=far)))
    assert near.orders[1] == pytest.approx(distant.orders[1], rel=0.01, abs=1e-3 * near.orders[1].max())
    assert near.image.sum() == pytest.approx(distant.image.sum(), rel=0.01)


# --- laws that hold in every tank ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("g", "surface"), [(0.0, "matched"), (0.3, "fresnel"), (0.85, "fresnel"), (-0.6, "matched")])
def test_light_is_absorbed_or_gets_out(slanted: Scene, g: float, surface: str) -> None:
    scene = replace(slanted, medium=Medium(0.002, 0.038, g), tank=replace(slanted.tank, surface=surface))
    tally = simulate(scene, photons=60_000, seed=6)
    assert tally.absorbed + tally.escaped == pytest.approx(1.0, abs=0.015 if abs(g) > 0.45 else 0.002)
    conservative = simulate(replace(scene, medium=Medium(0.0, 0.04, g)), photons=6_400, seed=6)
    assert conservative.absorbed == 0.0
    assert conservative.escaped == pytest.approx(1.0, abs=0.04 if abs(g) > 0.45 else 0.01)


def test_clear_and_merely_absorbing_water_are_dark() -> None:
    scene, _ = case("pub13")
    for sigma_a, absorbed in ((0.0, 0.0), (0.005, 1.0 - np.exp(-0.005 * 240.0))):
        tally = simulate(replace(scene, medium=Medium(sigma_a, 0.0, 0.5)), photons=640)
        assert not tally.image.any()
        assert tally.absorbed == pytest.approx(absorbed)
        assert tally.escaped == pytest.approx(1.0 - absorbed)


def test_beams_add_up_and_scale() -> None:
    scene, _ = case("pub13")
    scene = seen_in_blocks(scene)
    whole = simulate(scene, 40_000, seed=7)
    parts = [
        simulate(replace(scene, projector=replace(scene.projector, beams=(beam,))), 40_000, seed=8 + k)
        for k, beam in enumerate(scene.projector.beams)
    ]
    assert parts[0].orders[1] + parts[1].orders[1] == pytest.approx(whole.orders[1], rel=1e-12)
    stderr = np.hypot(parts[0].stderr, parts[1].stderr)
    assert rms_z(whole, parts[0].image + parts[1].image, stderr) < 1.3
    brighter = tuple(replace(beam, irradiance=3.0 * beam.irradiance) for beam in scene.projector.beams)
    tripled = simulate(replace(scene, projector=replace(scene.projector, beams=brighter)), 40_000, seed=7)
    assert tripled.image == pytest.approx(3.0 * whole.image, rel=1e-9)


def test_a_mirrored_scene_gives_the_mirrored_image() -> None:
    scene, _ = case("pub13")
    scene = seen_in_blocks(scene)
    beams = tuple(replace(beam, y_mm=(-beam.y_mm[1], -beam.y_mm[0])) for beam in scene.projector.beams)
    flipped = simulate(replace(scene, projector=replace(scene.projector, beams=beams)), 40_000, seed=10)
    tally = simulate(scene, 40_000, seed=11)
    assert flipped.orders[1][::-1] == pytest.approx(tally.orders[1], rel=1e-12)
    assert rms_z(tally, flipped.image[::-1], flipped.stderr[::-1]) < 1.3


def test_a_scene_twice_as_large_and_half_as_dense_looks_the_same(slanted: Scene) -> None:
    def doubled(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(2.0 * value for value in values)

    scene = replace(slanted, camera=PINHOLE_ABOVE)
    assert scene.projector.position_mm is not None
    assert scene.camera.position_mm is not None
    beams = tuple(replace(b, y_mm=doubled(b.y_mm), z_mm=doubled(b.z_mm)) for b in scene.projector.beams)
    large = Scene(
        tank=replace(scene.tank, size_mm=doubled(scene.tank.size_mm)),
        medium=Medium(scene.medium.sigma_a / 2.0, scene.medium.sigma_s / 2.0, scene.medium.g),
        projector=replace(scene.projector, beams=beams, position_mm=doubled(scene.projector.position_mm)),
        camera=replace(scene.camera, pixel_mm=8.0, position_mm=doubled(scene.camera.position_mm)),
    )
    small_tally, large_tally = simulate(scene, 6_400, seed=12), simulate(large, 6_400, seed=12)
    assert large_tally.orders[2] == pytest.approx(small_tally.orders[2], rel=1e-6, abs=1e-6 * small_tally.image.max())
    # Order 1 is cut into sheets of a millimetre, so its small error may differ.
    assert large_tally.orders[1] == pytest.approx(small_tally.orders[1], rel=0.01, abs=1e-3 * small_tally.image.max())


@pytest.mark.parametrize("surface", ["matched", "fresnel"])
@pytest.mark.parametrize("depth", [1e-4, 3.0, 1e3])
@pytest.mark.parametrize("g", [0.0, 1e-8, 0.5, 0.99, -0.99])
@pytest.mark.parametrize("albedo", [0.5, 1.0])
def test_extreme_media_stay_finite(albedo: float, g: float, depth: float, surface: str) -> None:
    """Never NaN, never negative, and it ends: also at optical depth 1000 without any absorption."""
    scene, _ = case("pub13")
    sigma_t = depth / 240.0
    medium = Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, g)
    scene = seen_in_blocks(replace(scene, medium=medium, tank=replace(scene.tank, surface=surface)))
    tally = simulate(scene, photons=64)
    for image in (tally.image, tally.stderr):
        assert np.isfinite(image).all()
        assert image.min() >= 0.0


# --- what callers rely on --------------------------------------------------------------------------------------------


def test_a_seed_gives_one_image_on_any_number_of_threads() -> None:
    scene, _ = case("pub05")
    one, again, other = (simulate(scene, 3_200, seed=s, threads=t) for s, t in ((1, 1), (1, 3), (2, 1)))
    assert np.array_equal(one.image, again.image)
    assert np.array_equal(one.stderr, again.stderr)
    assert one.absorbed == again.absorbed
    assert not np.array_equal(one.image, other.image)


def test_max_order_cuts_the_sum_and_nothing_else() -> None:
    scene, _ = case("pub07")
    scene = seen_in_blocks(scene)
    whole, cut = simulate(scene, 6_400, seed=3), simulate(scene, 6_400, seed=3, max_order=5)
    assert list(cut.orders) == [1, 2, 3, "4-20"]
    for order in (1, 2, 3):
        assert np.array_equal(whole.orders[order], cut.orders[order])
    assert 0.0 < cut.orders["4-20"].sum() < whole.orders["4-20"].sum()
    single = simulate(scene, 6_400, max_order=1)
    assert list(single.orders) == [1]
    assert not single.stderr.any()


def test_noise_is_what_it_claims_and_falls_to_the_tolerance() -> None:
    scene, reference = case("pub08")
    tally = simulate_to(scene, tolerance=0.01)
    assert tally.noise <= 0.01
    error = np.linalg.norm(tally.image - reference["total"]) / np.linalg.norm(reference["total"])
    assert 0.5 * tally.noise < error < 1.5 * tally.noise
    assert simulate_to(scene, tolerance=0.006).photons > tally.photons
    assert simulate_to(scene, tolerance=1e-9, most_photons=64_000).photons == 64_000


def test_a_coarser_tally_keeps_order_one_sharp() -> None:
    scene, reference = case("pub01")
    tally = simulate(scene, 40_000, coarsen=4)
    assert np.array_equal(tally.orders[1], first_order(scene))
    assert tally.image.sum() == pytest.approx(reference["total"].sum(), rel=0.01)
    assert tally.noise < 0.7 * simulate(scene, 40_000).noise


def test_pixels_beyond_the_tank_are_dark_and_grids_need_not_fit() -> None:
    scene, _ = case("pub13")
    fitting = simulate(scene, 3_200, seed=9)
    larger = simulate(replace(scene, camera=replace(scene.camera, shape=(90, 131))), 3_200, seed=9)
    assert np.array_equal(larger.image[:80, :120], fitting.image)
    assert not larger.image[80:].any()
    assert not larger.image[:, 120:].any()
    smaller = simulate(replace(scene, camera=replace(scene.camera, shape=(33, 50))), 3_200, seed=9)
    assert np.array_equal(smaller.image, fitting.image[:33, :50])


def test_counts_below_one_are_refused() -> None:
    scene, _ = case("pub01")
    for photons, max_order in ((0, None), (10, 0)):
        with pytest.raises(ValueError, match="give 1 or more"):
            simulate(scene, photons, max_order=max_order)
    with pytest.raises(ValueError, match="not positive"):
        simulate_to(scene, tolerance=0.0)
