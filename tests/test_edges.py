"""What a fit must not look at: blurred edges of light, saturated and hot pixels; and how pixels become bins."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

import tankrig
from tankrig.bench import Bench
from tankrig.devices import CameraSettings
from tankrig.errors import SceneError
from tankrig.estimation.misfit import moved_by_faults, moved_unseen
from tankrig.estimation.uncertainty import Response, Sensitivity, SmoothError, Weights
from tankrig.estimation.verdict import what_is_unseen
from tankrig.image.bins import FIT_PIXEL_MM, KEPT, Bins, Seen, bins_for
from tankrig.light.single import single_scattering
from tankrig.live.one_picture import picture_of, radiance_of
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.pattern.kinds import Rays, Stripes, draw
from tankrig.pattern.wall import Wall
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.outline import beside_water, blurred_pixels, edge_reach_mm, edges_of_light
from ui.cli import main

SMALL = Tank((60.0, 40.0, 30.0))
ANY = Medium(0.001, 0.01, 0.5)
WIDE = Camera("orthographic", (80, 120), 0.5)


def scene_of(*beams: Beam, camera: Camera = WIDE, blur_mm: float | None = 0.3) -> Scene:
    return Scene(SMALL, ANY, Projector("collimated", beams, blur_mm=blur_mm), camera)


cuts = st.lists(st.floats(-5.9, 7.9), max_size=8, unique=True).map(sorted)
heights = st.lists(st.floats(12.1, 17.9), max_size=4, unique=True).map(sorted)


@given(cuts, heights)
@settings(deadline=None, max_examples=25)
def test_beams_side_by_side_are_one_light(across: list[float], up: list[float]) -> None:
    """A picture that is rolled a little comes as dozens of slivers: masking their seams would leave nothing to fit."""
    whole = scene_of(Beam((-6.0, 8.0), (12.0, 18.0)))
    y, z = [-6.0, *across, 8.0], [12.0, *up, 18.0]
    parts = [
        Beam((y0, y1), (z0, z1))
        for y0, y1 in pairwise(y) for z0, z1 in pairwise(z)
        if y1 - y0 > 1e-6 and z1 - z0 > 1e-6
    ]  # fmt: skip
    assert (edges_of_light(scene_of(*parts)) == edges_of_light(whole)).mean() > 0.999


@given(st.floats(-8.0, 2.0), st.floats(3.0, 10.0), st.floats(0.15, 0.8))
@settings(deadline=None, max_examples=25)
def test_the_mask_follows_true_steps_and_reaches_as_far_as_it_says(low: float, width: float, blur_mm: float) -> None:
    """Too near, and blur passes for scattering; too far, and beams are thrown away."""
    scene = scene_of(Beam((low, low + width), (12.0, 18.0)), blur_mm=blur_mm)
    reach, cell = edge_reach_mm(scene), edge_reach_mm(scene) / 8.0
    assert reach == pytest.approx(2.5 * blur_mm)
    y = (np.arange(80) + 0.5) * 0.5 - 20.0
    away = np.maximum(np.minimum(np.abs(y - low), np.abs(y - low - width)) - 0.25, 0.0)
    masked = edges_of_light(scene)[:, 60]
    assert masked[away < reach - 2.5 * cell].all()
    assert not masked[away > reach + 2.5 * cell].any()


def test_light_that_changes_little_from_level_to_level_has_no_edges_and_a_step_of_a_tenth_has() -> None:
    levels = [Beam((0.5 * k, 0.5 * k + 0.5), (12.0, 18.0), 1.0 - 0.02 * k) for k in range(-10, 20)]
    inside = edges_of_light(scene_of(*levels))[34:56, 10:110]
    assert not inside.any()
    step = [Beam((-8.0, 0.0), (12.0, 18.0)), Beam((0.0, 8.0), (12.0, 18.0), 0.9)]
    assert edges_of_light(scene_of(*step))[39:41, 10:110].all()


def test_light_that_rises_to_the_surface_ends_where_the_camera_sees_it_end() -> None:
    """Tilted light: the end in x is an edge like the sides."""
    light = Projector("pinhole", (Beam((-4.0, 4.0), (14.8, 15.2)),), (-10.0, 0.0, 5.0), blur_mm=0.2)
    scene = Scene(SMALL, ANY, light, WIDE)
    middle = np.flatnonzero(edges_of_light(scene)[40])
    ends = (SMALL.size_mm[2] - np.array([14.8, 15.2])) / ((np.array([14.8, 15.2]) - 5.0) / 10.0) / 0.5
    assert (np.abs(middle - ends.mean()) < 8.0).any()


def test_nothing_is_left_out_where_nothing_says_that_it_blurs() -> None:
    """Figures of the ideal rig must not change."""
    scene = scene_of(Beam((-6.0, 8.0), (12.0, 18.0)), blur_mm=None)
    assert edge_reach_mm(scene) == 0.0
    assert not blurred_pixels(scene).any()
    image = single_scattering(scene)
    plain = tankrig.estimate(image, scene, gain=1.0, offset=0.0, model="single", noise=0.01 * image.max())
    masked = tankrig.estimate(
        image, scene, gain=1.0, offset=0.0, model="single", noise=0.01 * image.max(), mask=blurred_pixels(scene)
    )
    assert plain.medium == masked.medium
    assert (plain.covariance == masked.covariance).all()


def test_the_rim_of_the_water_is_left_out_by_what_the_camera_blurs() -> None:
    scene = scene_of(Beam((-6.0, 8.0), (12.0, 18.0)), camera=replace(WIDE, blur_mm=0.4))
    rim = beside_water(scene, 1.0)
    assert rim[:2].all() and rim[:, -2:].all() and not rim[3:-3, 3:-3].any()  # noqa: PT018
    assert blurred_pixels(scene)[rim].all()


shapes = st.tuples(st.integers(1, 23), st.integers(1, 29))


@given(shapes, st.integers(1, 5), st.integers(1, 7), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_bins_are_the_means_of_their_good_pixels(shape: tuple[int, int], by: int, along: int, seed: int) -> None:
    """Of any shape, prime numbers too; a spoilt pixel neither counts nor takes its bin along."""
    random = np.random.default_rng(seed)
    pixels, good = random.integers(0, 65536, shape).astype(np.uint16), random.random(shape) < 0.7
    bins = Bins(by, along)
    means, shares = bins.means(pixels, good), bins.shares(good)
    assert means.shape == (shape[0] // by, shape[1] // along)
    for (row, column), mean in np.ndenumerate(means):
        block = np.s_[row * by : (row + 1) * by, column * along : (column + 1) * along]
        counts = good[block]
        assert shares[row, column] == pytest.approx(counts.mean())
        assert mean == pytest.approx(pixels[block][counts].mean() if counts.any() else pixels[block].mean())
    rows, columns = means.shape
    whole = np.s_[: rows * by, : columns * along]
    assert np.sum(bins.means(pixels, good) * shares)[()] * bins.size == pytest.approx(
        float(np.where(good, pixels, 0)[whole].sum()), abs=1e-6
    )


CALIBRATED = Camera(
    "calibrated", (541, 1021), position_mm=(120.0, 0.0, 620.0),
    matrix=((1620.0, 0.0, 510.0), (0.0, 1620.0, 270.0), (0.0, 0.0, 1.0)), rotation=(np.pi, 0.0, 0.0),
)  # fmt: skip


@pytest.mark.parametrize("width_mm", [3.0, 4.0, 8.0, 30.0])
def test_bins_are_as_coarse_as_the_detail_allows(width_mm: float) -> None:
    """Bins of 4 mm across a beam of 4 mm are all at edges; bins of a pixel each take minutes to fit."""
    light = Projector("pinhole", (Beam((-width_mm / 2, width_mm / 2), (58.0, 62.0)),), (-400.0, 0.0, 60.0), blur_mm=0.2)
    scene = Scene(Tank(), ANY, light, replace(CALIBRATED, blur_mm=0.15))
    seen = Seen.of(scene)
    bins = bins_for(scene.camera, [seen])
    tall, wide = bins.camera(scene.camera).sides_mm
    assert max(tall, wide) <= FIT_PIXEL_MM
    assert wide > 3.0, "along a beam nothing needs fine bins"
    assert seen.kept(bins) >= KEPT or bins.by <= 3
    if width_mm == 30.0:
        assert tall > 3.0


def test_a_person_may_say_how_to_bin(tmp_path: Path) -> None:
    assert bins_for(replace(CALIBRATED, bin=5), []) == Bins(5, 5)
    with pytest.raises(SceneError, match="bin = 600"):
        replace(CALIBRATED, bin=600)
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + "bin = 4\n")
    assert tankrig.load_scene(path).camera.shape == (20, 30)
    assert tankrig.load_scene(path).camera.pixel_mm == 2.0


def bench(camera: Camera, blur_mm: float | None) -> tuple[Bench, Wall]:
    wall = Wall((120, 160), (-20.0, 20.0), (0.0, 30.0))
    return Bench(SMALL, wall, "collimated", replace(camera, blur_mm=blur_mm)), wall


def test_a_pattern_that_blur_leaves_nothing_of_is_refused_before_a_run() -> None:
    fine, wall = bench(WIDE, 0.6)
    with pytest.raises(SceneError, match=r"blur light to 1\.5 mm .* wider"):
        PhotographPlan(
            fine, {"a": draw(Stripes(3.0, 0.5, (-15.0, 15.0), (12.0, 18.0)), wall)}, (1.0,), ()
        ).require_left()
    PhotographPlan(fine, {"a": draw(Rays((-8.0, 8.0), (12.0, 18.0)), wall)}, (1.0,), ()).require_left()


def test_saturated_pixels_take_along_the_bins_that_they_lie_in_or_adjoin() -> None:
    """The mean of those that are not saturated would be too dark."""
    sharp, wall = bench(WIDE, None)
    pattern = draw(Rays((-8.0, 8.0), (12.0, 18.0)), wall)
    plan = PhotographPlan(sharp, {"a": pattern}, (1.0,), (), saturation=4095)
    assert plan.bins == Bins(8, 8)
    assert plan.counts["a"].all()
    frame = np.full((80, 120), 100, np.uint16)
    frame[17, 9] = 4095
    means, below = plan.binned(frame, CameraSettings(10.0, 2.0))
    assert np.argwhere(~below).tolist() == [[2, 1]]
    assert means[below] == pytest.approx(5.0)
    frame[23, 16] = 4095
    _, below = plan.binned(frame, CameraSettings(10.0, 2.0))
    assert np.argwhere(~below).tolist() == [[2, 1], [2, 2], [3, 1], [3, 2]]


@given(st.integers(1, 7), st.floats(0.0, 0.2), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=40)
def test_what_counts_of_a_frame_is_what_a_camera_without_an_end_would_have_seen(
    bins: int, share: float, seed: int
) -> None:
    """Live and from a file, whatever part of the light is saturated: else the brightest bins are too dark."""
    random = np.random.default_rng(seed)
    rows, columns = WIDE.shape
    light = 3000.0 * np.exp(-np.arange(columns) / 60.0 - ((np.arange(rows)[:, None] - random.uniform(20, 60)) / 9) ** 2)
    seen = np.rint(random.poisson(light) + 100.0).astype(np.uint16)
    highest = int(np.quantile(seen, 1.0 - share))
    frame = np.minimum(seen, highest)
    camera, at = replace(WIDE, bin=bins), CameraSettings(10.0, 2.0)
    rig, wall = bench(camera, None)
    plan = PhotographPlan(rig, {"a": draw(Rays((-8.0, 8.0), (12.0, 18.0)), wall)}, (1.0,), (), saturation=highest)
    true = Bins(bins, bins).means(seen) / 20.0
    live, below = plan.binned(frame, at)
    assert live[below] == pytest.approx(true[below])
    counts, hot, full = radiance_of(frame, at, None, None)
    assert (full == (frame == highest)).all() or not full.any()
    scene = Scene(SMALL, ANY, Projector("collimated", (Beam((-20.0, 20.0), (0.0, 30.0)),)), camera)
    picture = picture_of(counts, scene, hot, frame == highest)
    assert picture.image[~picture.mask] == pytest.approx(true[~picture.mask])
    assert (picture.mask == ~below).all()
    assert picture.saturated == pytest.approx((frame == highest).mean())


def test_a_frame_whose_brightest_pixels_are_saturated_is_fitted_rightly() -> None:
    """Means over what is left of bins beside them made σs 14 % too small, and said ± 0.4 %."""
    truth, camera = Medium(0.001, 0.012, 0.4), Camera("pinhole", (80, 120), 2.0, (120.0, 0.0, 620.0))
    light = Projector("pinhole", (Beam((-20.0, 20.0), (50.0, 70.0)),), (-400.0, 0.0, 60.0))
    scene = Scene(Tank(), truth, light, camera)
    radiance = single_scattering(scene)
    gain = 4000.0 / radiance.max()
    counts = 0.5 * np.random.default_rng(0).poisson(2.0 * gain * radiance) + 100.0
    frame = np.minimum(np.rint(counts), np.quantile(counts, 0.98).round()).astype(np.uint16)
    image, hot, full = radiance_of(frame, CameraSettings(1.0), None, np.full(frame.shape, 100, np.uint16))
    picture = picture_of(image, replace(scene, camera=replace(camera, bin=4)), hot, full)
    assert 0.01 < picture.saturated < 0.03
    noise = np.sqrt(0.5 * np.maximum(picture.image, 1.0) + 0.1) / 4.0
    found = tankrig.estimate(
        picture.image, picture.scene, gain=gain, offset=0.0, mask=picture.mask, model="single", noise=noise
    )
    errors = np.array([found.medium.sigma_s - truth.sigma_s, found.medium.g - truth.g])
    sds = np.sqrt(np.diag(found.covariance)[1:])
    assert found.identifiable["sigma_s"]
    assert found.identifiable["g"]
    assert (np.abs(errors) < 2.0 * sds).all()


def test_a_frame_most_of_whose_light_is_saturated_is_refused() -> None:
    scene = Scene(SMALL, ANY, Projector("collimated", (Beam((-20.0, 20.0), (0.0, 30.0)),)), replace(WIDE, bin=4))
    frame = np.full(WIDE.shape, 255, np.uint8)
    frame[:20] = np.arange(20)[:, None]
    image, hot, full = radiance_of(frame, CameraSettings(1.0), None, None)
    with pytest.raises(tankrig.ImageError, match=r"75 % of the light .* is saturated.* shorten the exposure"):
        picture_of(image, scene, hot, full)


def blurred_picture(scene: Scene, blur_mm: float) -> np.ndarray:
    rows, columns = scene.camera.shape
    fine = replace(scene.camera, shape=(5 * rows, 5 * columns), pixel_mm=scene.camera.pixel_mm / 5)
    picture = single_scattering(replace(scene, camera=fine))
    picture = cv2.GaussianBlur(picture, (0, 0), blur_mm / fine.pixel_mm, borderType=cv2.BORDER_CONSTANT)
    return picture.reshape(rows, 5, columns, 5).mean(axis=(1, 3))


def test_a_blurred_picture_is_fitted_rightly_without_its_edges_and_wrongly_with_them() -> None:
    """What this is all for."""
    camera = Camera("pinhole", (80, 120), 0.5, (30.0, 0.0, 180.0), blur_mm=0.35)
    truth = Medium(0.001, 0.02, 0.3)
    light = Projector("collimated", (Beam((-6.2, -1.1), (12.0, 18.0)), Beam((4.3, 9.1), (12.0, 18.0), 0.7)))
    scene = Scene(SMALL, truth, light, camera)
    image = blurred_picture(scene, 0.35)
    noise = 0.002 * image.max()
    image = image + np.random.default_rng(2).normal(0.0, noise, image.shape)

    def off(mask: np.ndarray | None) -> float:
        found = tankrig.estimate(image, scene, gain=1.0, offset=0.0, noise=noise, mask=mask, model="single")
        return abs(found.medium.sigma_t / truth.sigma_t - 1.0)

    without_edges = off(blurred_pixels(scene))
    assert without_edges < 0.005
    assert off(None) > 3.0 * without_edges


def linear_fit(random: np.random.Generator) -> tuple[Sensitivity, np.ndarray, np.ndarray]:
    """Three values that an image of 20 × 30 pixels responds to, and a fault that looks much like the second."""
    y, x = np.mgrid[:20, :30] / 30.0
    changes = np.array([np.exp(-x), x * np.exp(-2.0 * x), np.cos(3.0 * y)]).reshape(3, -1) * 40.0
    fault = changes[1] + 8.0 * np.sin(9.0 * x * y).ravel()
    used = np.ones((20, 30), bool)
    response = Response(changes, Weights(np.ones(600)), used)
    return Sensitivity((response,), np.zeros((3, 0)), np.full(3, 1e3), np.ones(3)), fault, random.normal(size=600)


@given(st.floats(-3.0, 3.0).filter(lambda size: abs(size) > 1.0), st.integers(0, 99))
@settings(deadline=None, max_examples=25)
def test_what_a_fault_moved_the_values_by_is_in_their_errors(size: float, seed: int) -> None:
    """An interval that leaves the truth out because a camera was bumped would be believed."""
    fit, fault, noise = linear_fit(np.random.default_rng(seed))
    seen = size * fault + noise
    moved = fit.step(seen)
    residual = seen - moved @ fit.changes
    exact = [SmoothError(np.zeros((20, 30)), 30.0)]
    added = moved_by_faults(fit, residual, fault[None], [np.ones((20, 30))], exact)
    assert abs(moved[1]) < 1.5 * np.sqrt(added[1, 1])


def test_noise_alone_shows_no_fault() -> None:
    found = 0
    for seed in range(100):
        fit, fault, noise = linear_fit(np.random.default_rng(seed))
        residual = noise - fit.step(noise) @ fit.changes
        exact = [SmoothError(np.zeros((20, 30)), 30.0)]
        found += bool(moved_by_faults(fit, residual, fault[None], [np.ones((20, 30))], exact).any())
    assert found <= 3


@given(st.floats(0.002, 3.0), st.integers(0, 99))
@settings(deadline=None, max_examples=25)
def test_what_no_residual_shows_moves_the_values_no_farther_than_is_said(size: float, seed: int) -> None:
    """A halo too faint to be seen moved σs by 20 stated standard deviations, and the verdict said nothing."""
    fit, fault, noise = linear_fit(np.random.default_rng(seed))
    exact, ones = [SmoothError(np.zeros((20, 30)), 30.0)], [np.ones((20, 30))]
    said = moved_unseen(fit, fault[None], size, ones, exact)
    moved = fit.step(size * fault)
    if said.any():
        assert said == pytest.approx(np.abs(moved))
    else:
        seen = size * fault + noise
        residual = seen - fit.step(seen) @ fit.changes
        sure = moved_by_faults(fit, residual, fault[None], ones, exact).any()
        left = fault - fit.step(fault) @ fit.changes
        assert sure or size * np.linalg.norm(left) < 6.0, "what is not said to be unseen is seen, but for chance"


def test_a_verdict_names_a_halo_only_where_an_interval_leaves_it_out() -> None:
    medium, spread = Medium(0.001, 0.02, 0.3), np.diag([1e-4, 2e-4, 0.01]) ** 2
    known = {"sigma_a": False, "sigma_s": True, "g": True}
    assert what_is_unseen(medium, np.array([1.0, 3e-4, 0.01]), spread, known) == ""
    said = what_is_unseen(medium, np.array([1.0, 3.4e-3, 0.05]), spread, known)
    assert "1 % of the light into a wide halo" in said
    assert "σs by 17 % and g by 0.05 could be off" in said
    assert "σa" not in said


def test_parts_of_an_image_that_disagree_widen_the_errors() -> None:
    """And where they agree, hardly."""
    fit, _, noise = linear_fit(np.random.default_rng(5))
    x = np.tile(np.arange(30) / 30.0, 20)
    torn = np.where(x > 0.5, 1.0, -1.0) * fit.changes[0]
    sds = [
        np.sqrt(np.diag(fit.covariance([np.ones((20, 30))], [None], residual - fit.step(residual) @ fit.changes)))
        for residual in (noise, noise + torn)
    ]
    alone = np.sqrt(np.diag(fit.covariance([np.ones((20, 30))], [None])))
    assert (sds[0] < 2.0 * alone).all()
    assert sds[1][0] > 5.0 * alone[0]


@pytest.mark.parametrize("count", [6, 16, 20, 24])
def test_what_parts_disagree_by_is_as_true_of_many_values(count: int) -> None:
    """A free phase function's seventeen shapes had left so few of sixteen parts free that errors were two to three
    times too large."""
    rng, shape = np.random.default_rng(3), (48, 72)

    def smooth(width: float, many: int) -> np.ndarray:
        found = gaussian_filter(rng.normal(size=(many, *shape)), (0.0, width, width)).reshape(many, -1)
        return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))

    changes, weights = smooth(6.0, count), Weights(np.ones(48 * 72))
    response = Response(changes, weights, np.ones(shape, bool))
    fit = Sensitivity((response,), np.zeros((count, 0)), np.full(count, 1e6), np.ones(count))
    inverse = np.linalg.inv(changes @ changes.T)
    for width, low in ((1.5, 0.7), (3.0, 0.5)):
        faults = smooth(width, 300)
        moves = inverse @ changes @ faults.T
        said = [
            np.diag(inverse @ fit.disagreement(fault - fit.step(fault) @ changes) @ inverse) for fault in faults[:40]
        ]
        assert low < np.median(np.mean(said, axis=0) / np.mean(moves**2, axis=1)) < 1.6


SCENE = """
[tank]
size_mm = [60.0, 40.0, 30.0]
surface = "matched"
[medium]
sigma_a = 0.001
sigma_s = 0.02
g = 0.3
[projector]
kind = "collimated"
blur_mm = 0.3
beams = [ { y_mm = [-6.0, 6.0], z_mm = [12.0, 18.0], irradiance = 1.0 } ]
[camera]
kind = "orthographic"
shape = [80, 120]
pixel_mm = 0.5
"""


def test_fit_makes_radiance_of_a_raw_frame_and_leaves_out_what_it_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Dark subtracted, edges out, a bubble masked: nobody has to do that in Python any more."""
    coarse = SCENE.replace("[80, 120]", "[40, 60]").replace("pixel_mm = 0.5", "pixel_mm = 1.0")
    (tmp_path / "scene.toml").write_text(coarse)
    scene = tankrig.load_scene(tmp_path / "scene.toml")
    radiance = blurred_picture(scene, 0.3)
    random = np.random.default_rng(3)
    light = 3000.0 * radiance / radiance.max()
    light[15:17, 25:28] = 3500.0  # a bubble
    for name, counts in (("frame", 200.0 + light), ("dark", np.full(light.shape, 200.0))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.round(random.normal(counts, 3.0)).astype(np.uint16))
    bubble = np.zeros(light.shape, np.uint8)
    bubble[14:18, 24:29] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), bubble)
    words = ["fit", str(tmp_path / "frame.png"), "--scene", str(tmp_path / "scene.toml"), "--model", "single", "--json"]
    raw = ["--exposure-ms", "20", "--dark", str(tmp_path / "dark.png")]
    assert main([*words, *raw, "--mask", str(tmp_path / "mask.png"), "--out", str(tmp_path / "a")]) == 0
    with np.load(tmp_path / "a" / "frame-fit.npz") as arrays:
        left_out = np.isnan(arrays["residual"])
    assert left_out[bubble > 0].all()
    assert left_out[edges_of_light(scene)].all()
    assert main([*words, *raw, "--edges", "none", "--out", str(tmp_path / "b")]) == 0
    with np.load(tmp_path / "b" / "frame-fit.npz") as arrays:
        assert not np.isnan(arrays["residual"])[edges_of_light(scene)].all()
    capsys.readouterr()
    assert main([*words, "--dark", str(tmp_path / "dark.png"), "--out", str(tmp_path / "c")]) == 2
    assert "--exposure-ms" in capsys.readouterr().err
    assert main([*words, "--edges", "wide", "--out", str(tmp_path / "c")]) == 2
    assert "wide" in capsys.readouterr().err
    assert main([*words, "--edges", "20", "--out", str(tmp_path / "c")]) == 2
    assert "narrower" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_what_was_found_before_ctrl_c_is_kept_and_said_to_be_unfinished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten minutes of fitting must not be lost to impatience, nor may half a result be taken for a whole one."""
    (tmp_path / "scene.toml").write_text(SCENE)
    scene = tankrig.load_scene(tmp_path / "scene.toml")
    np.save(tmp_path / "tank.npy", blurred_picture(scene, 0.3))
    words = ["fit", str(tmp_path / "tank.npy"), "--scene", str(tmp_path / "scene.toml"), "--model", "single"]

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(tankrig, "predict", interrupted)  # what comes after the coefficients
        assert main([*words, "--out", str(tmp_path / "late")]) != 0
    assert [path.name for path in (tmp_path / "late").iterdir()] == ["tank-fit.json"]
    assert '"unfinished": true' in (tmp_path / "late" / "tank-fit.json").read_text()
    assert "unfinished" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr(tankrig, "estimate", interrupted)
        assert main([*words, "--out", str(tmp_path / "early")]) == 1
    assert not (tmp_path / "early").exists()
