"""The diffuse limit: against exact half-spaces and slabs of light, and against the tank's reference images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.light.diffuse import diffuse_image, diffuse_light
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank, load_scene

REFERENCE = Path(__file__).parent / "data" / "reference"


def dense_scene(**changes):
    scene = Scene(
        Tank((120.0, 80.0, 60.0)),
        Medium(0.001, 0.2, 0.5),
        Projector("collimated", (Beam((-10.0, -4.0), (25.0, 31.0)), Beam((7.0, 20.0), (40.0, 44.0), 0.5))),
        Camera("orthographic", (40, 60), 2.0),
    )
    return replace(scene, **changes)


@pytest.mark.parametrize(
    ("name", "worst", "sum_error"), [("pub06", 0.10, 0.01), ("pub07", 0.04, 0.01), ("pub12", 0.045, 0.01)]
)
def test_dense_tanks_of_the_reference(name, worst, sum_error):
    """A user of the diffuse limit would get a wrong image where it is meant to hold (and docs/models.md would lie)."""
    scene = load_scene(REFERENCE / f"{name}.toml")
    with np.load(REFERENCE / f"{name}.npz") as data:
        total = data["total"].astype(float)
    image = diffuse_image(scene)
    assert np.linalg.norm(image - total) < worst * np.linalg.norm(total)
    assert image.sum() == pytest.approx(total.sum(), rel=sum_error)


@pytest.mark.parametrize(("albedo", "reflected", "off"), [(0.9, 0.4149475, 0.08), (0.99, 0.7527207, 0.03)])
def test_reflected_by_a_half_space(albedo, reflected, off):
    """Light would leave dense media too easily or too hard: exact diffuse reflectances of a lit half-space."""
    scene = Scene(
        Tank((30.0, 60.0, 60.0)),
        Medium(1.0 - albedo, albedo, 0.0),
        Projector("collimated", (Beam((-30.0, 30.0), (0.0, 60.0)),)),
        Camera("orthographic", (1, 1), 1.0),
    )
    axes, spacing, (fluence, flux, *_) = diffuse_light(scene, step_mm=0.4)
    y, z = fluence.shape[1] // 2, fluence.shape[2] // 2
    outside = np.searchsorted(axes[0], -0.5 * spacing[0]) - 1
    assert -flux[outside, y, z] == pytest.approx(reflected, rel=off)


def test_no_light_is_made_or_lost():
    """Energy: what the projector sends in is absorbed or leaves, so absorbing nothing must let all of it out."""
    scene = dense_scene(medium=Medium(0.0005, 0.3, 0.0))
    _, spacing, (fluence, *flux) = diffuse_light(scene)
    volume = np.prod(spacing)
    lit = 0.3 * 62.0 / 0.3005  # first scatterings: the beams' power times albedo; nothing gets across unscattered
    leaving = sum(
        area * (np.take(flux[i], -1, i).sum() - np.take(flux[i], 0, i).sum())
        for i, area in enumerate(volume / np.array(spacing))
    )
    assert 0.0005 * fluence.sum() * volume + leaving == pytest.approx(lit, rel=0.02)


def test_lengths_scale():
    """A larger rig would see other light."""
    scene = dense_scene()
    beams = tuple(
        Beam(tuple(10 * y for y in b.y_mm), tuple(10 * z for z in b.z_mm), b.irradiance) for b in scene.projector.beams
    )
    larger = Scene(
        Tank((1200.0, 800.0, 600.0)),
        Medium(0.0001, 0.02, 0.5),
        Projector("collimated", beams),
        Camera("orthographic", (40, 60), 20.0),
    )
    np.testing.assert_allclose(diffuse_image(larger), diffuse_image(scene), rtol=1e-9)


def test_beams_add_and_mirror():
    """A pattern of several beams, or one beside the middle, would be predicted wrongly."""
    scene = dense_scene()
    whole = diffuse_image(scene, 2.0)
    apart = [diffuse_image(replace(scene, projector=Projector("collimated", (b,))), 2.0) for b in scene.projector.beams]
    np.testing.assert_allclose(sum(apart), whole, rtol=1e-6, atol=1e-7 * whole.max())
    mirrored = tuple(replace(b, y_mm=(-b.y_mm[1], -b.y_mm[0])) for b in scene.projector.beams)
    turned = diffuse_image(replace(scene, projector=Projector("collimated", mirrored)), 2.0)
    np.testing.assert_allclose(turned, whole[::-1], rtol=1e-6, atol=1e-9 * whole.max())


def test_far_pinholes_are_parallel():
    """Perspective projectors or cameras would be treated differently from parallel ones."""
    scene = dense_scene()
    far = replace(
        scene,
        projector=Projector("pinhole", scene.projector.beams, (-1e6, 0.0, 30.0)),
        camera=Camera("pinhole", (40, 60), 2.0, (60.0, 0.0, 1e6)),
    )
    image = diffuse_image(scene, 2.0)
    assert np.linalg.norm(diffuse_image(far, 2.0) - image) < 1e-3 * np.linalg.norm(image)


def test_a_surface_keeps_light_in():
    """The water's surface would not reflect: below it light is brighter, above it the image darker."""
    matched, fresnel = dense_scene(), dense_scene(tank=Tank((120.0, 80.0, 60.0), "fresnel"))
    below = [diffuse_light(scene, 3.0)[2][0].max() for scene in (matched, fresnel)]
    assert below[1] > below[0]
    assert diffuse_image(fresnel, 3.0).sum() < diffuse_image(matched, 3.0).sum()


@pytest.mark.parametrize("sigma_t", [1e-6, 0.05, 10.0])
@pytest.mark.parametrize("absorbed", [0.0, 1e-9, 0.5])
@pytest.mark.parametrize("g", [-0.99, 1e-8, 0.99])
def test_extreme_media_stay_finite(sigma_t, absorbed, g):
    """A fit that strays would stop at NaN or a negative image."""
    medium = Medium(sigma_t * absorbed, sigma_t * (1.0 - absorbed), g)
    image = diffuse_image(dense_scene(medium=medium), step_mm=4.0)
    assert np.isfinite(image).all()
    assert image.min() >= 0.0
    assert image.max() > 0.0
