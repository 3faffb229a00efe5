"""What a prediction promises: a tolerance that is kept or said not to be, errors that cover, no scene that crashes."""

from dataclasses import replace

import numpy as np
import pytest

from tankrig.light.double import double_scattering
from tankrig.light.single import single_scattering
from tankrig.montecarlo import simulate
from tests.stress_scenes import medium_of, relative, scene_of


@pytest.mark.parametrize("surface", ["matched", "fresnel"])
@pytest.mark.parametrize("above_mm", [1.0, 5.0, 30.0])
def test_a_camera_close_above_the_water_sees_a_finite_image(above_mm: float, surface: str) -> None:
    """Rows of pixels were counted from where lines meet that don't: the process died with a segmentation fault."""
    scene = scene_of(medium_of(1.0, 0.1, 0.5), "pinhole", surface=surface)
    camera = replace(scene.camera, position_mm=(36.0, -2.0, scene.tank.size_mm[2] + above_mm))
    scene = replace(scene, camera=camera)
    truth = simulate(scene, 2_000).orders[1]
    for order, image in ((1, single_scattering(scene)), (2, double_scattering(scene, 0.01))):
        assert np.isfinite(image).all(), order
        assert image.min() >= 0.0, order
        assert image.max() > 0.0, order
    assert relative(single_scattering(scene), truth) < 0.05
