"""A scene file is read as it was meant, or refused in one sentence that says what to mend."""

from pathlib import Path

import numpy as np
import pytest

import tankrig
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

REFERENCE = Path(__file__).parent / "data" / "reference"

GOOD = """
[tank]
size_mm = [240.0, 160.0, 120.0]
surface = "matched"
refractive_index = 1.33
[medium]
sigma_a = 0.0002
sigma_s = 0.0198
g = 0.5
[projector]
kind = "pinhole"
position_mm = [-400.0, 0.0, 60.0]
beams = [
  { y_mm = [-42.0, -38.0], z_mm = [58.0, 62.0], irradiance = 1.0 },
  { y_mm = [-2.0, 2.0], z_mm = [58.0, 62.0], irradiance = 0.5 },
]
[camera]
kind = "pinhole"
position_mm = [120.0, 0.0, 620.0]
shape = [80, 120]
pixel_mm = 2.0
"""

WRONG = [  # (what stands in the good file, what stands there instead, what the sentence must say)
    # impossible values
    ("sigma_s = 0.0198", "sigma_s = -0.1", "medium.sigma_s = -0.1 is negative; give"),
    ("sigma_a = 0.0002", "sigma_a = -1", "medium.sigma_a = -1.0 is negative; give"),
    ("sigma_s = 0.0198", "sigma_s = nan", "medium.sigma_s = nan is not a finite number; give"),
    ("sigma_s = 0.0198", "sigma_s = -inf", "medium.sigma_s = -inf is not a finite number; give"),
    ("sigma_s = 0.0198", "sigma_s = 1" + "0" * 400, "medium.sigma_s = inf is not a finite number; give"),
    ("g = 0.5", "g = 1.0", "medium.g = 1.0 is outside −1 < g < 1; give"),
    ("g = 0.5", "g = -1.0", "medium.g = -1.0 is outside −1 < g < 1; give"),
    ("g = 0.5", "g = nan", "medium.g = nan is not a finite number; give"),
    ("[240.0, 160.0, 120.0]", "[240.0, 0.0, 120.0]", "tank.size_mm = [240.0, 0.0, 120.0] has a side that is not"),
    ("[240.0, 160.0, 120.0]", "[240.0, inf, 120.0]", "tank.size_mm[1] = inf is not a finite number; give"),
    ("refractive_index = 1.33", "refractive_index = 0.5", "tank.refractive_index = 0.5 is outside 1…3; water has"),
    ("y_mm = [-42.0, -38.0]", "y_mm = [-92.0, -38.0]", "projector.beams[0].y_mm = [-92.0, -38.0] leaves the tank"),
    ("[58.0, 62.0], irradiance = 0.5", "[58.0, 121.0], irradiance = 0.5", "beams[1].z_mm = [58.0, 121.0] leaves"),
    ("y_mm = [-42.0, -38.0]", "y_mm = [-38.0, -42.0]", "projector.beams[0].y_mm = [-38.0, -42.0] has no width; give"),
    ("y_mm = [-42.0, -38.0]", "y_mm = [nan, -38.0]", "projector.beams[0].y_mm[0] = nan is not a finite number; give"),
    ("irradiance = 0.5", "irradiance = -0.5", "projector.beams[1].irradiance = -0.5 is negative; give"),
    ("[-400.0, 0.0, 60.0]", "[4.0, 0.0, 60.0]", "projector.position_mm = [4.0, 0.0, 60.0] is not outside the wall"),
    ("[120.0, 0.0, 620.0]", "[120.0, 0.0, 62.0]", "camera.position_mm = [120.0, 0.0, 62.0] is not above the water"),
    ("shape = [80, 120]", "shape = [0, 120]", "camera.shape = [0, 120] is no picture; give"),
    ("shape = [80, 120]", "shape = [80, 1000000]", "camera.shape = [80, 1000000] is no picture; give"),
    ("pixel_mm = 2.0", "pixel_mm = 0.0", "camera.pixel_mm = 0.0 is not positive; give"),
    # values of the wrong kind
    ("sigma_s = 0.0198", 'sigma_s = "0.0198"', 'medium.sigma_s = "0.0198" is not a number; give one'),
    ("sigma_s = 0.0198", "sigma_s = true", "medium.sigma_s = true is not a number; give one"),
    ("sigma_s = 0.0198", "sigma_s = 2026-11-20", 'medium.sigma_s = "2026-11-20" is not a number; give one'),
    ("[240.0, 160.0, 120.0]", "240.0", "tank.size_mm = 240.0 is not an array; put"),
    ("[240.0, 160.0, 120.0]", "[240.0, 160.0]", "tank.size_mm = [240.0, 160.0] has too few entries; add"),
    (
        "[240.0, 160.0, 120.0]",
        "[1.0, 2.0, 3.0, 4.0]",
        "tank.size_mm = [1.0, 2.0, 3.0, 4.0] has too many entries; remove",
    ),
    ('"matched"', '"mached"', 'tank.surface = "mached" is unknown; use "matched" or "fresnel"'),
    ("shape = [80, 120]", "shape = [80.5, 120]", "camera.shape[0] = 80.5 is not a whole number; give"),
    # missing, misspelt and unknown keys
    ("g = 0.5", "", 'key "medium.g" is missing; add'),
    ("size_mm = [240.0, 160.0, 120.0]", "", 'key "tank.size_mm" is missing; add'),
    ('surface = "matched"', "", 'key "tank.surface" is missing; add'),
    (", irradiance = 0.5", "", 'key "projector.beams[1].irradiance" is missing; add'),
    ("position_mm = [-400.0, 0.0, 60.0]", "", "projector.position_mm is missing; a pinhole projector needs"),
    ("position_mm = [120.0, 0.0, 620.0]", "", "camera.position_mm is missing; a pinhole camera needs"),
    ("sigma_s = 0.0198", "sigmas = 0.0198", 'key "medium.sigmas" is unknown; did you mean "sigma_s"?'),
    (
        "z_mm = [58.0, 62.0], irradiance = 0.5",
        "zmm = [1, 2], irradiance = 1",
        'beams[1].zmm" is unknown; did you mean "z',
    ),
    ("[medium]", "[meduim]", 'key "meduim" is unknown; did you mean "medium"?'),
    ("g = 0.5", "g = 0.5\nturbidity = 3", 'key "medium.turbidity" is unknown; remove it'),
    ("[tank]", "units = 'mm'\n[tank]", 'key "units" is unknown; remove it'),
    ("[tank]", "source = 'elsewhere'\n[tank]", 'key "source" is unknown; remove it'),
    # not TOML
    ("g = 0.5", "g = ", "is not TOML (Invalid value (at line"),
    ("g = 0.5", "g = 0.5\ng = 0.6", "is not TOML"),
    ("g = 0.5", "g = " + "1" * 5000, "is not TOML"),
    ("[80, 120]", "[" * 5000, "is not TOML"),
]


@pytest.mark.parametrize(("before", "after", "said"), WRONG, ids=[said[:50] for _, _, said in WRONG])
def test_a_wrong_file_is_refused_naming_file_key_value_and_remedy(
    tmp_path: Path, before: str, after: str, said: str
) -> None:
    assert before in GOOD
    file = tmp_path / "scene.toml"
    file.write_text(GOOD.replace(before, after, 1), encoding="utf-8")
    with pytest.raises(tankrig.SceneError) as caught:
        tankrig.load_scene(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("field", "table"),
    [("tank", 5), ("projector", "pinhole"), ("camera", [])],
)
def test_a_table_that_is_no_table_is_refused(tmp_path: Path, field: str, table: object) -> None:
    lines, skipping = [f"{field} = {table!r}"], False
    for line in GOOD.splitlines():
        skipping = line == f"[{field}]" if line.startswith("[") else skipping
        if not skipping:
            lines.append(line)
    file = tmp_path / "scene.toml"
    file.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(tankrig.SceneError, match=rf"{field} = .* is not a table; give its keys and values"):
        tankrig.load_scene(file)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(tankrig.SceneError, match=r"nowhere\.toml: cannot be read \(No such file.*\); give the path"):
        tankrig.load_scene(tmp_path / "nowhere.toml")
    with pytest.raises(tankrig.SceneError, match=r"cannot be read \(Is a directory\); give the path"):
        tankrig.load_scene(tmp_path)
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    with pytest.raises(tankrig.SceneError, match=r"picture\.png: is not text, so not a scene file; give"):
        tankrig.load_scene(picture)
    (tmp_path / "empty.toml").touch()
    with pytest.raises(tankrig.SceneError, match='key "tank" is missing; add it'):
        tankrig.load_scene(tmp_path / "empty.toml")


def test_a_good_file_is_read_as_written(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text("\ufeff" + GOOD, encoding="utf-8")  # as some editors save it, with a byte-order mark
    scene = tankrig.load_scene(file)
    assert scene == Scene(
        Tank((240.0, 160.0, 120.0), "matched", 1.33),
        Medium(0.0002, 0.0198, 0.5),
        Projector(
            "pinhole",
            (Beam((-42.0, -38.0), (58.0, 62.0), 1.0), Beam((-2.0, 2.0), (58.0, 62.0), 0.5)),
            (-400.0, 0.0, 60.0),
        ),
        Camera("pinhole", (80, 120), 2.0, (120.0, 0.0, 620.0)),
    )
    assert scene.source == str(file)


@pytest.mark.parametrize("file", sorted(REFERENCE.glob("*.toml")), ids=lambda file: file.stem)
def test_reference_scenes_say_what_their_images_were_made_with(file: Path) -> None:
    scene = tankrig.load_scene(file)
    with np.load(file.with_suffix(".npz")) as data:
        sigma_t, albedo, g, surface_index = data["params"]
        assert scene.camera.shape == data["total"].shape
    medium = scene.medium
    np.testing.assert_allclose([medium.sigma_t, medium.albedo, medium.g], [sigma_t, albedo, g], rtol=1e-9)
    assert scene.tank.surface_index == surface_index


def test_keys_that_do_not_matter_are_ignored(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    text = GOOD.replace('kind = "pinhole"', 'kind = "collimated"', 1).replace("-400.0", "400.0")
    file.write_text(text, encoding="utf-8")
    assert tankrig.load_scene(file).projector.kind == "collimated"


def test_overlapping_beams_and_pixels_beyond_the_tank_are_allowed(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(GOOD.replace("[-42.0, -38.0]", "[-3.0, 0.0]").replace("[80, 120]", "[200, 300]"), encoding="utf-8")
    assert tankrig.load_scene(file).camera.shape == (200, 300)


def test_scenes_made_in_python_are_checked_too_and_can_be_compared_and_hashed() -> None:
    """Lists and NumPy numbers are as good as tuples and floats; what no file may say, Python may not either."""
    tank = Tank([240, 160, np.float32(120)])
    assert tank == Tank((240.0, 160.0, 120.0))
    assert hash(tank) == hash(Tank((240.0, 160.0, 120.0)))
    with pytest.raises(tankrig.SceneError, match=r"size_mm = \[240.0, 160.0\] has 2 numbers; give 3"):
        Tank((240.0, 160.0))
    with pytest.raises(tankrig.SceneError, match=r"g = 'half' is not a finite number"):
        Medium(0.0, 0.0, "half")
    with pytest.raises(tankrig.SceneError, match=r"beams = \[\] lights nothing"):
        Projector("collimated", ())
