"""Scenes of real benches: all models take them, and a plain scene in a calibrated camera's words stays what it is."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.bench import Bench
from tankrig.geometry.refraction import entry_wall, transmitted
from tankrig.geometry.view import pixels_of, rays_of
from tankrig.image.predict import predict
from tankrig.light.double import double_scattering
from tankrig.light.double import lit as lit_parts
from tankrig.light.prepared.box import Box
from tankrig.light.single import single_scattering
from tankrig.light.surface import on_surface, to_camera
from tankrig.montecarlo import first_order, simulate
from tankrig.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.footprint import footprints
from tankrig.scene.outline import beam_outlines, edges_of_light
from tankrig.scene.projection import irradiance_on_wall, lit_by
from tests import bent_scenes as scenes

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "bench_scene.toml"
MEDIUM = Medium(0.001, 0.019, 0.6)
SMALL: Scene = scenes.small(MEDIUM)
PLAIN = replace(
    SMALL,
    tank=Tank((120.0, 80.0, 60.0)),
    camera=Camera("pinhole", (20, 30), 4.0, (60.0, 5.0, 300.0)),
)
SAME = replace(  # the same camera, whose rows must run towards −y as no camera sees mirror images
    PLAIN,
    camera=Camera(
        "calibrated",
        (20, 30),
        position_mm=(60.0, 5.0, 300.0),
        matrix=((60.0, 0.0, 14.5), (0.0, 60.0, 9.5 - 5.0 / 4.0), (0.0, 0.0, 1.0)),
        rotation=(np.pi, 0.0, 0.0),
    ),
)
BENT = {
    "all": SMALL,
    "camera": replace(SMALL, tank=Tank((120.0, 80.0, 60.0))),
    "glass": replace(PLAIN, tank=Tank((120.0, 80.0, 60.0), entry="glass", wall_mm=6.0)),
    "rising": replace(  # light that the surface sends back
        SMALL, projector=Projector("pinhole", (Beam((-12.0, 3.0), (40.0, 52.0), 1.3),), (-70.0, 4.0, 10.0))
    ),
}


def relative(error: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(error) / np.linalg.norm(truth))


# --- against the Monte Carlo, and against the plain scene ------------------------------------------------------------


@pytest.mark.parametrize("case", BENT)
def test_order_1_of_bent_light_is_the_monte_carlos(case: str) -> None:
    truth = first_order(BENT[case])
    image = single_scattering(BENT[case])
    assert relative(image - truth, truth) < 4e-3  # on pixels of 3–4 mm, whose edges the quadratures cut differently
    assert image.sum() == pytest.approx(truth.sum(), rel=5e-4)


@pytest.mark.parametrize("case", ["all", "glass"])
def test_the_tank_model_of_bent_light_agrees_with_the_monte_carlo(case: str) -> None:
    truth = simulate(BENT[case], 60_000)
    prediction = predict(BENT[case], tolerance=0.03)
    noise = float(np.hypot(truth.noise, 0.03))
    assert relative(prediction.image - truth.image, truth.image) < noise
    second = truth.orders[2]
    assert relative(prediction.orders[2] - second, truth.image) < truth.noise
    assert prediction.orders[2].sum() == pytest.approx(second.sum(), rel=0.02)


def test_a_plain_scene_in_a_calibrated_cameras_words_is_the_plain_scene() -> None:
    assert SAME.camera.pixel_mm == pytest.approx(4.0)
    assert (
        np.abs(
            footprints(SAME.camera, SAME.tank).corners_mm[::-1] - footprints(PLAIN.camera, PLAIN.tank).corners_mm
        ).max()
        < 1e-9
    )
    for model, bound in ((single_scattering, 1e-7), (double_scattering, 2e-3), (first_order, 1e-9)):
        plain = model(PLAIN)
        assert relative(model(SAME)[::-1] - plain, plain) < bound
    plain = simulate(PLAIN, 3_000).image
    assert relative(simulate(SAME, 3_000).image[::-1] - plain, plain) < 1e-9


def test_a_matched_wall_of_any_thickness_bends_nothing() -> None:
    glass = replace(PLAIN, tank=replace(PLAIN.tank, entry="glass", wall_mm=20.0, wall_index=1.0, refractive_index=1.0))
    plain = single_scattering(PLAIN)
    assert relative(single_scattering(glass) - plain, plain) < 3e-4  # beams' sides are cut in stretches
    assert relative(first_order(glass) - first_order(PLAIN), first_order(PLAIN)) < 1e-6


def test_light_between_many_heights_has_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    cut = np.linspace(30.0, 40.0, 6)
    beams = tuple(Beam((-12.0, 3.0), (low, high)) for low, high in pairwise(cut))
    scene = replace(
        PLAIN, projector=Projector("pinhole", (*beams, Beam((20.0, 24.0), (10.0, 14.0))), (-250.0, 4.0, 20.0))
    )
    shared = double_scattering(scene, 0.01)
    monkeypatch.setattr(lit_parts, "MOST_HEIGHTS", 100)
    each = double_scattering(scene, 0.01)
    assert relative(shared - each, each) < 3e-3


def test_what_the_surface_shows_is_looked_up_without_loss() -> None:
    scene = scenes.bench(MEDIUM)  # whose camera sees all of the tank
    plain = on_surface(scene)
    pixel = plain.camera.pixel_mm
    edges = np.minimum(np.arange(plain.camera.shape[1] + 1) * pixel, 240.0)  # the last cells may lie over it in part
    x, y = 0.5 * (edges[1:] + edges[:-1]), (np.arange(plain.camera.shape[0]) + 0.5) * pixel
    even = np.broadcast_to(np.diff(edges) / pixel, plain.camera.shape)
    slope = even * (1.0 + 0.3 * x[None, :] / 240.0 + 0.2 * (y[:, None] - 80.0) / 80.0)
    seen = footprints(scene.camera, scene.tank)
    expected = 1.0 + 0.3 * seen.centres_mm[..., 0] / 240.0 + 0.2 * seen.centres_mm[..., 1] / 80.0
    corners = seen.corners_mm
    inside = (corners[..., 0] > 0) & (corners[..., 0] < 240) & (np.abs(corners[..., 1]) < 80)
    whole = inside[1:, 1:] & inside[1:, :-1] & inside[:-1, 1:] & inside[:-1, :-1]
    image = to_camera(scene, slope, (pixel, pixel))
    assert np.abs(image - expected)[whole].max() < 2e-3
    assert (image[np.maximum(corners[1:, 1:, 0], corners[:-1, 1:, 0]) < 0.0] == 0.0).all()
    assert np.nansum(to_camera(scene, even, (pixel, pixel)) * seen.areas_mm2) == pytest.approx(38400.0, rel=2e-3)


def test_outlines_hold_the_light_scattered_once() -> None:
    for scene in (SMALL, SAME):
        clear = replace(scene, medium=Medium(0.0, 1e-4, 0.0))
        image, camera = single_scattering(clear), scene.camera
        mask = np.zeros(camera.shape, np.uint8)
        for outline in beam_outlines(scene):
            corners = (outline + np.array([0.0, scene.tank.size_mm[1] / 2])) / camera.pixel_mm - 0.5
            cv2.fillConvexPoly(mask, np.round(corners).astype(np.int32), 1)
        near = cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0
        assert image[near].sum() > 0.9 * image.sum()
        assert near.mean() < 0.6


def test_edges_of_light_are_where_wider_beams_would_be_seen() -> None:
    """Blur changes the picture there and nowhere else; a fit that leaves those pixels out does not see it."""
    clear = replace(scenes.bench(MEDIUM), medium=Medium(0.0, 1e-4, 0.0))
    wider = [replace(one, y_mm=(one.y_mm[0] - 0.3, one.y_mm[1] + 0.3)) for one in clear.projector.beams]
    blurred = replace(clear, projector=replace(clear.projector, beams=tuple(wider)))
    change = np.abs(single_scattering(blurred) - single_scattering(clear))
    edges = edges_of_light(clear)
    assert change[edges].sum() > 0.97 * change.sum()
    assert edges.mean() < 0.25


@pytest.mark.parametrize("model", ["convolution", "diffuse"])
def test_models_that_know_no_glass_say_so(model: str) -> None:
    with pytest.raises(tankrig.SceneError, match='use model = "tank"'):
        predict(SMALL, model=model)


def test_the_diffuse_limit_takes_a_calibrated_camera() -> None:
    dense = replace(PLAIN, medium=Medium(0.001, 0.2, 0.0))
    plain = predict(dense, model="diffuse").image
    same = predict(replace(SAME, medium=dense.medium), model="diffuse").image
    assert relative(same[::-1] - plain, plain) < 0.02  # a plain camera's pixels show their middles


# --- pictures on a projector -----------------------------------------------------------------------------------------

PROJECTOR = Projector(
    "calibrated",
    (Beam((-1.0, 1.0), (1.0, 2.0)),),
    (-250.0, 14.0, 40.0),
    ((240.0, 0.0, 63.5), (0.0, 241.0, 47.5), (0.0, 0.0, 1.0)),
    (0.05, -0.01),
    (1.2120, -1.2575, 1.1896),
    (96, 128),
    pixel_power=0.25,
    gamma=2.0,
)
BEHIND_GLASS = replace(SMALL, projector=PROJECTOR)


@pytest.fixture
def picture() -> np.ndarray:
    """Uneven, with a smooth part, wholly within the wall."""
    picture = np.zeros((96, 128), np.uint8)
    picture[40:60, 40:50] = 255
    picture[45:50, 60:80] = np.linspace(100, 200, 20).astype(np.uint8)
    return picture


def test_a_picture_brings_its_light_to_the_wall_where_its_pixels_aim(picture: np.ndarray) -> None:
    tank, projector = BEHIND_GLASS.tank, PROJECTOR
    v, u = np.nonzero(picture)
    window = entry_wall(*tank.entry_bends)
    pixels = np.stack([u, v], axis=-1)
    _, air = rays_of(projector.lens, projector.pose, pixels)
    power = 0.25 * (picture[v, u] / 255.0) ** 2 * transmitted(window, air)
    aims, _ = rays_of(projector.lens, projector.pose, pixels, window)
    assert np.abs(pixels_of(projector.lens, projector.pose, aims, window) - pixels).max() < 1e-9
    beams = lit_by(BEHIND_GLASS, picture).projector.beams
    lit = np.array([beam.power for beam in beams])
    assert lit.sum() == pytest.approx(power.sum(), rel=1e-9)
    centres = np.array([[sum(beam.y_mm) / 2, sum(beam.z_mm) / 2] for beam in beams])
    assert np.abs(lit @ centres / lit.sum() - power @ aims[:, 1:] / power.sum()).max() < 0.02
    assert len(beams) < 100


def light_and_moments(cells: np.ndarray) -> np.ndarray:
    """Light, and its middle along y and z, mm, of cells of the wall of BEHIND_GLASS."""
    rows, columns = cells.shape
    z, y = (np.arange(rows) + 0.5) * 60.0 / rows, (np.arange(columns) + 0.5) * 80.0 / columns - 40.0
    light = cells.sum()
    area = 60.0 * 80.0 / cells.size
    return np.array([light * area, cells.sum(axis=0) @ y / light, cells.sum(axis=1) @ z / light])


def test_beams_are_the_pictures_light_and_nothing_else(picture: np.ndarray) -> None:
    cells = irradiance_on_wall(BEHIND_GLASS.tank, PROJECTOR, picture)
    rows, columns = cells.shape
    z, y = np.arange(rows + 1) * 60.0 / rows, np.arange(columns + 1) * 80.0 / columns - 40.0
    drawn = np.zeros_like(cells)
    for beam in lit_by(BEHIND_GLASS, picture).projector.beams:
        height, width = np.diff(np.clip(z, *beam.z_mm)), np.diff(np.clip(y, *beam.y_mm))
        drawn += height[:, None] * width * beam.irradiance * cells.size / (60.0 * 80.0)
    dark = cv2.dilate(cells, np.ones((5, 5))) == 0.0
    assert (drawn[dark] == 0.0).all()
    brightest = cells.sum(axis=0).max()
    along_y = np.abs(np.cumsum((cells - drawn).sum(axis=0))).max() * 80.0 / columns
    assert along_y < 0.05 * brightest  # mm that light is moved, as it is seen from above
    assert np.abs(np.cumsum((cells - drawn).sum(axis=1))).max() * 60.0 / rows < 0.3 * cells.sum(axis=1).max()


@settings(max_examples=25, deadline=None)
@given(
    st.floats(-2.0, 2.0),
    st.lists(st.tuples(st.integers(0, 80), st.integers(0, 110), st.integers(2, 15), st.integers(2, 17),
                       st.integers(60, 255)), min_size=1, max_size=4),
)  # fmt: skip
def test_whatever_the_picture_beams_keep_its_light_and_where_that_is(
    roll_degrees: float, parts: list[tuple[int, int, int, int, int]]
) -> None:
    """Light that merging loses or moves, gain and coefficients take up."""
    picture = np.zeros((96, 128), np.uint8)
    for row, column, height, width, level in parts:
        picture[row : row + height, column : column + width] = level
    projector = rolled(roll_degrees)
    cells = irradiance_on_wall(BEHIND_GLASS.tank, projector, picture)
    assume(cells.any())
    beams = lit_by(replace(BEHIND_GLASS, projector=projector), picture).projector.beams
    light = np.array([beam.power for beam in beams])
    middles = np.array([(sum(beam.y_mm) / 2, sum(beam.z_mm) / 2) for beam in beams])
    found = np.array([light.sum(), *(light @ middles / light.sum())])
    assert found == pytest.approx(light_and_moments(cells), rel=1e-9, abs=1e-9)


def rolled(degrees: float) -> Projector:
    turn = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(degrees)]))[0] @ cv2.Rodrigues(np.array(PROJECTOR.rotation))[0]
    return replace(PROJECTOR, rotation=tuple(cv2.Rodrigues(turn)[0].ravel().tolist()))


@pytest.mark.parametrize("roll_degrees", [-0.8, 0.0, 1.2, 2.0, 3.1])  # from −2 to 2, as it is rolled by −1.2 itself
def test_rays_of_a_rolled_projector_stay_a_beam_each(roll_degrees: float) -> None:
    """Slivers at the edges of what is rolled by a degree made 27 beams of three rays, and a minute of each dose."""
    picture = np.zeros((96, 128), np.uint8)
    for column in (36, 62, 90):
        picture[44:48, column : column + 4] = 255
    beams = lit_by(replace(BEHIND_GLASS, projector=rolled(roll_degrees)), picture).projector.beams
    assert len(beams) <= 6
    assert len(beams) >= 3


def test_a_bench_makes_scenes_of_patterns_as_calibrated(picture: np.ndarray) -> None:
    wall = Wall((96, 128), (-40.0, 40.0), (0.0, 60.0))
    bench = Bench(SMALL.tank, wall, "calibrated", SMALL.camera, projector=replace(PROJECTOR, beams=()))
    scene = bench.scene(Pattern("spots", picture), MEDIUM)
    assert scene.projector.beams == lit_by(BEHIND_GLASS, picture).projector.beams
    assert scene.camera == SMALL.camera
    assert scene.camera.binned(2).shape == (15, 23)
    with pytest.raises(tankrig.SceneError, match="projector is missing"):
        Bench(SMALL.tank, wall, "calibrated", SMALL.camera)


def test_binned_pixels_look_where_theirs_do() -> None:
    whole, binned = (footprints(camera, SMALL.tank).corners_mm for camera in (SMALL.camera, SMALL.camera.binned(2)))
    assert np.abs(whole[::2, ::2] - binned).max() < 1e-9


def test_a_picture_that_misses_the_tank_or_the_projector_is_refused(picture: np.ndarray) -> None:
    turned = replace(BEHIND_GLASS, projector=replace(PROJECTOR, rotation=(0.0, 0.0, 0.0)))
    with pytest.raises(tankrig.SceneError, match="nothing of the picture reaches the tank"):
        lit_by(turned, picture)
    with pytest.raises(tankrig.SceneError, match=r"shape \[128, 96\] and the projector \[96, 128\]"):
        lit_by(BEHIND_GLASS, picture.T)
    with pytest.raises(tankrig.SceneError, match="needs a calibrated projector"):
        lit_by(SMALL, picture)


# --- files -----------------------------------------------------------------------------------------------------------


def test_the_example_of_a_bench_loads_and_is_predicted() -> None:
    scene = tankrig.load_scene(EXAMPLE)
    assert scene.camera.pixel_mm == pytest.approx(2.14, abs=0.01)
    assert 3 <= len(scene.projector.beams) < 40
    image = predict(scene, model="single").image
    assert image.shape == (90, 130)
    assert image.max() > 0.0


WRONG = [
    ('image = "three_beams.png"', 'image = "none.png"', 'none.png" cannot be read (No such file or directory); give'),
    ("shape = [192, 256]", "shape = [96, 128]", "the picture has shape [192, 256] and the projector [96, 128]"),
    ("pixel_power = 1.0 ", "beams = []\npixel_power = 1.0 ", "both an image and beams"),
    ("[-420.0, 12.0, 75.0]", "[-4.0, 12.0, 75.0]", "is inside the wall, which is 8 mm thick"),
    ("[3.0737, 0.0452, -0.028]", "[0.0, 0.0, 0.0]", "no pixel of the camera looks into the tank"),
    ("[130.0, -40.0, 640.0]", "[130.0, -40.0, 64.0]", "is not above the water"),
    ("[[245.0, 0.0, 64.0]", "[[245.0, 1.0, 64.0]", "is no camera matrix"),
    ("[0.04, -0.02]", "[0.04, -0.02, 0, 0, 0, 1]", "6 coefficients"),
    ('entry = "glass"', 'entry = "glas"', 'tank.entry = "glas" is unknown; use "matched" or "glass"'),
    ("wall_mm = 8.0", "wall_mm = -8.0", "tank.wall_mm = -8.0 is negative"),
    ("gamma = 2.2", "gamma = 0.0", "gamma = 0.0 is not positive"),
    ("gamma = 2.2", "gama = 2.2", 'key "projector.gama" is unknown; did you mean "gamma"?'),
]


@pytest.mark.parametrize(("before", "after", "said"), WRONG, ids=[said[:40] for _, _, said in WRONG])
def test_a_wrong_calibrated_scene_is_refused_in_a_sentence(tmp_path: Path, before: str, after: str, said: str) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    assert before in text
    (tmp_path / "scene.toml").write_text(text.replace(before, after, 1), encoding="utf-8")
    (tmp_path / "three_beams.png").write_bytes((EXAMPLE.parent / "three_beams.png").read_bytes())
    with pytest.raises(tankrig.SceneError) as caught:
        tankrig.load_scene(tmp_path / "scene.toml")
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path))


# --- at full size ----------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("case", ["bench", "sheet", "small"])
def test_bent_scenes_are_predicted_within_one_per_cent(case: str) -> None:
    medium = {"bench": Medium(0.0002, 0.0198, 0.5), "sheet": Medium(0.0008, 0.0072, 0.85), "small": MEDIUM}[case]
    scene = getattr(scenes, case)(medium)
    truth = simulate(scene, 4_000_000)
    error = relative(predict(scene, tolerance=0.01).image - truth.image, truth.image)
    assert np.sqrt(max(0.0, error**2 - truth.noise**2)) < 0.01


@pytest.mark.long
def test_a_bent_scene_is_prepared_and_its_medium_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    live = tankrig.prepare(SMALL, 0.05, box=Box((0.015, 0.025), (0.9, 0.98), (0.5, 0.7)))
    truth = simulate(SMALL, 300_000)
    assert relative(live.predict(MEDIUM) - truth.image, truth.image) < float(np.hypot(0.05, truth.noise))
    found = tankrig.estimate(truth.image, SMALL, gain=1.0, offset=0.0, noise=0.01 * float(truth.image.max()))
    assert found.medium.sigma_s == pytest.approx(MEDIUM.sigma_s, rel=0.05)
    assert found.medium.g == pytest.approx(MEDIUM.g, abs=0.05)


@settings(max_examples=40, deadline=None)
@given(st.floats(30.0, 60.0), st.floats(40.0, 80.0))
def test_a_picture_that_lights_all_of_a_wall_of_any_size_makes_a_scene(height: float, width: float) -> None:
    """A level of 107.72305640647748 mm ended runs: the wall's cells added up to an ulp more."""
    tank = replace(BEHIND_GLASS.tank, size_mm=(BEHIND_GLASS.tank.size_mm[0], width, height))
    lit = lit_by(replace(BEHIND_GLASS, tank=tank), np.full((96, 128), 255, np.uint8))
    assert max(beam.z_mm[1] for beam in lit.projector.beams) <= height
