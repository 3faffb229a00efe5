"""What is learned of a bench once serves every pattern at its heights: like the tank model, and without light paths."""

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tankrig
from tankrig.image.prepare import Prepared
from tankrig.light.double import (
    Tabulated,
    double_scattering,
    double_scattering_of,
    numbers_of_wall,
    table_error,
    tables_of_wall,
)
from tankrig.light.double import lit as lit_parts
from tankrig.light.prepared import entrance, plan
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.cache import Place
from tankrig.light.prepared.entrance import Entrance, bands, learn
from tankrig.light.prepared.sampling import PathImages
from tankrig.light.prepared.unlike import Conditions, why_not_learned
from tankrig.light.prepared.wall_tables import packed_tables, unpacked_tables
from tankrig.light.single import single_scattering, single_scattering_of
from tankrig.light.surface import many_to_camera, to_camera
from tankrig.light.tank import tank_image
from tankrig.live import preparing
from tankrig.live.formatting import preparation_in_words
from tankrig.live.preparing import LOOK, Preparing
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.phase_functions import ReynoldsMcCormick
from tests import bent_scenes as scenes
from tests.stress_scenes import relative
from ui.cli import main

BOX, TOLERANCE = Box((0.008, 0.011), (0.9, 0.98), (0.5, 0.65)), 0.1
MEDIUM = Medium(0.0005, 0.009, 0.58)
LIGHT = Projector("pinhole", (Beam((-4.0, 4.0), (46.0, 50.0)),), (-400.0, 5.0, 50.0))
BENCH = Scene(
    Tank((120.0, 80.0, 80.0), "fresnel", 1.33), MEDIUM, LIGHT, Camera("pinhole", (20, 30), 4.0, (60.0, 0.0, 500.0))
)
ROLLED = np.random.default_rng(2)
PATTERNS = {
    "beams": [Beam((-21.0, -17.0), (46.0, 50.0)), Beam((9.0, 13.0), (46.0, 50.0))],
    "stripes": [Beam((y, y + 4.0), (46.0, 50.0)) for y in (-30.0, -22.0, -14.0, -6.0, 2.0, 10.0)],
    "text": [Beam((y, y + 1.5), (z, z + 1.0)) for y in (-9.0, -5.0, 6.0, 7.5) for z in (46.0, 47.5, 49.0)],
    "noise": [Beam((y, y + 2.0), (46.0, 50.0), float(ROLLED.uniform())) for y in np.arange(-30.0, 30.0, 2.0)],
}


def lit_by(*beams: Beam) -> Scene:
    return replace(BENCH, projector=replace(LIGHT, beams=beams))


def prepare(scene: Scene) -> Prepared:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *_, **__: None)
        return tankrig.prepare(scene, TOLERANCE, box=BOX)


@pytest.fixture(scope="module", autouse=True)
def few_media() -> Iterator[None]:
    """A third as many media for a plan: they are what most of a bench's time goes to, and do for so small a box."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "FEWEST", 0.17)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a bench has been learned."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(folder))
        learn(BENCH, BOX, TOLERANCE, lambda _: None)
    return folder


@pytest.fixture
def followed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Scenes whose paths are followed."""
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))
    scenes: list[Scene] = []
    sample = PathImages.sample

    def counted(self: PathImages, medium: Medium, seed: int, batches: int) -> np.ndarray:
        scenes.append(self.scene)
        return sample(self, medium, seed, batches)

    monkeypatch.setattr(PathImages, "sample", counted)
    return scenes


@pytest.fixture
def tabulated(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Scenes for which order 2 is tabulated."""
    scenes: list[Scene] = []
    fill = lit_parts.fill_stack

    def counted(scene: Scene, *given: object) -> object:
        scenes.append(scene)
        return fill(scene, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(lit_parts, "fill_stack", counted)
    return scenes


@pytest.mark.parametrize("name", PATTERNS)
def test_a_pattern_that_was_never_seen_needs_no_paths_and_is_as_the_tank_model_has_it(
    followed: list[Scene], tabulated: list[Scene], name: str
) -> None:
    scene = lit_by(*PATTERNS[name])
    live = prepare(scene)
    assert not followed
    assert not tabulated
    truth = np.sum(list(tank_image(scene, batches=40).orders.values()), axis=0)
    error = relative(live.predict(MEDIUM), truth)
    assert error < 0.01
    assert error < 3.0 * live.error_at(MEDIUM)


@pytest.mark.parametrize(
    "other",
    [
        replace(BENCH, tank=replace(BENCH.tank, refractive_index=1.36)),
        replace(BENCH, projector=replace(LIGHT, position_mm=(-390.0, 5.0, 50.0))),
        replace(BENCH, camera=replace(BENCH.camera, position_mm=(60.0, 4.0, 500.0))),
        lit_by(Beam((-4.0, 4.0), (20.0, 24.0))),
    ],
    ids=["tank", "projector", "camera", "height"],
)
def test_what_was_learned_serves_no_other_bench(folder: Path, other: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))
    assert Entrance.known_to(other, BOX, TOLERANCE) is None
    assert Entrance.known_to(BENCH, Box((0.02, 0.03), BOX.albedo, BOX.g), TOLERANCE) is None
    assert Entrance.known_to(BENCH, BOX, TOLERANCE) is not None


def written(file: Path, **changed: str) -> Path:
    """The bench as a scene file."""
    said = {"index": "1.33", "z_mm": "[46.0, 50.0]", "light": "[-400.0, 5.0, 50.0]", "camera": "[60.0, 0.0, 500.0]"}
    said |= changed
    file.write_text(
        f'[tank]\nsize_mm = [120.0, 80.0, 80.0]\nsurface = "fresnel"\nrefractive_index = {said["index"]}\n'
        "[medium]\nsigma_a = 0.0005\nsigma_s = 0.009\ng = 0.58\n"
        f'[projector]\nkind = "pinhole"\nposition_mm = {said["light"]}\n'
        f"beams = [{{ y_mm = [-4.0, 4.0], z_mm = {said['z_mm']}, irradiance = 1.0 }}]\n"
        f'[camera]\nkind = "pinhole"\nshape = [20, 30]\npixel_mm = 4.0\nposition_mm = {said["camera"]}\n'
    )
    return file


def ranges(box: Box) -> list[str]:
    """A box as the command's options."""
    ends = {"--sigma-t": box.sigma_t, "--albedo": box.albedo, "--g": box.g}
    return [word for name, (low, high) in ends.items() for word in (name, str(low), str(high))]


@pytest.mark.parametrize(
    ("changed", "box", "said"),
    [
        ({"z_mm": "[20.0, 24.0]"}, BOX, "light at heights 44 … 52 mm, not 20 … 24 mm"),
        ({"index": "1.36"}, BOX, "a surface of refractive index 1.33, not 1.36"),
        ({"light": "[-390.0, 5.0, 50.0]"}, BOX, "its projector (x, y, z) at -400, 5, 50 mm, not -390, 5, 50 mm"),
        (
            {"camera": "[60.0, 0.001, 500.0]"}, BOX,
            "its camera (x, y, z) at 60, 0, 500 mm, not 60, 0.001, 500 mm",
        ),
        (
            {}, Box((0.02, 0.021), BOX.albedo, (0.5, 0.6)),
            "σt 0.008 … 0.011/mm, not 0.02 … 0.021/mm; g 0.5 … 0.65, not 0.5 … 0.6",
        ),
        ({}, BOX, None),
    ],
    ids=["height", "tank", "projector", "camera", "liquid", "learned"],
)  # fmt: skip
def test_the_command_says_why_a_learned_bench_does_not_serve_and_prepares_all_the_same(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    changed: dict[str, str], box: Box, said: str | None,
) -> None:  # fmt: skip
    """A person who learned a bench waits a minute for every pattern, and would not know why."""
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))
    words = ["prepare", str(written(tmp_path / "scene.toml", **changed)), "--tolerance", "0.1", *ranges(box)]
    sentence = f"the bench that was learned has {said}: this pattern's paths are followed anew"
    assert main(words) == 0
    first = capsys.readouterr().out
    assert "ready" in first
    assert [line for line in first.splitlines() if "learned" in line] == ([f"note     {sentence}"] if said else [])
    assert main([*words, "--json"]) == 0  # now it is kept, and nothing is followed
    assert not [one for one in json.loads(capsys.readouterr().out)["notes"] if "learned" in one]


def test_of_several_learned_benches_the_nearest_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    lit = PathImages(BENCH, ()).lit
    assert why_not_learned(lit, BOX, TOLERANCE) == ""
    moved = replace(lit, camera=replace(lit.camera, position_mm=(60.0, 9.0, 500.0)))
    for one, box, band in (
        (moved, BOX, (44.0, 52.0)), (lit, Box((0.02, 0.03)), (44.0, 52.0)), (lit, BOX, (10.0, 20.0)),
        (lit, BOX, (60.0, 70.0)),
    ):  # fmt: skip
        place = Place.of(one, box, band)
        place = replace(place, name=f"{place.name}_{band[0]:g}_{band[1]:g}")
        place.keep(place.model, Conditions.of(one, box, TOLERANCE, band).arrays)
    (place.folder / "0123_4_5.npz").write_bytes(b"no archive")
    assert "has light at heights 60 … 70 mm, not 46 … 50 mm:" in why_not_learned(lit, BOX, TOLERANCE)
    denser = why_not_learned(lit, Box((0.02, 0.031)), TOLERANCE)
    assert "has σt 0.02 … 0.03/mm, not 0.02 … 0.031/mm:" in denser


def test_a_run_says_why_a_learned_bench_does_not_serve(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the line that says how long its models still take."""
    monkeypatch.setenv("TANKRIG_CACHE", str(folder))
    lower, told, go_on = lit_by(Beam((-4.0, 4.0), (30.0, 34.0))), threading.Event(), threading.Event()

    def prepare(_scene: Scene, _tolerance: float, _progress: object, _box: Box, **_: object) -> str:
        told.set()
        go_on.wait(10.0)
        return "model"

    monkeypatch.setattr(preparing, "prepare", prepare)
    monkeypatch.setattr(preparing, "tolerance_for", lambda *_: TOLERANCE)
    run = Preparing()
    run.want([([lower], BOX)])
    assert told.wait(10.0)
    said = preparation_in_words(run.left)
    go_on.set()
    run.close()
    assert said.startswith("1 model is being prepared for the fit; the bench that was learned has light at heights")
    assert preparing.unlike_learned(BENCH, BOX) == preparing.unlike_learned(lower, LOOK) == ""


def test_light_beside_the_band_is_followed_by_few_paths(followed: list[Scene]) -> None:
    """Halo and black level reach all of the wall."""
    beam, weak = Beam((-4.0, 4.0), (46.0, 50.0)), Beam((-40.0, 40.0), (0.0, 80.0), 0.002)
    known = Entrance.known_to(lit_by(beam, weak), BOX, TOLERANCE)
    assert known is not None
    sampling, sample = PathImages(lit_by(beam, weak), known.plan.albedos), known.plan.paths[0]
    image = dict(known.images(sampling, [sample]))[sample.index]
    assert [one.projector.beams for one in followed] == [(weak,)]
    direct = sampling.sample(Medium(0.0, sample.sigma_t, sample.g), 7, range(30))
    light, truth = (float((one[-1] @ sampling.along.T).sum()) for one in (image, direct))
    assert light == pytest.approx(truth, rel=0.08)


class EnoughError(Exception):
    """Raised to interrupt."""


def test_what_was_interrupted_goes_on(followed: list[Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bench half as large in each direction says it sooner."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    light = Projector("pinhole", (Beam((-4.0, 4.0), (18.0, 22.0)),), (-400.0, 5.0, 20.0))
    camera = Camera("pinhole", (10, 15), 4.0, (30.0, 0.0, 460.0))
    small = Scene(Tank((60.0, 40.0, 40.0), "fresnel", 1.33), MEDIUM, light, camera)

    def stop(share: float) -> None:
        if share > 0.4:
            raise EnoughError

    with pytest.raises(EnoughError):
        learn(small, BOX, TOLERANCE, stop, 1)
    assert Entrance.known_to(small, BOX, TOLERANCE) is None
    first = len(followed)
    (one,) = learn(small, BOX, TOLERANCE, lambda _: None, 1)
    assert len(followed) == len(one.plan.paths) * len(one.strips.scenes)
    assert 0 < first < len(followed)
    followed.clear()
    learn(small, BOX, TOLERANCE, lambda _: None, 1)
    assert not followed


def test_what_is_not_learned_is_refused_in_one_sentence() -> None:
    plain = replace(BENCH, projector=Projector("collimated", LIGHT.beams), camera=Camera("orthographic", (20, 30), 4.0))
    with pytest.raises(tankrig.SceneError, match="prepare the pattern by itself"):
        learn(plain, BOX, TOLERANCE, lambda _: None)
    with pytest.raises(tankrig.SceneError, match=r"one to 3 heights.*such z_mm"):
        bands(lit_by(Beam((-4.0, 4.0), (10.0, 40.0))))
    heights = [Beam((-4.0, 4.0), (z, z + 4.0)) for z in (10.0, 25.0, 40.0)]
    assert bands(lit_by(*heights)) == [(8.0, 16.0), (23.0, 31.0), (38.0, 46.0)]
    assert entrance.MOST_BANDS == 3


WALL_MEDIA = [Medium(0.0, 0.003, 0.2), Medium(0.0, 0.012, 0.7), Medium(0.0, 0.012, 0.85)]


@pytest.fixture(scope="module")
def of_wall() -> list[Tabulated]:
    return tables_of_wall(BENCH, (44.0, 52.0), WALL_MEDIA, 0.005)


@pytest.mark.parametrize(
    "beams",
    [
        PATTERNS["beams"],
        pytest.param(PATTERNS["stripes"], marks=pytest.mark.long),
        PATTERNS["text"],
        PATTERNS["noise"],
        [Beam((-39.0, -36.0), (46.0, 50.0)), Beam((33.0, 37.0), (44.0, 46.0))],
    ],
    ids=[*PATTERNS, "walls"],
)
def test_order_2_from_tables_of_the_wall_is_as_from_fine_ones_of_the_pattern(
    of_wall: list[Tabulated], tabulated: list[Scene], beams: list[Beam]
) -> None:
    """Light that leaves through a side wall is off by up to .6 %, by either."""
    scene = lit_by(*beams)
    found = double_scattering_of(scene, WALL_MEDIA, 0.005, of_wall)
    assert not tabulated
    own, fine = (double_scattering_of(scene, WALL_MEDIA, tolerance) for tolerance in (0.005, 0.001))
    for medium, image, of_pattern, truth in zip(WALL_MEDIA, found, own, fine, strict=True):
        lit = replace(scene, medium=medium)
        low_orders = float(np.linalg.norm(single_scattering(lit) + truth))
        stated, as_before = table_error(lit, 0.005) * low_orders, float(np.linalg.norm(of_pattern - truth))
        assert np.linalg.norm(image - truth) < max(stated, 1.05 * as_before)


def test_tables_of_the_wall_serve_no_other_light(of_wall: list[Tabulated], tabulated: list[Scene]) -> None:
    """What they do not hold has tables of its own, and nothing is taken from those of another bench."""
    inside, beside = Beam((-4.0, 4.0), (46.0, 50.0)), Beam((-4.0, 4.0), (50.0, 54.0))
    both = double_scattering_of(lit_by(inside, beside), WALL_MEDIA, 0.005, of_wall)
    assert {one.projector.beams for one in tabulated} == {(beside,)}
    alone = [double_scattering_of(lit_by(one), WALL_MEDIA, 0.005) for one in (inside, beside)]
    for image, sum_of_both in zip(both, np.sum(alone, axis=0), strict=True):
        assert relative(image, sum_of_both) < 0.002
    finer = replace(BENCH, camera=Camera("pinhole", (40, 60), 2.0, (60.0, 0.0, 500.0)))
    for other in (finer, replace(BENCH, projector=replace(LIGHT, position_mm=(-390.0, 5.0, 50.0)))):
        found = double_scattering_of(other, WALL_MEDIA, 0.005, of_wall)
        assert np.array_equal(found, double_scattering_of(other, WALL_MEDIA, 0.005))


def test_tables_come_back_from_a_file_as_they_were(of_wall: list[Tabulated]) -> None:
    back = unpacked_tables(packed_tables(of_wall), len(WALL_MEDIA))
    scene = lit_by(*PATTERNS["beams"])
    found, once = (double_scattering_of(scene, WALL_MEDIA, 0.005, one) for one in (back, of_wall))
    assert np.allclose(found, once, rtol=1e-6)
    numbers = numbers_of_wall(BENCH, (44.0, 52.0), WALL_MEDIA, 0.005)
    assert numbers == sum(one.stack.values.size for one in of_wall)
    with pytest.raises(ValueError, match="other liquids"):
        unpacked_tables(packed_tables(of_wall), 2)


@pytest.mark.parametrize("scene", [scenes.small(MEDIUM), BENCH], ids=["calibrated", "pinholes"])
def test_order_1_of_several_liquids_is_that_of_each(scene: Scene) -> None:
    """The densest says how finely lines of sight are cut, the thinnest how far they are followed; where one has another
    phase function, they are all read from tables."""
    media = [Medium(0.0, 0.003, 0.2), Medium(0.0, 0.05, 0.7), Medium(0.001, 0.02, 0.92)]
    for medium, image in zip(media, single_scattering_of(scene, media), strict=True):
        alone = single_scattering(replace(scene, medium=medium))
        assert alone.any()
        assert relative(image, alone) < 1e-5
    mixed = [media[0], Medium(0.0, 0.01, phase=ReynoldsMcCormick(0.5, 1.0))]
    for medium, image in zip(mixed, single_scattering_of(scene, mixed), strict=True):
        assert relative(image, single_scattering(replace(scene, medium=medium))) < 1e-5


def test_order_2_of_several_liquids_is_that_of_each() -> None:
    """Tables are as fine as the steepest and the densest of them wants: they agree to what coarse ones err by."""
    media = [Medium(0.0, 0.003, 0.2), Medium(0.0, 0.012, 0.7), Medium(0.001, 0.02, 0.92)]
    scene = lit_by(*PATTERNS["text"])
    together = double_scattering_of(scene, media, 0.01)
    for medium, image in zip(media, together, strict=True):
        assert relative(image, double_scattering(replace(scene, medium=medium), 0.01)) < 0.002


def test_the_command_learns_a_bench_before_it_prepares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    learned: list[tuple[Scene, Box, float]] = []
    monkeypatch.setattr(entrance, "learn", lambda scene, box, tolerance, _: learned.append((scene, box, tolerance)))
    file = written(tmp_path / "scene.toml")
    assert main(["prepare", str(file), "--tolerance", "0.5", "--bench", *ranges(BOX)]) == 0
    ((scene, box, tolerance),) = learned
    assert (box, tolerance) == (BOX, 0.5)
    assert scene.projector.beams == (Beam((-4.0, 4.0), (46.0, 50.0)),)
    assert "ready" in capsys.readouterr().out


def test_many_images_are_looked_up_as_each_is() -> None:
    scene = scenes.bench(MEDIUM)
    images = np.random.default_rng(3).random((5, 60, 90)).cumsum(axis=1)
    cell_mm = scene.tank.size_mm[0] / 90.0, scene.tank.size_mm[1] / 60.0
    together = many_to_camera(scene, images, cell_mm)
    for image, found in zip(images, together, strict=True):
        each = to_camera(scene, image, cell_mm)
        assert each.any()
        assert np.allclose(found, each, rtol=1e-9, atol=1e-12)
