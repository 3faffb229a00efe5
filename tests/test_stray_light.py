"""Light that lenses and walls lead astray, named or fitted along: a fit that does not know it is ten deviations off."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tankrig
from tankrig.estimation.astray import Astray, AstrayBlock
from tankrig.estimation.astray_causes import causes
from tankrig.estimation.found_optics import as_found
from tankrig.estimation.residual import likely_cause
from tankrig.light.leaving import CameraLens
from tankrig.light.prepared.box import Box
from tankrig.light.tank import by_faces, low_orders, tank_image
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import Blur, Face, Faces, Halo
from tests.optics_scenes import apart


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A prepared model of a plain scene, its image of a liquid, and noise of .2 % of the peak."""
    light = Projector("collimated", (Beam((-14.0, -6.0), (54.0, 62.0)), Beam((10.0, 18.0), (54.0, 62.0))))
    medium = Medium(0.0012, 0.0108, 0.4)
    scene = Scene(Tank(surface="fresnel"), medium, light, Camera("orthographic", (40, 60), 4.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.mktemp("cache")))
        live = tankrig.prepare(scene, tolerance=0.02, box=Box((0.004, 0.03), (0.6, 0.995), (0.0, 0.8)))
    return scene, live, np.asarray(live.predict(medium))


@pytest.mark.parametrize(
    ("name", "said", "size", "sd"),
    [
        ("halo", "a halo of the camera's lens", 0.02, 0.02),
        pytest.param("floor", "light that the floor reflects", 0.04, 0.05, marks=pytest.mark.long),
    ],
)
def test_light_astray_is_named_and_fitted_along(bench, name, said, size, sd):
    """A halo of 2 % or a floor of 4 % were called noise, and moved σs by ten of its standard deviations."""
    scene, live, clean = bench
    noise = 0.002 * clean.max()
    if name == "halo":
        lens = CameraLens.of(replace(scene, camera=replace(scene.camera, halo=Halo(size, 30.0))))
        image = lens.of_wide(clean)
    else:
        shiny = replace(scene, tank=replace(scene.tank, faces=Faces(floor=Face("diffuse", size))))
        image = clean + by_faces(shiny, seed=99, lattices=8)
    image = image + np.random.default_rng(3).normal(0.0, noise, clean.shape)
    known = {"model": live, "gain": 1.0, "offset": 0.0, "noise": noise}
    unaware = tankrig.estimate(image, scene, **known)
    assert said in unaware.verdict
    assert "The residual is noise" not in unaware.verdict
    along = tankrig.estimate(image, scene, nuisance={name: sd}, **known)
    found, error = along.nuisance[name]
    assert found == pytest.approx(size, abs=3.0 * error)
    assert error < size / 3.0
    off = np.abs(np.array(along.medium.coefficients) - scene.medium.coefficients)
    assert (off < 3.0 * np.sqrt(np.diag(along.covariance))[:3]).all()
    assert along.medium.sigma_s == pytest.approx(scene.medium.sigma_s, rel=0.005)


def test_a_clean_image_shows_nothing_astray(bench):
    scene, live, clean = bench
    noise = 0.002 * clean.max()
    quiet = 0
    for seed in range(6):
        image = clean + np.random.default_rng(seed).normal(0.0, noise, clean.shape)
        found = tankrig.estimate(image, scene, model=live, gain=1.0, offset=0.0, noise=noise)
        quiet += "The residual shows" not in found.verdict
    assert quiet >= 5


@cache
def lit_by(kind):
    """A plain scene, and its image along other paths than a fit's."""
    beams = (Beam((-14.0, -6.0), (54.0, 62.0)), Beam((10.0, 18.0), (54.0, 62.0)))
    light = Projector(kind, beams, None if kind == "collimated" else (-400.0, 0.0, 58.0))
    scene = Scene(Tank(), Medium(0.0012, 0.0108, 0.4), light, Camera("orthographic", (20, 30), 8.0))
    return scene, np.asarray(tank_image(scene, seed=91, batches=64).image, float)


@pytest.mark.parametrize(
    ("kind", "effect", "said"),
    [
        pytest.param("pinhole", "floor", "light that the floor reflects", marks=pytest.mark.long),
        pytest.param("collimated", "blur", "blur that the scene does not describe", marks=pytest.mark.long),
        ("collimated", None, None),
    ],
)
def test_what_moves_coefficients_is_named_where_the_residual_is_no_larger_than_noise(kind, effect, said):
    """By light paths: their noise was counted as if it were smooth, and hid a floor that moves σs by nine deviations.

    Blur of edges was looked for as if pixels themselves were blurred.
    """
    scene, image = lit_by(kind)
    if effect == "floor":
        shiny = replace(scene, tank=replace(scene.tank, faces=Faces(floor=Face("diffuse", 0.03))))
        image = image + by_faces(shiny, seed=99, lattices=8)
    elif effect == "blur":
        soft = replace(scene, camera=replace(scene.camera, blur=Blur(0.4)))
        image = image + low_orders(soft, 0.01, 1) - low_orders(scene, 0.01, 1)
    noise = 0.002 * image.max()
    seen = image + np.random.default_rng(4).normal(0.0, noise, image.shape)
    found = tankrig.estimate(seen, scene, gain=1.0, offset=0.0, noise=noise, phase="hg")
    assert "model does not hold" not in found.verdict
    assert ("The residual shows" in found.verdict) == (said is not None)
    if said is not None:
        assert f"The residual shows {said}" in found.verdict
    off = np.abs(np.array(found.medium.coefficients) - scene.medium.coefficients)
    assert (off < 2.0 * np.sqrt(np.diag(found.covariance))[:3]).all()
    assert found.covariance[1, 1] ** 0.5 < 0.015 * scene.medium.sigma_s  # as much as a cause moves, and no more


@pytest.mark.parametrize("sigma_mm", [0.3, 1.0])
def test_blur_is_fitted_along_as_it_bends(sigma_mm):
    """Light goes over edges in proportion to the blur, not to its square, where these are on edges of pixels."""
    scene, image = lit_by("collimated")
    soft = replace(scene, camera=replace(scene.camera, blur=Blur(sigma_mm)))
    gained = low_orders(soft, 0.01, 1) - low_orders(scene, 0.01, 1)
    astray, sizes = Astray(scene, {"blur_mm2": 0.1}), np.array([10.0 * sigma_mm**2])
    block = AstrayBlock((astray.at(scene.medium, image, sizes),), np.ones(1))
    told = block.added_in(0, {"astray": sizes}, scene.medium)
    assert apart(told, gained) < 0.25  # the rest is blur of the orders above, which is faint and smooth
    more = block.added_in(0, {"astray": 1.3 * sizes}, scene.medium)
    softer = replace(scene, camera=replace(scene.camera, blur=Blur(1.3**0.5 * sigma_mm)))
    assert apart(more - told, low_orders(softer, 0.01, 1) - low_orders(soft, 0.01, 1)) < 0.35


@pytest.mark.parametrize("described", [0.0, 0.01])
def test_a_halo_along_bends_with_its_width(described):
    """What a fit adds where it has found another width is what a lens of that width adds, and how it goes on."""
    scene, image = lit_by("collimated")
    lens = replace(scene.camera, halo=Halo(described, 20.0))
    scene = replace(scene, camera=lens)

    def seen(share, sigma_mm):
        spread = CameraLens.of(replace(scene, camera=replace(lens, halo=Halo(share, sigma_mm))))
        return image if spread is None else spread.of_wide(image)

    more = 0.02 - described
    at = Astray(scene, {"halo": 0.01}).at(
        scene.medium, seen(described, 20.0), np.array([more / 0.01, np.log(2.0) / 0.5])
    )
    assert list(at.sd) == ["halo", "halo_width"]
    block = AstrayBlock((at,), np.ones(2))
    sizes = np.array([more / 0.01, np.log(2.0) / 0.5])
    told = block.added_in(0, {"astray": sizes}, scene.medium)
    assert apart(told, seen(0.02, 40.0) - seen(described, 20.0)) < 0.05
    wider = block.added_in(0, {"astray": sizes + np.array([0.0, 0.2])}, scene.medium)
    assert apart(wider - told, seen(0.02, 40.0 * np.exp(0.1)) - seen(0.02, 40.0)) < 0.1


@pytest.mark.parametrize("width_mm", [15.0, 60.0])
def test_the_width_of_a_halo_is_fitted_along_with_it(bench, width_mm):
    """Taken as described, half or twice as wide as it is, it moved σs by −.2 and +.6 %, five deviations of noise."""
    scene, live, clean = bench
    image = CameraLens.of(replace(scene, camera=replace(scene.camera, halo=Halo(0.02, width_mm)))).of_wide(clean)
    noise = 0.002 * clean.max()
    image = image + np.random.default_rng(3).normal(0.0, noise, clean.shape)
    found = tankrig.estimate(image, scene, 1.0, 0.0, noise, model=live, nuisance={"halo": 0.02})
    share, share_sd = found.nuisance["halo"]
    wider, wider_sd = found.nuisance["halo_width"]
    assert share == pytest.approx(0.02, abs=3.0 * share_sd)
    assert wider == pytest.approx(np.log(width_mm / scene.camera.halo.sigma_mm), abs=3.0 * wider_sd)
    assert wider_sd < 0.25
    assert "The residual shows" not in found.verdict
    off = np.abs(np.array(found.medium.coefficients) - scene.medium.coefficients)
    assert (off < 3.0 * np.sqrt(np.diag(found.covariance))[:3]).all()
    assert found.medium.sigma_s == pytest.approx(scene.medium.sigma_s, rel=0.005)


@pytest.mark.long
@pytest.mark.parametrize(("width_mm", "said"), [(60.0, "narrower"), (15.0, "wider")])
def test_a_halo_that_is_described_with_another_width_is_named(width_mm, said):
    scene, image = lit_by("collimated")
    lens = replace(scene.camera, halo=Halo(0.02, 30.0))
    seen = CameraLens.of(replace(scene, camera=lens)).of_wide(image)
    noise = 0.002 * image.max()
    seen = seen + np.random.default_rng(4).normal(0.0, noise, image.shape)
    told = replace(scene, camera=replace(lens, halo=Halo(0.02, width_mm)))
    found = tankrig.estimate(seen, told, gain=1.0, offset=0.0, noise=noise, phase="hg")
    assert f"a {said} halo of the camera's lens" in found.verdict
    off = np.abs(np.array(found.medium.coefficients) - scene.medium.coefficients)
    assert (off < 2.0 * np.sqrt(np.diag(found.covariance))[:3]).all()


def test_patterns_of_another_width_are_what_a_scene_of_that_width_has_more():
    """Of a pane and of the projector's halo, which are looked for where a scene has them and nowhere else."""
    scene, image = lit_by("collimated")
    light, tank = scene.projector, scene.tank
    ideal = causes(scene, image)
    assert not any("halo of the projector" in name or "entry pane" in name for name in ideal if "reflects" not in name)
    panes = {mm: replace(scene, tank=replace(tank, faces=Faces(Face("glass", thickness_mm=mm)))) for mm in (3.0, 6.0)}
    ((thicker),) = causes(panes[3.0], image)["a thicker entry pane"]()
    more = by_faces(panes[6.0], seed=99, lattices=8) - by_faces(panes[3.0], seed=99, lattices=8)
    assert apart(3.0 * thicker, more) < 0.6  # by four lattices of paths and by eight
    assert 0.6 < 3.0 * float(np.sum(thicker * more) / np.sum(more**2)) < 1.2
    halos = {mm: replace(scene, projector=replace(light, halo=Halo(0.1, mm))) for mm in (15.0, 30.0)}
    ((wider),) = causes(halos[15.0], image)["a wider halo of the projector's lens"]()
    whole = {mm: np.asarray(tank_image(one, 0.05, seed=5, batches=6).image, float) for mm, one in halos.items()}
    assert apart(wider, whole[30.0] - whole[15.0]) < 0.3
    assert causes(as_found(scene, {"pane": 1.0}), image).keys() >= {"a thicker entry pane"}
    assert "a thinner entry pane" not in causes(as_found(scene, {"pane": 1.0}), image)  # without thickness none is


def looks(kind):
    """Pattern of a veil on a bright image, and of ink that is uneven in five ways."""
    y, x = np.linspace(-1.0, 1.0, 30)[:, None], np.linspace(-1.0, 1.0, 40)
    image = np.exp(-x - 0.5 * y**2)
    return {"veil": [image.mean() - image], "uneven": [image * way for way in (x, y, x**2, y**2, x * y)]}[kind]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["veil", "uneven"])
def test_the_likelier_cause_is_named_not_the_one_with_more_terms(kind, seed):
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (30, 40))
    true = 3.0 * looks(kind)[0]
    causes = {"uneven": lambda: looks("uneven"), "veil": lambda: looks("veil")}

    def flat(changes):
        return changes.reshape(len(changes), -1)

    found = likely_cause((noise + true).ravel(), flat, causes, {"veil": (0.0, 10.0)})
    assert found[0].name == kind
    less = likely_cause((noise - 3.0 * looks("veil")[0]).ravel(), flat, causes, {"veil": (0.0, 10.0)})
    assert "veil" not in [one.name for one in less]  # there is no veil of less than nothing
