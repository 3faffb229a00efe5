"""What walls and floor do to light besides swallowing it: mirrors, panes and diffuse floors."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.errors import SceneError
from tankrig.estimation.astray_patterns import floor, floor_by_few
from tankrig.light import high_orders
from tankrig.light.behind_lenses import more_by_faces
from tankrig.light.order_one import once, once_of
from tankrig.light.paths.record import seen_from
from tankrig.light.rays import geometry_of
from tankrig.light.tank import paths_by_faces
from tankrig.light.walls.faces import FAR, face_table, sent_back, steepest_sights
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import Blur, Face, Faces
from tankrig.scene.phase_functions import TwoTerm
from tests.optics_scenes import MEDIUM, a_scene, apart

MIRROR = Face("clear", 1.0)


@cache  # tests of several kinds of light look at the same ones
def predicted(scene, tolerance):
    return tankrig.predict(scene, tolerance=tolerance).image


def half_and_whole(camera):
    """A tank with a perfect mirror at its left wall, and the tank of twice the width that it looks like."""
    whole = Scene(
        Tank((240.0, 160.0, 120.0), "fresnel"),
        MEDIUM,
        Projector("collimated", (Beam((16.0, 40.0), (40.0, 80.0)), Beam((-40.0, -16.0), (40.0, 80.0)))),
        camera((20, 30), 0.0),
    )
    # The half's own frame has y = 0 in its middle, 40 mm from the mirror.
    half = Scene(
        Tank((240.0, 80.0, 120.0), "fresnel", faces=Faces(left=MIRROR)),
        MEDIUM,
        Projector("collimated", (Beam((-24.0, 0.0), (40.0, 80.0)),)),
        camera((10, 30), -40.0),
    )
    return half, whole


def orthographic(shape, _):
    return Camera("orthographic", shape, 8.0)


def pinhole(shape, moved_mm):
    return Camera("pinhole", shape, 8.0, (120.0, 30.0 + moved_mm, 500.0))


@pytest.mark.parametrize(
    "camera",
    [orthographic, pytest.param(pinhole, marks=pytest.mark.long)],  # pinholes of both kinds see such a wall below
)
@pytest.mark.parametrize("model", ["tank", "montecarlo"])
def test_a_perfect_mirror_shows_the_other_half_of_a_tank(camera, model):
    """All that paths, mirrored beams and mirrored sight do must be right for this."""
    half, whole = half_and_whole(camera)
    tolerance = 0.011 if model == "tank" else 0.01
    seen = tankrig.predict(half, model, tolerance=tolerance)
    truth = predicted(whole, 0.006)[10:]
    assert apart(seen.image, truth) < 0.02
    assert seen.image.sum() == pytest.approx(truth.sum(), rel=0.006)


@pytest.mark.parametrize("model", ["tank", "montecarlo"])
def test_a_mirror_for_a_floor_makes_a_tank_twice_as_deep(model):
    beam = Beam((-20.0, 20.0), (20.0, 40.0))
    light = Projector("collimated", (beam,))
    shallow = a_scene(light=light, size_mm=(240.0, 160.0, 60.0), faces=Faces(floor=MIRROR))
    both = (replace(beam, z_mm=(80.0, 100.0)), replace(beam, z_mm=(20.0, 40.0)))
    deep = a_scene(light=Projector("collimated", both), size_mm=(240.0, 160.0, 120.0))
    seen, truth = tankrig.predict(shallow, model, tolerance=0.006), predicted(deep, 0.004)
    assert apart(seen.image, truth) < 0.02
    assert seen.image.sum() == pytest.approx(truth.sum(), rel=0.006)


def spread(beam, place, camera_mm, shape=(10, 30), **tank):
    """A scene of a pinhole's light, whose projector and beam are given as (y, z)."""
    (y_mm, z_mm), (y, z) = beam, place
    light = Projector("pinhole", (Beam(y_mm, z_mm),), (-150.0, y, z))
    return Scene(Tank(**tank), MEDIUM, light, Camera("pinhole", shape, 8.0, camera_mm))


WHOLE = (20, 30)
MIRRORED = {
    "left": (
        spread(((-36.0, -16.0), (20.0, 40.0)), (0.0, 40.0), (120.0, -10.0, 500.0), size_mm=(240.0, 80.0, 60.0)),
        [
            spread(((4.0, 24.0), (20.0, 40.0)), (40.0, 40.0), (120.0, 30.0, 500.0), WHOLE, size_mm=(240, 160, 60)),
            spread(((-24.0, -4.0), (20.0, 40.0)), (-40.0, 40.0), (120.0, 30.0, 500.0), WHOLE, size_mm=(240, 160, 60)),
        ],
    ),
    "floor": (
        spread(((-24.0, 0.0), (10.0, 30.0)), (0.0, 70.0), (120.0, -10.0, 500.0), size_mm=(240.0, 80.0, 60.0)),
        [
            spread(((-24.0, 0.0), (70.0, 90.0)), (0.0, 130.0), (120.0, -10.0, 560.0), size_mm=(240, 80, 120)),
            spread(((-24.0, 0.0), (30.0, 50.0)), (0.0, -10.0), (120.0, -10.0, 560.0), size_mm=(240, 80, 120)),
        ],
    ),
}  # fmt: skip
"""A tank with a mirror that the light spreads to; and the tank of twice the size that it looks like, lit by the
projector and by its mirror image."""


@pytest.mark.parametrize("model", ["tank", "montecarlo"])
@pytest.mark.parametrize("face", list(MIRRORED))
def test_beams_that_spread_to_a_mirror_go_on_as_sharp_as_they_were(face, model):
    """Parallel light does not show it: order 1 of such beams was missing, up to a third of an image, where .4 % was
    stated."""
    half, halves = MIRRORED[face]
    half = replace(half, tank=replace(half.tank, faces=Faces(**{face: MIRROR})))
    truth = sum(predicted(whole, 0.006)[-10:] for whole in halves)
    seen = tankrig.predict(half, model, tolerance=0.008)
    assert apart(seen.image, truth) < 0.02
    assert seen.image.sum() == pytest.approx(truth.sum(), rel=0.006)


@pytest.mark.parametrize("model", ["tank", "montecarlo"])
def test_a_beam_that_comes_back_from_a_thick_pane_has_gone_on_in_it(model):
    """On benches of glass it came back a pane's 1.1 mm beside where photographs had it, by 1 % of the peak; tests had
    light that was parallel, in the middle, or without a pane. By hand: what turns at the pane's outer side comes out
    2 d tan θ_glass farther along, and has been in water as far as what turns at the inner one."""
    thick, water, glass, slope, sigma_t = 30.0, 1.33, 1.52, 0.05, 0.01
    light = Projector("pinhole", (Beam((18.0, 22.0), (58.0, 62.0)),), (-400.0, 0.0, 60.0))
    faces = Faces(far=Face("glass", thickness_mm=thick))
    scene = a_scene(
        Camera("orthographic", (160, 12), 20.0), light, surface="fresnel", refractive_index=water, faces=faces
    )
    camera = replace(scene.camera, shape=(160, 240), pixel_mm=1.0)
    scene = replace(scene, camera=camera, medium=Medium(0.0, sigma_t, 0.0))
    image = tankrig.predict(scene, model, tolerance=0.005, max_order=1, seed=4).image
    x, y = 80.5, np.arange(160) - 79.5
    column = image[:, 76:85].mean(axis=1)
    there, back = np.where(y < 30.0, column, 0.0), np.where(y > 32.0, column, 0.0)
    inner, outer = ((glass - water) / (glass + water)) ** 2, ((glass - 1.0) / (glass + 1.0)) ** 2
    share = inner + (1.0 - inner) ** 2 * outer / (1.0 - inner * outer)
    in_glass = water / glass * slope / math.sqrt(1.0 + slope**2)
    moved = (1.0 - inner / share) * 2.0 * thick * in_glass / math.sqrt(1.0 - in_glass**2)
    assert (y @ there) / there.sum() == pytest.approx(20.0 + slope * x, abs=0.05)
    assert (y @ back) / back.sum() == pytest.approx(20.0 + slope * (480.0 - x) + moved, abs=0.3)
    kept = share * math.exp(-2.0 * sigma_t * (240.0 - x) * math.sqrt(1.0 + slope**2))
    few = 0.06 if model == "tank" else 0.4  # of the Monte Carlo's paths come there
    assert back.sum() / there.sum() == pytest.approx(kept, rel=few)


@pytest.mark.parametrize(
    "faces",
    [
        pytest.param(Faces(entry=Face("glass", thickness_mm=6.0)), marks=pytest.mark.long),
        pytest.param(Faces(far=Face("glass")), marks=pytest.mark.long),
        Faces(left=Face("glass", thickness_mm=4.0), right=Face("glass", thickness_mm=4.0)),
        Faces(floor=Face("diffuse", 0.3)),
        pytest.param(
            Faces(*[Face("glass", thickness_mm=5.0)] * 4, floor=Face("diffuse", 0.04)), marks=pytest.mark.long
        ),
    ],
)
def test_tank_and_monte_carlo_agree_on_walls(faces, monkeypatch):
    """Two programs that share the scene only; the light that walls add is far more than they may differ by."""
    monkeypatch.setattr(high_orders, "FIRST_SMOOTHED", 4)  # twice as many paths would err by half of the bound
    camera = Camera("pinhole", (10, 15), 16.0, (110.0, 5.0, 520.0))
    light = Projector("pinhole", (Beam((-20.0, 24.0), (40.0, 80.0)),), (-400.0, 10.0, 60.0))
    scene = a_scene(camera, light, surface="fresnel", faces=faces)
    tank = tankrig.predict(scene, tolerance=0.022)
    paths = tankrig.predict(scene, "montecarlo", tolerance=0.007, seed=3)
    assert tank.image.sum() == pytest.approx(paths.image.sum(), rel=0.006)
    assert apart(tank.image, paths.image) < 0.03
    black = predicted(replace(scene, tank=replace(scene.tank, faces=Faces())), 0.02)
    assert tank.image.sum() > 1.002 * black.sum()


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)  # the first call compiles
@given(cosine=st.floats(0.0, 1.0), glass=st.floats(1.33, 1.9), water=st.floats(1.3, 1.36))
def test_a_pane_sends_everything_back_beyond_the_waters_critical_angle(cosine, glass, water):
    faces = face_table(Tank(refractive_index=water, faces=Faces(far=Face("glass", index=glass))))
    share, along_mm, at_once = sent_back(faces, FAR, cosine)
    assert 0.0 <= share <= 1.0 + 1e-12
    assert along_mm == 0.0, "a pane without thickness moves nothing"
    assert 0.0 <= at_once <= 1.0
    if math.sqrt(1.0 - cosine**2) > 1.001 / water:
        assert share == pytest.approx(1.0, abs=1e-9)


@given(
    st.tuples(*[st.floats(-300.0, 600.0), st.floats(-300.0, 300.0), st.floats(60.0, 2000.0)]),
    # Of a point in the surface itself, 10⁻¹⁴ mm from a wall, rounding decides.
    st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 0.999999)),
    st.sampled_from([1.0, 1.33, 1.5]),
    st.integers(0, 3),
)
@settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
def test_what_is_out_of_a_walls_reach_is_not_seen_mirrored_in_it(above_tank, inside, index, wall):
    (x, y, above), (u, v, w) = above_tank, inside
    surface = "matched" if index == 1.0 else "fresnel"
    scene = a_scene(Camera("pinhole", (20, 30), 8.0, (x, y, 120.0 + above)), surface=surface, refractive_index=index)
    geometry = geometry_of(scene)
    px, py, pz = u * geometry.length, (2.0 * v - 1.0) * geometry.half_width, w * geometry.height
    away = (px, geometry.length - px, geometry.half_width + py, geometry.half_width - py)[wall]
    mirrored = [(-px, py), (2 * geometry.length - px, py), (px, -2 * geometry.half_width - py),
                (px, 2 * geometry.half_width - py)][wall]  # fmt: skip
    seen_x, seen_y, *_ = seen_from(geometry, *mirrored, pz, index)
    within = 0.0 <= seen_x <= geometry.length and abs(seen_y) <= geometry.half_width
    assert not within or away <= (geometry.height - pz) * steepest_sights(geometry)[wall]


def test_liquids_at_once_are_seen_by_way_of_walls_as_one_by_one():
    pane = Face("glass", thickness_mm=6.0)
    camera = Camera("pinhole", (5, 8), 32.0, (120.0, 0.0, 620.0))
    light = Projector("pinhole", (Beam((-70.0, -50.0), (40.0, 44.0)),), (-400.0, 0.0, 60.0), blur=Blur(1.0))
    scene = a_scene(camera, light, surface="fresnel", faces=Faces(pane, pane, pane, pane, Face("clear", 0.3)))
    media = [Medium(0.001, 0.01, 0.6), Medium(0.0, 0.02, 0.2), Medium(0.0, 0.0, 0.0)]
    for image, medium in zip(once_of(scene, media), media, strict=True):
        np.testing.assert_allclose(image, once(replace(scene, medium=medium)), rtol=1e-12, atol=1e-20)


@pytest.mark.parametrize("model", ["convolution", "diffuse"])
def test_models_that_know_no_walls_say_so(model):
    with pytest.raises(SceneError, match="tank"):
        tankrig.predict(a_scene(faces=Faces(floor=Face("diffuse", 0.04))), model)


def test_orders_by_way_of_a_diffuse_floor_are_the_monte_carlos():
    """Its own glow was counted as order 2, and with a highest order, light of that order that then met it was lost."""
    light = Projector("pinhole", (Beam((-20.0, 24.0), (40.0, 80.0)),), (-300.0, 0.0, 70.0))
    scene = a_scene(
        Camera("pinhole", (20, 30), 8.0, (120.0, 0.0, 620.0), blur=Blur(1.0)), light,
        surface="fresnel", refractive_index=1.33, faces=Faces(floor=Face("diffuse", 0.3)),
    )  # fmt: skip
    tank = tankrig.predict(scene, tolerance=0.03)  # of the orders above, whose paths take most of the time
    monte_carlo = tankrig.predict(scene, "montecarlo", tolerance=0.01)
    dark = tankrig.predict(replace(scene, tank=replace(scene.tank, faces=Faces())), max_order=2, tolerance=0.01)
    for order in (1, 2):
        expected = monte_carlo.orders[order].sum()
        assert tank.orders[order].sum() == pytest.approx(expected, rel=0.004)
        assert dark.orders[order].sum() < 0.99 * expected
        once = tankrig.predict(scene, max_order=order, tolerance=0.01).image.sum()
        assert once == pytest.approx(sum(tank.orders[one].sum() for one in range(1, order + 1)), rel=0.004)
    cut = tankrig.predict(scene, "montecarlo", tolerance=0.01, max_order=2, seed=7)
    assert cut.orders[2].sum() == pytest.approx(monte_carlo.orders[2].sum(), rel=0.008)  # it was 1.8 % less


def between_glass_walls(medium):
    """Three rays into a tank of glass, as on a bench."""
    glass = Face("glass")
    light = Projector("pinhole", tuple(Beam((y - 2.0, y + 2.0), (53.0, 57.0)) for y in (-40.0, 0.0, 40.0)),
                      (-400.0, 0.0, 50.0))  # fmt: skip
    faces = Faces(entry=glass, far=glass, left=glass, right=glass)
    scene = a_scene(
        Camera("pinhole", (40, 60), 4.0, (120.0, 0.0, 620.0)), light,
        surface="fresnel", refractive_index=1.33, entry="glass", wall_mm=6.0, faces=faces,
    )  # fmt: skip
    return replace(scene, medium=medium)


def test_what_a_floor_adds_between_glass_walls_has_not_their_noise():
    """A bench between glass walls would have too much ink: its floor was 18 % off where it is looked for, by the noise
    of what the glass shows, so that fits found 10 % less floor than there was and σs .9 % too large on average."""
    scene = between_glass_walls(Medium(8e-5, 0.0019, 0.77))
    faces = scene.tank.faces
    lit = replace(scene, tank=replace(scene.tank, faces=replace(faces, floor=Face("diffuse", 0.05))))
    many = paths_by_faces(lit, 3, 64)[0] - paths_by_faces(scene, 3, 64)[0]
    more = 0.05 * floor(scene, np.zeros(scene.camera.shape))
    assert more.sum() == pytest.approx(many.sum(), rel=0.01)
    assert np.linalg.norm(more - many) < 0.08 * np.linalg.norm(many)  # .055, and .14 by differences of so few
    # Over blocks of 40 mm, which no fit averages away, eight lattices leave three times as much noise.
    truth, few = (
        blocks(more_by_faces(scene, lit.tank.faces, faces, seed, lattices)[0]) for seed, lattices in ((4, 128), (7, 8))
    )
    off, by_few = (np.linalg.norm(one / truth - 1.0) for one in (blocks(more), few))
    assert off < 0.6 * by_few


def test_what_a_floor_adds_is_known_as_well_of_a_liquid_nearby():
    """A bench's fit of an emulsion comes to a liquid like the last one again and again: two minutes by many light paths
    each time, and by few their noise would pass for ink."""
    first = between_glass_walls(Medium(6e-5, 0.0019, phase=TwoTerm(0.9, -0.3, 0.92)))
    scene = replace(first, medium=Medium(6e-5, 0.00192, phase=TwoTerm(0.905, -0.28, 0.915)))
    dark = np.zeros(scene.camera.shape)
    by_more, again = (floor(one, dark) - floor_by_few(one, dark) for one in (first, scene))
    np.testing.assert_allclose(again, by_more, atol=1e-9 * np.abs(by_more).max())
    lit = replace(scene.tank.faces, floor=Face("diffuse", 0.05))
    truth, few = (
        blocks(more_by_faces(scene, lit, scene.tank.faces, seed, lattices)[0]) for seed, lattices in ((4, 128), (7, 8))
    )
    off, by_few = (np.linalg.norm(one / truth - 1.0) for one in (blocks(0.05 * floor(scene, dark)), few))
    assert off < 0.6 * by_few


def blocks(image):
    """Means over ten by ten pixels."""
    rows, columns = image.shape
    return image.reshape(rows // 10, 10, columns // 10, 10).mean(axis=(1, 3))
