"""Rough models that a search looks at where rays slant: they show light and not its noise, and steps end in that."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tankrig.estimation.astray_patterns import black_level, blur, blur_of_moved_light
from tankrig.estimation.followed import Followed
from tankrig.estimation.forward import models_of
from tankrig.estimation.light_beside import described_beside
from tankrig.estimation.optimiser import solve
from tankrig.estimation.problem import Problem
from tankrig.light.tangent import BY_PATHS, tank_steady, tank_tangent
from tankrig.light.tank import tank_image
from tankrig.prediction import Prediction
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.optics import Halo

Array = NDArray[np.float64]

LIQUIDS = {"forward": Medium(0.001, 0.0074, 0.86), "nearly even": Medium(0.0005, 0.0097, 0.1)}


def seen_by_pinholes(liquid: Medium, rows: int = 40) -> Scene:
    """A ray of light from one viewpoint, seen from another."""
    light = Projector("pinhole", (Beam((-4.0, 4.0), (58.0, 62.0)),), position_mm=(-350.0, 0.0, 56.0))
    camera = Camera("pinhole", (rows, rows * 3 // 2), 160.0 / rows, position_mm=(120.0, 0.0, 500.0))
    return Scene(Tank(), liquid, light, camera)


def off(found: Array, true: Array) -> float:
    """By how much an image differs from the true one, over the L2 norm of that."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


@pytest.mark.parametrize("liquid", LIQUIDS.values(), ids=LIQUIDS.keys())
def test_a_search_looks_at_light_and_not_at_its_noise(liquid: Medium) -> None:
    """By two lattices half of the image was noise, its derivatives had nothing to do with its changes, and a search
    ended anywhere: at g .31 where it was .86."""
    scene = seen_by_pinholes(liquid)
    look = models_of(scene, "tank", None).look
    assert look is not None
    rough = look[1]
    assert isinstance(rough, Followed)
    assert off(rough(liquid).image, np.asarray(tank_image(scene, 0.02).image)) < 0.12
    step = 0.02
    changed = rough(replace(liquid, g=liquid.g + step)).image - rough(replace(liquid, g=liquid.g - step)).image
    slope = rough.slopes(liquid)[2]
    alike = float(np.sum(changed * slope) / np.linalg.norm(changed) / np.linalg.norm(slope))
    assert alike > 0.8
    assert float(np.linalg.norm(changed)) == pytest.approx(2.0 * step * float(np.linalg.norm(slope)), rel=0.4)


def test_light_beside_the_beams_is_looked_at_as_light_too() -> None:
    """A halo is drawn on coarse cells there, which by themselves are a quarter of it off where a ray is narrow."""
    liquid = LIQUIDS["nearly even"]
    scene = seen_by_pinholes(liquid, rows=10)
    scene = replace(scene, projector=replace(scene.projector, halo=Halo(0.02, 28.0), black_level=1e-3))
    (_, rough), (_, fine) = described_beside(scene, rough=True), described_beside(scene)
    halo, dark = (
        off(looked_at.told(liquid)[0], fitted.told(liquid)[0])
        for (_, looked_at), (_, fitted) in zip(rough.parts, fine.parts, strict=True)
    )
    assert dark < 0.05
    assert halo < 0.27


def test_light_of_a_dark_picture_is_left_to_the_paths_where_rays_slant() -> None:
    scene = seen_by_pinholes(LIQUIDS["forward"], rows=20)
    _, width, height = scene.tank.size_mm
    wall = (Beam((-0.5 * width, 0.5 * width), (0.0, height)),)
    lit = replace(scene, projector=replace(scene.projector, beams=wall))
    assert off(black_level(scene, np.zeros(scene.camera.shape)), np.asarray(tank_image(lit, 0.02).image)) < 0.05


@pytest.mark.parametrize("liquid", LIQUIDS.values(), ids=LIQUIDS.keys())
def test_a_rough_pattern_of_blur_tells_whether_there_may_be_any(liquid: Medium) -> None:
    """One that is no more like it than what is smooth gains, .6 here, would miss blur of four standard deviations."""
    scene = seen_by_pinholes(liquid)
    image = np.asarray(tank_image(scene, 0.05).image)
    own, rough = blur(scene, image), blur_of_moved_light(scene, image)
    assert float(np.sum(own * rough) / np.linalg.norm(own) / np.linalg.norm(rough)) > 0.85
    assert 0.5 < float(np.linalg.norm(rough) / np.linalg.norm(own)) < 1.5


def require_same(alone: Prediction, with_derivatives: Prediction) -> None:
    """Complain about another image, or another error of it."""
    peak = float(with_derivatives.image.max())
    np.testing.assert_allclose(alone.image, with_derivatives.image, rtol=1e-9, atol=1e-12 * peak)
    np.testing.assert_allclose(alone.stderr, with_derivatives.stderr, rtol=1e-6)


def test_an_image_without_its_derivatives_is_the_same_image() -> None:
    scene = seen_by_pinholes(LIQUIDS["forward"])
    with_them = Followed(scene, 4, 1, None)
    require_same(replace(with_them, alone=True)(scene.medium), with_them(scene.medium))
    require_same(tank_steady(scene, 4, tables=BY_PATHS), tank_tangent(scene, 4, tables=BY_PATHS).prediction)


def asked(noisy: bool) -> int:
    """How often a model is asked before a step gives up whose derivatives point the wrong way."""
    looks = []

    @dataclass
    class Misled:
        coordinates: Array

        def __post_init__(self) -> None:
            looks.append(self.coordinates)
            self.residual = np.array([10.0 + 0.3 * self.coordinates[0], 1.0])
            self.jacobian = np.array([[-0.3], [0.0]])
            self.cost = 0.5 * float(self.residual @ self.residual)

    wide = np.full(1, 5.0)
    rest = {"longest_step": wide, "quick": False, "least_damping": 0.0, "noisy": noisy}
    problem = SimpleNamespace(at=Misled, box=(-wide, wide), **rest)
    end = solve(cast(Problem, problem), np.zeros(1), 0.02, 30)
    assert end.coordinates == [0.0]
    return len(looks)


def test_steps_end_soon_where_derivatives_do_not_agree_with_noisy_images() -> None:
    """Each costs an image, and a fit with pinholes spent half of its time on steps that led nowhere."""
    assert asked(noisy=True) <= 4 < 8 <= asked(noisy=False)
