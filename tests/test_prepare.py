"""A prepared model answers like the tank model, keeps what it has done, and never trusts a file that is not its own."""

import json
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tankrig
from tankrig.image.prepare import Prepared
from tankrig.light.paths.block import SMALL, PathLimits
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.lattices import traced
from tankrig.light.prepared import cache, preparation
from tankrig.light.prepared import sampling as sampling_module
from tankrig.light.prepared.answer import Answer
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.noise import Noise, signs_of_chance
from tankrig.light.prepared.plan import PreparationPlan
from tankrig.light.prepared.polynomials import Plane
from tankrig.light.prepared.regression import Fit, Regression
from tankrig.light.prepared.sampling import PathImages
from tankrig.light.tangent import tank_accurate
from tankrig.light.tank import tank_image
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tests.stress_scenes import relative
from ui.cli import main

REFERENCE = Path(__file__).parent / "data" / "reference"
BOX = Box((0.004, 0.007), (0.8, 0.98), (0.3, 0.6))
TOLERANCE = 0.02
UNEVEN = Projector("collimated", (Beam((-20.0, -4.0), (58.0, 62.0)), Beam((30.0, 42.0), (40.0, 50.0), 0.5)))
SCENE = Scene(Tank(), Medium(0.0004, 0.005, 0.45), UNEVEN, Camera("orthographic", (20, 30), 8.0))
MEDIUM = SCENE.medium


def prepare(scene: Scene = SCENE) -> Prepared:
    return tankrig.prepare(scene, TOLERANCE, box=BOX)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def cached(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))


@pytest.fixture(scope="module")
def live(folder: Path) -> Iterator[Prepared]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(folder))
        yield prepare()


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is computed, as it is computed."""
    names: list[str] = []
    exact, sample = preparation.exact_images, PathImages.sample

    def counted_exact(*given: object) -> np.ndarray:
        names.append("exact")
        return exact(*given)  # type: ignore[arg-type]

    def counted_sample(*given: object) -> np.ndarray:
        names.append("paths")
        return sample(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(preparation, "exact_images", counted_exact)
    monkeypatch.setattr(PathImages, "sample", counted_sample)
    return names


@pytest.mark.parametrize("medium", [MEDIUM, Medium(0.0002, 0.0064, 0.32), Medium(0.0008, 0.0034, 0.59)])
def test_it_answers_like_the_tank_model_and_its_stated_error_is_about_right(live: Prepared, medium: Medium) -> None:
    truth = np.sum(list(tank_image(replace(SCENE, medium=medium), batches=12).orders.values()), axis=0)
    error = relative(live.predict(medium), truth)
    assert error < 0.01
    assert error < 3.0 * live.error_at(medium)
    assert 0.0 < live.error <= live.largest_error < 0.02


@pytest.mark.parametrize("name", ["sigma_a", "sigma_s", "g"])
def test_the_remainder_of_a_taylor_step_falls_as_its_square(live: Prepared, name: str) -> None:
    """A fit on wrong derivatives stops at the wrong place, and its error bars are fiction."""
    image, slopes = live.predict(MEDIUM, derivatives=True)
    slope = slopes[("sigma_a", "sigma_s", "g").index(name)]
    step = {"sigma_a": 2e-4, "sigma_s": 3e-4, "g": 0.02}[name]

    def remainder(h: float) -> float:
        moved = replace(MEDIUM, **{name: getattr(MEDIUM, name) + h})
        return float(np.linalg.norm(live.predict(moved) - image - h * slope))

    assert np.allclose(image, live.predict(MEDIUM), rtol=1e-12, atol=0.0)
    assert remainder(step) / remainder(step / 2) == pytest.approx(4.0, rel=0.15)


def test_images_are_never_negative(live: Prepared) -> None:
    for place in np.random.default_rng(0).uniform(-1.0, 1.0, (50, 3)):
        sigma_t, albedo, g = live.answer.coordinates.back(place)
        image = live.predict(Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, g))
        assert np.isfinite(image).all()
        assert image.min() >= 0.0


@pytest.mark.parametrize(
    ("medium", "named"),
    [
        (Medium(0.005, 0.06, 0.5), r"= 0.065 is outside 0.004 … 0.007"),
        (Medium(0.003, 0.002, 0.5), "albedo σs/σt = 0.4 is outside 0.8 … 0.98"),
        (Medium(0.0004, 0.005, 0.7), "g = 0.7 is outside 0.3 … 0.6"),
    ],
)
def test_a_medium_outside_the_box_is_refused_by_name(live: Prepared, medium: Medium, named: str) -> None:
    for ask in (live.predict, live.error_at):
        with pytest.raises(tankrig.SceneError, match=named):
            ask(medium)


def test_what_is_kept_is_not_computed_again(live: Prepared, made: list[str]) -> None:
    again = prepare(replace(SCENE, medium=Medium(0.1, 0.1, 0.0)))  # the medium of the scene does not matter
    assert not made
    assert np.array_equal(again.predict(MEDIUM), live.predict(MEDIUM))
    assert not list(live.path.parent.glob("*.parts"))


@pytest.mark.parametrize("damage", ["truncated", "flipped", "foreign", "of another scene", "outdated"])
def test_a_file_that_is_not_the_model_is_not_believed(
    live: Prepared, folder: Path, damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Believed, it would be a wrong image; here it counts as missing, so that the model is made again."""
    place = cache.Place(folder / "prepared", live.path.stem)
    good = live.path.read_bytes()
    other = cache.Place(tmp_path, "other" if damage == "of another scene" else live.path.stem)
    content = {
        "truncated": good[: len(good) // 2],
        "flipped": good[:-3000] + bytes([good[-3000] ^ 255]) + good[-2999:],
        "foreign": b"not a model",
        "of another scene": good,
        "outdated": good,
    }[damage]
    other.keep(other.model, {})
    other.model.write_bytes(content)
    assert place.kept(live.path) is not None
    if damage == "outdated":
        monkeypatch.setattr(cache, "code_mark", lambda: "of other code")
    assert other.kept(other.model) is None


def test_a_damaged_model_is_made_again(live: Prepared, made: list[str]) -> None:
    image = live.predict(MEDIUM)
    live.path.write_bytes(live.path.read_bytes()[:1000])
    assert np.allclose(prepare().predict(MEDIUM), image, rtol=1e-9)
    assert "paths" in made
    assert "exact" in made
    made.clear()
    prepare()
    assert not made


def test_a_killed_preparation_goes_on_where_it_was(
    live: Prepared, tmp_path: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    script = f"""
        import os, signal, sys
        sys.path.insert(0, {str(Path(__file__).parent)!r})
        import test_prepare as here
        def killed_half_way(share):
            if share > 0.5:
                os.kill(os.getpid(), signal.SIGKILL)
        here.cache.code_mark = lambda: {cache.code_mark()!r}
        here.tankrig.prepare(here.SCENE, here.TOLERANCE, killed_half_way, here.BOX)
    """
    environment = {**os.environ, "TANKRIG_CACHE": str(tmp_path)}
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], env=environment, timeout=120, check=False)
    assert ended.returncode == -signal.SIGKILL
    files = list(tmp_path.glob("prepared/*.parts/[!.]*.npz"))  # what was being written has a dot before it
    left = len(files)
    assert sum(len(np.load(file)["images"]) for file in files) > 10  # media
    torn = files[0]
    torn.write_bytes(torn.read_bytes()[:100])
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    shares: list[float] = []
    resumed = tankrig.prepare(SCENE, TOLERANCE, shares.append, BOX)
    plan = preparation.PreparationPlan(BOX, 240.0, TOLERANCE)
    assert len(made) == len(plan.together) + len(plan.paths) - left + 1
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert np.allclose(resumed.predict(MEDIUM), live.predict(MEDIUM), rtol=1e-9)


def test_no_room_is_said_before_any_work(tmp_path: Path, made: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    usage = cache.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda _: usage._replace(free=1000))
    with pytest.raises(tankrig.CacheError, match=r"no room for a prepared model.*TANKRIG_CACHE"):
        prepare()
    assert not made


def test_a_cache_that_is_a_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "file"))
    with pytest.raises(tankrig.CacheError, match=r"not a folder.*TANKRIG_CACHE"):
        prepare()


@pytest.mark.parametrize("tolerance", [0.0, 1.5, float("nan")])
def test_senseless_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(tankrig.SceneError, match="tolerance"):
        tankrig.prepare(SCENE, tolerance, box=BOX)


@pytest.mark.parametrize("ranges", [{"g": (0.5, 0.5)}, {"albedo": (0.5, 1.1)}, {"sigma_t": (0.1, 0.01)}])
def test_senseless_boxes_are_refused(ranges: dict[str, tuple[float, float]]) -> None:
    with pytest.raises(tankrig.SceneError, match="cannot be prepared"):
        Box(**ranges)


def test_the_command_says_what_it_has_made(live: Prepared, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.toml"
    beams = ", ".join(
        f"{{ y_mm = {list(beam.y_mm)}, z_mm = {list(beam.z_mm)}, irradiance = {beam.irradiance} }}"
        for beam in UNEVEN.beams
    )
    scene.write_text(
        '[tank]\nsize_mm = [240.0, 160.0, 120.0]\nsurface = "matched"\n'
        "[medium]\nsigma_a = 0.1\nsigma_s = 0.1\ng = 0.0\n"
        f'[projector]\nkind = "collimated"\nbeams = [{beams}]\n'
        '[camera]\nkind = "orthographic"\nshape = [20, 30]\npixel_mm = 8.0\n'
    )
    ranges: list[str] = []
    for name, ends in (("sigma-t", BOX.sigma_t), ("albedo", BOX.albedo), ("g", BOX.g)):
        ranges += [f"--{name}", *(str(end) for end in ends)]
    assert main(["prepare", str(scene), "--tolerance", str(TOLERANCE), *ranges, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["error"] == live.error
    assert Path(said["cache"]) == live.path


@pytest.mark.long
@pytest.mark.parametrize("case", ["pub01", "pub05", "pub09", "pub11"])
def test_reference_cases_over_the_whole_box(case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    with np.load(REFERENCE / f"{case}.npz") as data:
        truth, stderr = data["total"].astype(float), data["stderr"].astype(float)
    scene = tankrig.load_scene(REFERENCE / f"{case}.toml")
    with pytest.warns(UserWarning, match="the prepared model's error"):
        live = tankrig.prepare(scene)
    error = relative(live.predict(scene.medium), truth) ** 2 - (np.linalg.norm(stderr) / np.linalg.norm(truth)) ** 2
    assert np.sqrt(max(0.0, error)) < 0.007


def test_a_dark_scene_and_a_camera_too_fine_are_refused() -> None:
    dark = replace(SCENE, projector=Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0), 0.0),)))
    with pytest.raises(tankrig.SceneError, match="irradiance"):
        prepare(dark)
    with pytest.raises(tankrig.SceneError, match="bin them"):
        prepare(replace(SCENE, camera=Camera("orthographic", (1024, 1280), 0.1875)))


def test_light_that_fades_at_the_walls_is_kept() -> None:
    """As light that comes back does where sights slant: no training image had its last columns."""
    scene = replace(SCENE, camera=Camera("pinhole", (80, 120), 2.0, (140.0, 0.0, 500.0)))
    along = PathImages(scene, (0.9,)).along
    column = np.arange(120) + 0.5
    light = np.exp(-column / 40.0) * np.clip(column / 2.0, 0.0, 1.0) * np.clip((120.0 - column) / 6.0, 0.0, 1.0)
    kept = along @ (along.T @ light)
    assert relative(kept, light) < 0.002
    assert (np.abs(kept - light) < 0.2 * light).all()


@pytest.mark.parametrize("g", [(0.85, 0.97), (0.6, 0.8), (-0.4, -0.2), (-0.9, -0.75)])
def test_asymmetries_near_one_get_the_degrees_that_they_take(g: tuple[float, float]) -> None:
    """Light turned at right angles goes with log(1 − g²): of g .85 to .97 all orders were 1 % too dim alike."""
    plan = PreparationPlan(Box((0.008, 0.013), (0.8, 0.9999), g), 240.0, 0.01, True)
    degree = plan.exact_plane.degrees[1]
    nodes, places = np.polynomial.chebyshev.chebpts1(degree + 1), np.linspace(-1.0, 1.0, 60)

    def sideways(v: np.ndarray) -> np.ndarray:
        forward = plan.coordinates.back(np.stack([0.0 * v, 0.0 * v, v], axis=-1))[:, 2]
        return np.asarray(np.log((1.0 - forward**2) / (1.0 + forward**2) ** 1.5))

    series = np.polynomial.chebyshev.chebfit(nodes, sideways(nodes), degree)
    assert np.abs(np.polynomial.chebyshev.chebval(places, series) - sideways(places)).max() < 0.001


def fit_of(products: np.ndarray, images: np.ndarray) -> Fit:
    """Polynomials fitted to (media, 1, cells) images of one albedo, all alike in brightness and noise."""
    media, _, cells = images.shape
    even = np.ones((media, 1))
    regression = Regression(products, even, np.ones(media), even, images, np.full(cells, 1.0 / cells), 0.0 * even)
    return regression.fit(np.ones(media, bool))


def test_what_noise_hides_is_not_left_out() -> None:
    """Coefficients as small as their noise were drawn to 0, in both halves alike: inks came out up to 2 % too thick."""
    rng, media, cells = np.random.default_rng(3), 48, 30
    places = rng.uniform(-1.0, 1.0, (media, 2))
    products = np.stack([np.polynomial.chebyshev.chebvander2d(*places.T, (2, 2))[:, k] for k in (0, 1, 2, 3, 4, 6)], 1)
    field = np.concatenate([np.ones((1, cells)), 0.03 * np.resize([1.0, -1.0], (5, cells))])  # as much light everywhere
    assert products.shape == (media, 6)
    noise, fits = 0.1, []
    for _ in range(200):
        images = (products @ field + noise * rng.normal(size=(media, cells)))[:, None]
        fit = fit_of(products, images)
        fits.append(np.exp(fit.scale[0, 0]) * fit.fields[0])
    mean, error = np.mean(fits, axis=0), np.std(fits, axis=0) / np.sqrt(len(fits))
    kept = float(np.sum(mean[1:] * field[1:]) / np.sum(field[1:] ** 2))
    assert kept == pytest.approx(1.0, abs=4.0 * float(np.mean(error[1:])) / 0.03 / np.sqrt(5 * cells) + 0.01)


def test_what_is_left_of_images_tells_what_their_noise_does_to_answers() -> None:
    """For sums over any part of an image too, and for its derivatives: so that a fit knows what it can believe."""
    rng, plane, media, cells = np.random.default_rng(4), Plane((2, 2), 1.0), 24, 30
    places = rng.uniform(-1.0, 1.0, (media, 2))
    products, field = plane.values(*places.T), np.zeros((plane.size, cells))
    field[0], noise = 1.0, 0.05
    place, rates = np.array([0.3, 0.0, -0.6]), np.array([2.0, 3.0, 5.0])
    weights = np.stack([np.ones(cells), np.cos(np.arange(cells)), np.eye(cells)[7]])
    seen, told, seen_slopes, told_slopes = [], [], [], []
    for _ in range(300):
        images = (products @ field + noise * rng.normal(size=(media, cells)))[:, None]
        fit = fit_of(products, images)
        known = Noise(0, plane, Plane((0, 0), 1.0), fit.scale, fit.pull, fit.left)
        value, by_u, by_v = plane.values_and_slopes(place[0], place[2]) @ fit.fields[0] * np.exp(fit.scale[0, 0])
        seen.append(weights @ (value - 1.0))
        told.append(np.sum((known.images(place, 1.0) @ weights.T) ** 2, axis=0))
        seen_slopes.append(np.stack([weights @ (rates[0] * by_u), weights @ (rates[2] * by_v)]))
        told_slopes.append(np.sum((known.slopes(place, rates, 1.0, 1.0)[:, [0, 2]] @ weights.T) ** 2, axis=0))
    assert np.mean(np.square(seen), axis=0) / np.mean(told, axis=0) == pytest.approx(np.ones(3), abs=0.3)
    slopes = np.mean(np.square(seen_slopes), axis=0) / np.mean(told_slopes, axis=0)
    assert slopes == pytest.approx(np.ones((2, 3)), abs=0.35)


def test_errors_of_derivatives_are_the_derivatives_of_errors(live: Prepared) -> None:
    answer, medium = live.answer, MEDIUM
    assert isinstance(answer, Answer)
    found = answer.errors_of_slopes_at(medium)
    signs = signs_of_chance(len(found), answer.noise.left.shape[0])
    for number, (name, step) in enumerate((("sigma_a", 1e-7), ("sigma_s", 1e-7), ("g", 1e-5))):
        at = getattr(medium, name)
        above, below = (answer.errors_at(replace(medium, **{name: at + side * step})) for side in (1.0, -1.0))
        expected = signs @ (above - below) / (2.0 * step)
        assert relative(found[:, number], expected) < 1e-4


def test_a_model_is_off_by_what_its_patterns_say(live: Prepared) -> None:
    """Sums over the image and over parts of it, at several media: neither more nor a fraction of it."""
    rows, columns = np.mgrid[:20, :30]
    weights = np.stack([np.ones((20, 30)), columns - 14.5, np.cos(rows / 3.0), np.sin(columns / 4.0)])
    squares = []
    for medium in (MEDIUM, Medium(0.0002, 0.0064, 0.32), Medium(0.0008, 0.0034, 0.59), Medium(0.0003, 0.006, 0.5)):
        truth = tank_accurate(replace(SCENE, medium=medium), 400_000, seed=9)
        assert truth.patterns is not None
        patterns, tables = live.errors_at(medium)
        size = float(np.linalg.norm(truth.image))
        stated = np.hypot(np.linalg.norm(patterns), tables * size) / size
        assert live.error_at(medium) == pytest.approx(stated, rel=0.5)
        off = np.tensordot(weights, live.predict(medium) - truth.image, 2)
        known = sum(
            np.sum(np.tensordot(weights, one, ((1, 2), (1, 2))) ** 2, axis=1) for one in (patterns, truth.patterns)
        )
        squares.append(off**2 / known)
    assert 0.15 < np.mean(squares) < 3.0


def lattices(medium: Medium, count: int, limits: PathLimits) -> np.ndarray:
    """(count, rows, columns) images of orders ≥ 3, of one lattice each."""
    scene = replace(SCENE, medium=medium)
    grid, one_bin = CellGrid.of(scene), np.zeros(4, np.int64)
    return np.array([traced(scene, grid, (0, number), one_bin, limits, SMALL)[0] for number in range(count)])


def scatter(images: np.ndarray) -> float:
    return float(np.sqrt(np.sum(images.var(axis=0, ddof=1))) / np.linalg.norm(images.mean(axis=0)))


@pytest.mark.parametrize("medium", [Medium(0.0, 0.06, 0.8), Medium(0.0, 0.08, 0.95), Medium(0.0, 0.03, 0.0)])
def test_faint_marks_that_stand_for_others_lose_no_light_and_add_little_noise(medium: Medium) -> None:
    """Left by chance, marks take half the time in deep water; if they were off, it would be at all media alike."""
    every = lattices(medium, 60, PathLimits(200, 3e-4, 16))
    some = lattices(medium, 60, PathLimits(200, 3e-4, 16, faintest_mark=3.0))
    assert not np.array_equal(every, some)
    all_light = every.sum(axis=(1, 2))
    off = (some.sum(axis=(1, 2)) - all_light) / all_light.mean()
    stderr = float(off.std(ddof=1)) / np.sqrt(len(off))
    assert abs(off.mean()) < 4.0 * stderr < 0.01
    assert scatter(some) < 1.15 * scatter(every)


def test_where_dense_water_scatters_straight_on_paths_turn_later(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the box's worst corner a lattice had twice the noise."""
    sampling, medium = PathImages(SCENE, (0.999,)), Medium(0.0, 0.08, 0.95)
    late = scatter(np.array([sampling.sample(medium, number, range(1))[0] for number in range(12)]))
    monkeypatch.setattr(sampling_module, "TURNS_PER_DEPTH", 0.0)
    early = scatter(np.array([sampling.sample(medium, number, range(1))[0] for number in range(12)]))
    assert late < 0.75 * early


def test_paths_are_followed_at_the_ends_of_the_box_too_and_most_in_its_worst_corner() -> None:
    """Beyond the last medium the fit is an extrapolation: the corner was 4.8 % off."""
    plan = PreparationPlan(Box(), 240.0, 0.01)
    corner = [one for one in plan.paths if one.sigma_t > 0.115 and one.g > 0.94]
    assert any(one.place == (1.0, 1.0) for one in corner)
    for end in (-1.0, 1.0):
        assert any(one.place[0] == end for one in plan.paths)
        assert any(one.place[1] == end for one in plan.paths)
    assert min(one.batches for one in corner) >= max(one.batches for one in plan.paths if one.sigma_t < 0.06)
