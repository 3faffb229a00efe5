"""What lenses do to light besides being ideal: blur, halo, veil, the light of a black picture, a wide lens."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.light import order_one
from tankrig.light.double import double_scattering
from tankrig.light.entering import entering, through_lens
from tankrig.light.leaving import CameraLens
from tankrig.light.order_one import once, once_seen
from tankrig.scene import Beam, Camera, Medium, Projector
from tankrig.scene.optics import Blur, Face, Faces, Halo, WideLens
from tests.optics_scenes import a_calibrated_scene, a_scene, apart


def test_dark_faces_and_ideal_lenses_change_nothing():
    scene = a_scene()
    idle = replace(
        scene,
        tank=replace(scene.tank, faces=Faces(floor=Face("diffuse", 0.0), far=Face("black", 0.5))),
        camera=replace(scene.camera, halo=Halo(0.0, 10.0)),
        projector=replace(scene.projector, wide_lens=WideLens(10.0, 50.0)),  # of a collimated projector, no matter
    )
    assert np.array_equal(tankrig.predict(scene).image, tankrig.predict(idle).image)


@given(share=st.floats(0.0, 0.2), sigma_mm=st.floats(2.0, 60.0), veil=st.floats(0.0, 0.3))
@settings(max_examples=20, deadline=None)
def test_a_cameras_lens_makes_no_light(share, sigma_mm, veil):
    camera = Camera("orthographic", (20, 30), 8.0, blur=Blur(1.5), halo=Halo(share, sigma_mm), veil=veil)
    lens = CameraLens.of(a_scene(camera))
    wide = np.zeros(lens.wide.camera.shape)
    wide[10, 15] = 1.0
    seen = lens.of_wide(wide)
    assert seen.sum() <= 1.0 + 1e-9
    assert (seen >= 0.0).all()
    assert seen.sum() >= 1.0 - share - 1e-6  # all that is lost is lost from the halo, beyond the picture


@pytest.mark.parametrize("pixel_mm", [2.0, 8.0])
def test_blur_acts_on_light_and_not_on_pixels(pixel_mm):
    """A beam's edge within a pixel, blurred: what the mean over many fine pixels shows."""
    count = round(160 / pixel_mm), round(240 / pixel_mm)
    light = Projector("collimated", (Beam((-21.3, 22.9), (40.0, 80.0)),))
    coarse = a_scene(Camera("orthographic", count, pixel_mm, blur=Blur(1.0)), light)
    fine = a_scene(Camera("orthographic", (320, 30), 0.5), light)
    fine = replace(fine, camera=replace(fine.camera, shape=(320, 480)))
    sharp = tankrig.predict(fine, "single").image
    kernel = np.exp(-0.5 * (np.arange(-10, 11) * 0.5) ** 2)
    profile = np.convolve(sharp[:, 200:280].mean(axis=1), kernel / kernel.sum(), "same")
    truth = profile.reshape(count[0], -1).mean(axis=1)
    middle = slice(round(100 / pixel_mm), round(140 / pixel_mm))
    seen = tankrig.predict(coarse, "single").image[:, middle].mean(axis=1)
    assert apart(seen, truth) < 0.012  # the columns differ a little


@given(sigma_mm=st.floats(0.1, 3.0), share=st.floats(0.0, 0.2), halo_mm=st.floats(2.0, 40.0))
@settings(max_examples=30, deadline=None)
def test_a_projectors_lens_moves_light_and_makes_none(sigma_mm, share, halo_mm):
    light = Projector("collimated", (Beam((-4.0, 4.0), (56.0, 64.0)),), blur=Blur(sigma_mm), halo=Halo(share, halo_mm))
    scene = a_scene(light=light)
    for fine in (False, True):
        beams = entering(scene, fine).projector.beams
        power = sum(beam.power for beam in beams)
        assert power <= light.beams[0].power * (1.0 + 1e-9)
        assert power >= light.beams[0].power * (1.0 - share) * (1.0 - 1e-6)
        # Of the sharp part the variance is that of beam and blur.
        narrow = [beam for beam in beams if share == 0.0]
        if narrow:
            y = np.array([0.5 * sum(beam.y_mm) for beam in narrow])
            w = np.array([beam.power for beam in narrow])
            own = np.array([(beam.y_mm[1] - beam.y_mm[0]) ** 2 / 12.0 for beam in narrow])
            assert np.average(y**2 + own, weights=w) == pytest.approx(sigma_mm**2 + 8.0**2 / 12.0, rel=1e-6)


def test_black_level_is_a_beam_all_over_the_wall():
    scene = a_scene()
    dim = replace(scene, projector=replace(scene.projector, black_level=0.01))
    whole = replace(scene, projector=replace(scene.projector, beams=(Beam((-80.0, 80.0), (0.0, 120.0), 0.01),)))
    parts = tankrig.predict(scene, "single").image + tankrig.predict(whole, "single").image
    assert np.allclose(tankrig.predict(dim, "single").image, parts, rtol=1e-9)


def test_order_2_is_a_sum_over_beams_where_one_reaches_from_wall_to_wall():
    """A pinhole's light all over the wall once made the order 2 of all other beams half as much again."""
    beams = Beam((-14.0, -6.0), (54.0, 62.0)), Beam((-80.0, 80.0), (0.0, 120.0), 0.001)

    def order_2(*lit):
        light = Projector("pinhole", lit, (-400.0, 0.0, 58.0))
        return double_scattering(a_scene(Camera("orthographic", (20, 30), 8.0), light), 0.01)

    together, apart_from_it = order_2(*beams), [order_2(one) for one in beams]
    assert apart(together, sum(apart_from_it)) < 1e-4


def test_a_wide_lens_is_sharp_at_its_focus_alone():
    beams = (Beam((-4.0, 4.0), (56.0, 64.0)),)
    light = Projector("pinhole", beams, (-400.0, 0.0, 60.0), wide_lens=WideLens(20.0, 120.0))
    scene = a_scene(light=light)
    parts = through_lens(scene, True)
    assert sum(share for share, _ in parts) == pytest.approx(1.0)

    def edges_at(x_mm):
        """Where the upper edge is at a depth, seen from each point of the lens."""
        found = []
        for _, one in parts:
            _, y, _ = one.projector.position_mm
            found.append(y + (one.projector.beams[0].y_mm[1] - y) * (x_mm + 400.0) / 400.0)
        return np.array(found)

    assert np.ptp(edges_at(120.0)) < 1e-6
    assert np.ptp(edges_at(0.0)) > 2.0
    assert np.ptp(edges_at(240.0)) > 2.0


@given(height=st.floats(60.0, 130.0), share=st.floats(0.001, 0.1), sigma_mm=st.floats(2.0, 40.0))
@settings(max_examples=60, deadline=None)
def test_light_that_a_lens_spreads_stays_on_a_wall_of_any_size(height, share, sigma_mm):
    """A water level of 110.53452991734 mm, as calibration finds it, was left by a rounding."""
    size = (240.0, 160.0 + height / 7.0, height)
    beams = (Beam((-20.0, 24.0), (0.3 * height, height)), Beam((-0.5 * size[1], -60.0), (0.0, 0.2 * height)))
    light = Projector("collimated", beams, blur=Blur(0.3), halo=Halo(share, sigma_mm))
    scene = a_scene(light=light, size_mm=size)
    for fine in (False, True):
        assert entering(scene, fine).projector.beams
    assert CameraLens.of(scene).fine.projector.beams


def test_a_narrow_blur_is_the_same_on_the_picture_as_on_the_beams(monkeypatch):
    """Drawn on the picture it costs a tenth; what it shows must be what a dozen beams each show."""
    beams = (Beam((-30.0, -26.0), (55.0, 59.0)), Beam((-2.0, 2.0), (55.0, 59.0)), Beam((30.0, 36.0), (55.0, 59.0)))
    light = Projector("pinhole", beams, (-400.0, 5.0, 60.0), blur=Blur(0.3))
    camera = Camera("pinhole", (160, 30), 1.0, (20.0, 0.0, 600.0))
    scene = a_scene(camera, light, surface="fresnel")
    on_picture = tankrig.predict(scene, "single").image
    monkeypatch.setattr("tankrig.light.leaving.NARROW", -1.0)
    on_beams = tankrig.predict(scene, "single").image
    sharp = tankrig.predict(replace(scene, projector=replace(light, blur=Blur(0.0))), "single").image
    assert apart(on_picture, on_beams) < 0.005
    assert apart(sharp, on_beams) > 8.0 * apart(on_picture, on_beams)
    assert on_picture.sum() == pytest.approx(on_beams.sum(), rel=1e-3)


@pytest.mark.parametrize(
    ("turned", "aside_mm", "shape"),
    [((3.157, 0.0, 0.0), 6.0, (54, 80)), ((3.1, -0.03, -0.02), -25.0, (90, 60)), ((0.04, 3.14, 0.0), 0.0, (54, 80))],
)
def test_a_calibrated_picture_is_fine_where_light_ends_and_nowhere_else(turned, aside_mm, shape):
    """Fine pixels along smooth light take most of a fit's time; coarse ones at a wall lose its light to the blur."""
    lens = CameraLens.of(a_calibrated_scene(turned, aside_mm, shape))
    asked = []

    def counted(scene):
        asked.append(math.prod(scene.camera.shape))
        return once(scene)[None]

    (ideal,), (seen,) = lens.order_one(counted)
    everywhere = replace(lens, parts=(lens.parts[0], 16))
    image = once(everywhere.fine)
    assert image.max() > 0.0
    assert apart(seen, everywhere.of_fine(image)) < 0.001
    assert apart(ideal, everywhere.means(image)) < 0.0005
    assert sum(asked) < 0.5 * math.prod(lens.fine.camera.shape)
    coarse = replace(lens, parts=(lens.parts[0], 1))
    assert apart(coarse.of_fine(once(coarse.fine)), everywhere.of_fine(image)) > 0.001


def test_liquids_at_once_are_seen_through_a_lens_as_one_by_one():
    scene = a_calibrated_scene((3.157, 0.0, 0.0), 6.0, (27, 40))
    media = [Medium(0.001, 0.01, 0.6), Medium(0.0, 0.02, 0.2)]
    for image, medium in zip(once_seen(scene, media), media, strict=True):
        alone = CameraLens.of(scene).order_one(lambda seen, medium=medium: once(replace(seen, medium=medium))[None])[1]
        np.testing.assert_allclose(image, alone[0], rtol=1e-12, atol=1e-12 * alone.max())


def test_a_faint_halo_is_on_coarse_cells_what_it_is_on_fine_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Order 1 of a hundredth of the light took most of an image's time in a tank of glass."""
    scene = a_calibrated_scene((3.157, 0.0, 0.0), 6.0, (54, 80))
    glass = Face("glass", thickness_mm=6.0)
    tank = replace(scene.tank, entry="glass", wall_mm=6.0, faces=Faces(Face("glass"), glass, glass, glass))
    scene = replace(scene, tank=tank, projector=replace(scene.projector, halo=Halo(0.004, 24.0)))
    coarse = once_seen(scene, [scene.medium])
    monkeypatch.setattr(order_one, "HALO_OFF", 0.0)
    monkeypatch.setattr(order_one, "HARDLY_ANY", 0.0)
    fine = once_seen(scene, [scene.medium])
    dark = once_seen(replace(scene, projector=replace(scene.projector, halo=Halo(0.0, 24.0))), [scene.medium])
    assert apart(dark, fine) > 0.001
    assert 0.0 < apart(coarse, fine) < 0.0002


def test_a_camera_that_sees_light_run_down_its_picture_shows_the_same_tank():
    """Edges of beams then lie along its columns, where an upright one's picture is coarse."""
    upright = tankrig.predict(a_calibrated_scene((math.pi, 0.0, 0.0), 0.0, (36, 36)), "single").image
    half = math.pi / math.sqrt(2.0)
    scene = a_calibrated_scene((half, half, 0.0), 0.0, (36, 36))
    (fx, _, cx), (_, fy, cy), last = scene.camera.matrix
    turned = replace(scene.camera, matrix=((fy, 0.0, cy), (0.0, fx, cx), last))
    image = tankrig.predict(replace(scene, camera=turned), "single").image
    assert apart(image.T[::-1], upright) < 0.005
