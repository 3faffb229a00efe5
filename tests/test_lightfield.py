"""The paper's light-field convolution: its kernel against closed forms, its images against the tank's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.errors import SceneError
from tankrig.light.infinite import point_source_fluence
from tankrig.light.lightfield import lightfield_orders
from tankrig.light.lightfield.kernel import scattering_kernel
from tankrig.light.lightfield.spectrum import spectrum
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank, load_scene
from tankrig.scene.phase_functions import phase_function

REFERENCE = Path(__file__).parent / "data" / "reference"
CLASSES = {1: "order1", 2: "order2", 3: "order3", "4-20": "order4_20", ">20": "order_gt20"}


def relative_l2(image, truth, scale=None):
    return float(np.linalg.norm(image - truth) / np.linalg.norm(truth if scale is None else scale))


@pytest.fixture(scope="module")
def directions():
    points = np.random.default_rng(7).normal(size=(3, 500))
    return points / np.linalg.norm(points, axis=0)


@pytest.mark.parametrize(("g", "worst"), [(0.0, 0.012), (0.5, 0.015), (-0.4, 0.015)])
def test_kernel_of_order_two_is_the_closed_form(directions, g, worst):
    """Every order would be wrong: this runs the whole way from the tridiagonal system to space."""
    medium = Medium(0.002, 0.018, g)
    kernel = scattering_kernel(medium, (2, 2), 0.5, 200.0, 16, 24)
    for radius in (10.0, 40.0, 120.0):
        expected = phase_function(directions[0], g) * phase_function(directions[2], g)
        expected = expected * medium.sigma_s**2 * np.exp(-medium.sigma_t * radius) / radius**2
        assert relative_l2(kernel(*(radius * directions)), expected) < worst


def test_isotropic_kernel_is_the_point_source(directions):
    """High orders would not match the exact solution that holds all of them."""
    medium = Medium(0.0005, 0.0495, 0.0)
    radius = np.geomspace(5.0, 250.0, 20)
    scattered = point_source_fluence(radius, medium) - np.exp(-medium.sigma_t * radius) / (4 * np.pi * radius**2)
    kernel = scattering_kernel(medium, (3, None), 0.8, 300.0, 0, 0)
    found = kernel(*(radius * directions[:, :20]))
    np.testing.assert_allclose(found, medium.sigma_s**2 / (4.0 * np.pi) * scattered, rtol=4e-3)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_summed_over_space_an_order_is_a_blurred_phase_function(order):
    """Light would be lost between orders: n scatterings turn by a phase function of asymmetry gⁿ and weight ϖⁿ⁻¹ σs."""
    medium, k_in = Medium(0.004, 0.016, 0.6), np.array([0.3, -0.8])
    k_out = np.array([0.5, 0.1])
    found, odd = spectrum(medium, (order, order), np.array([1e-9]), k_in, k_out, 40)
    expected = medium.albedo ** (order - 1) * medium.sigma_s * phase_function(np.zeros(2), medium.g**order)
    np.testing.assert_allclose(found[0], expected, rtol=1e-3 if order == 1 else 1e-6)
    np.testing.assert_allclose(odd[0], 0.0, atol=1e-7)


def test_classes_of_orders_add_up_to_the_direct_solve():
    """The images by order would not add up to the image."""
    medium, wave_number = Medium(0.0001, 0.0499, 0.7), np.geomspace(1e-3, 3.0, 9)
    direction = np.array([0.2, 0.6]), np.array([-0.5, 0.3])
    parts = [spectrum(medium, orders, wave_number, *direction, 12) for orders in ((3, 3), (4, 20), (21, None))]
    for part, whole in zip(
        np.sum(parts, axis=0), spectrum(medium, (3, None), wave_number, *direction, 12), strict=True
    ):
        np.testing.assert_allclose(part, whole, rtol=1e-9, atol=1e-12)


@pytest.fixture(scope="module")
def images():
    names = ("pub01", "pub03", "pub06")
    return {name: lightfield_orders(load_scene(REFERENCE / f"{name}.toml")) for name in names}


@pytest.mark.parametrize(
    ("name", "third", "low", "high"),
    [("pub01", 0.026, 0.05, 0.08), ("pub03", 0.026, 0.025, 0.05), ("pub06", 0.09, 1.5, 1.9)],
)
def test_low_orders_hold_and_the_rest_is_as_wrong_as_known(images, name, third, low, high):
    """The model would not be the paper's: orders 1–3 are the tank's, but light that left the tank comes back."""
    with np.load(REFERENCE / f"{name}.npz") as data:
        truth = {key: data[array].astype(float) for key, array in CLASSES.items()}
        total = data["total"].astype(float)
    found = images[name]
    assert relative_l2(found[1], truth[1], total) < 5e-4
    assert relative_l2(found[2], truth[2]) < 0.015  # the reference's own noise in order 2
    assert relative_l2(found[3], truth[3]) < third
    assert low < relative_l2(np.sum(list(found.values()), axis=0), total) < high
    assert found["4-20"].sum() > truth["4-20"].sum()


def test_highest_order_cuts_classes(images):
    """The paper's figures (1, 3, 20 orders, all) would show the wrong sums."""
    scene = load_scene(REFERENCE / "pub01.toml")
    assert list(lightfield_orders(scene, max_order=1)) == [1]
    cut = lightfield_orders(scene, max_order=9, tolerance=0.05)
    assert list(cut) == [1, 2, 3, "4-20"]
    assert 0.8 < cut["4-20"].sum() / images["pub01"]["4-20"].sum() < 0.95


def small_scene(**changes):
    scene = Scene(
        Tank((120.0, 80.0, 60.0)),
        Medium(0.002, 0.03, 0.5),
        Projector("collimated", (Beam((-10.0, -4.0), (25.0, 31.0)), Beam((7.0, 20.0), (40.0, 44.0), 0.5))),
        Camera("orthographic", (40, 60), 2.0),
    )
    return replace(scene, **changes)


def high_orders(scene, tolerance=0.05):
    found = lightfield_orders(scene, tolerance=tolerance)
    return found[3] + found["4-20"] + found[">20"]


def test_beams_add_and_mirror():
    """A pattern of several beams, or one beside the middle, would be predicted wrongly."""
    scene = small_scene()
    whole = high_orders(scene)
    apart = [high_orders(replace(scene, projector=Projector("collimated", (b,)))) for b in scene.projector.beams]
    np.testing.assert_allclose(sum(apart), whole, rtol=1e-6, atol=1e-9 * whole.max())
    mirrored = tuple(replace(b, y_mm=(-b.y_mm[1], -b.y_mm[0])) for b in scene.projector.beams)
    np.testing.assert_allclose(
        high_orders(replace(scene, projector=Projector("collimated", mirrored))), whole[::-1], rtol=1e-6
    )


def test_lengths_scale_and_cameras_agree():
    """A larger rig, or another camera, would see other light."""
    scene = small_scene()
    whole = high_orders(scene)
    larger = Scene(
        Tank((1200.0, 800.0, 600.0)),
        Medium(0.0002, 0.003, 0.5),
        Projector(
            "collimated",
            tuple(
                Beam(tuple(10 * y for y in b.y_mm), tuple(10 * z for z in b.z_mm), b.irradiance)
                for b in scene.projector.beams
            ),
        ),
        Camera("orthographic", (40, 60), 20.0),
    )
    np.testing.assert_allclose(high_orders(larger), whole, rtol=1e-9)
    coarse = high_orders(replace(scene, camera=Camera("orthographic", (8, 14), 10.0)))
    np.testing.assert_allclose(coarse[:, :12], whole.reshape(8, 5, 12, 5).mean(axis=(1, 3)), rtol=1e-3)
    assert not coarse[:, 12:].any()  # beyond the tank


def test_tighter_tolerance_changes_little():
    """`tolerance` would not mean what it says."""
    scene = small_scene()
    fine, usual = lightfield_orders(scene, tolerance=0.0025), lightfield_orders(scene, tolerance=0.01)
    total = np.sum(list(fine.values()), axis=0)
    assert relative_l2(np.sum(list(usual.values()), axis=0), total) < 0.01


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"projector": Projector("pinhole", (Beam((-2.0, 2.0), (25.0, 31.0)),), (-100.0, 0.0, 30.0))},
            "projector.kind",
        ),
        ({"camera": Camera("pinhole", (40, 60), 2.0, (60.0, 0.0, 300.0))}, "camera.kind"),
        ({"tank": Tank((120.0, 80.0, 60.0), "fresnel")}, "tank.surface"),
        ({"medium": Medium(0.0, 0.03, 0.5)}, "sigma_a = 0"),
    ],
)
def test_what_the_model_cannot_treat_is_refused(changes, message):
    """A user would get a wrong image instead of the name of the model to use."""
    with pytest.raises(SceneError, match=message) as refusal:
        lightfield_orders(small_scene(**changes))
    assert 'model = "tank"' in str(refusal.value)


@pytest.mark.parametrize(
    "medium",
    [
        Medium(1e-9, 1e-6, 0.5),
        Medium(0.05e-9, 0.05, -0.5),
        Medium(0.05e-9, 0.05, 1e-8),
        Medium(0.01, 0.04, 0.9),
        Medium(0.25, 0.25, 0.0),
        Medium(0.0, 0.0, 0.0),
    ],
)
def test_extreme_media_stay_finite(medium):
    """A fit that strays would stop at NaN or a negative image."""
    image = np.sum(list(lightfield_orders(small_scene(medium=medium), tolerance=0.1).values()), axis=0)
    assert np.isfinite(image).all()
    assert image.min() >= 0.0
    assert (image.max() > 0.0) == (medium.sigma_s > 0.0)
