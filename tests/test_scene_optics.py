"""What a scene says of lenses and walls: what is written is read again, and what cannot be is refused."""

import tomllib
from dataclasses import replace

import pytest

from tankrig.errors import SceneError
from tankrig.scene.loading import scene_from_table
from tankrig.scene.optics import Face, Faces
from tankrig.scene.writing import scene_text

SCENE = """
[tank]
size_mm = [240.0, 160.0, 120.0]
surface = "fresnel"
[tank.faces]
entry = { kind = "glass", thickness_mm = 6.0 }
floor = { kind = "diffuse", reflectance = 0.04 }
[medium]
sigma_a = 0.0002
sigma_s = 0.0198
g = 0.5
[projector]
kind = "pinhole"
position_mm = [-400.0, 0.0, 60.0]
beams = [ { y_mm = [-2.0, 2.0], z_mm = [58.0, 62.0], irradiance = 1.0 } ]
blur = { sigma_mm = 0.3 }
halo = { share = 0.02, sigma_mm = 20.0 }
wide_lens = { diameter_mm = 16.0, focus_mm = 100.0 }
black_level = 0.001
[camera]
kind = "orthographic"
shape = [80, 120]
pixel_mm = 2.0
blur = { sigma_mm = 0.4, corner_mm = 0.6 }
halo = { share = 0.01, sigma_mm = 25.0 }
veil = 0.01
"""


def test_what_is_written_is_read_as_the_same_scene():
    scene = scene_from_table(tomllib.loads(SCENE), "scene.toml")
    assert scene_from_table(tomllib.loads(scene_text(scene)), "again") == scene
    black = replace(scene, tank=replace(scene.tank, faces=Faces(floor=Face("diffuse", 0.0))))
    assert scene_from_table(tomllib.loads(scene_text(black)), "again") == black


@pytest.mark.parametrize(
    ("said", "instead", "named"),
    [
        ("thickness_mm = 6.0", "thickness_mm = -1.0", "tank.faces.entry.thickness_mm = -1.0 is thinner than nothing"),
        ("reflectance = 0.04", "reflectance = 1.2", "tank.faces.floor.reflectance = 1.2 is outside 0 … 1"),
        (", reflectance = 0.04", "", 'key "tank.faces.floor.reflectance" is missing; add it'),
        ("share = 0.01", "share = 0.3", "camera.halo.share = 0.3 is outside 0 … 0.2"),
        ("share = 0.02", "share = -0.1", "projector.halo.share = -0.1 is outside 0 … 0.2"),
        ("sigma_mm = 0.4", "sigma_mm = 5.0", "camera.blur of 5 mm is wider than the beams, 4 mm"),
        ("sigma_mm = 0.3", "sigma_mm = 9.0", "projector.blur of 9 mm is wider than the beams, 4 mm"),
        ("veil = 0.01", "veil = 2.0", "camera.veil = 2.0 is outside 0 … 0.5"),
        ("black_level = 0.001", "black_level = -1.0", "projector.black_level = -1.0 is negative"),
        ('kind = "diffuse"', 'kind = "matt"', "tank.faces.floor.kind"),
        ("focus_mm = 100.0", "focus_mm = 500.0", "projector.wide_lens.focus_mm = 500 is behind the tank"),
        (
            "diameter_mm = 16.0",
            "diameter_mm = 401.0",
            "projector.wide_lens.diameter_mm = 401 is wider than the lens",
        ),
        ("sigma_mm = 25.0", "sigma_mm = 1e6", "camera.halo.sigma_mm = 1e+06 is above 2400 mm, far wider than the tank"),
        ("sigma_mm = 20.0", "sigma_mm = 2401", "projector.halo.sigma_mm = 2401 is above 2400 mm, far wider than the"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(said, instead, named):
    with pytest.raises(SceneError) as error:
        scene_from_table(tomllib.loads(SCENE.replace(said, instead)), "scene.toml")
    assert named in str(error.value)
    assert str(error.value).startswith("scene.toml: ")
    assert "\n" not in str(error.value)
