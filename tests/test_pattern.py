"""Patterns show what they promise, pixel by pixel, and light the wall where the model is told they do."""

import cv2
import numpy as np
import pytest

from tankrig import SequenceError
from tankrig.pattern import Pattern
from tankrig.pattern.kinds import (
    Checker,
    Dark,
    Full,
    GrayCode,
    Hadamard,
    ImageFile,
    PhaseShift,
    Rays,
    Sheet,
    Stripes,
    draw,
    gray_code_series,
)
from tankrig.pattern.wall import Wall
from tankrig.scene.description import Beam, Tank

WALL = Wall(shape=(120, 160), y_mm=(-80.0, 80.0), z_mm=(0.0, 120.0))
FINE = Wall(shape=(768, 1024), y_mm=(-85.0, 85.0), z_mm=(-4.0, 123.5))


def painted(wall: Wall, beams: tuple[Beam, ...]) -> np.ndarray:
    """Irradiance at the centre of each pixel."""
    z, y = np.meshgrid(wall.z_centres_mm, wall.y_centres_mm, indexing="ij")
    total = np.zeros(wall.shape)
    for beam in beams:
        inside = (y > beam.y_mm[0]) & (y < beam.y_mm[1]) & (z > beam.z_mm[0]) & (z < beam.z_mm[1])
        total += inside * beam.irradiance
    return total


def test_a_dark_pattern_has_no_beams_and_a_full_one_has_one():
    assert WALL.beams(draw(Dark(), WALL)) == ()
    assert WALL.beams(draw(Full(), WALL)) == (Beam((-80.0, 80.0), (0.0, 120.0), 1.0),)


def test_the_reference_patterns_light_exactly_what_the_reference_images_were_made_with():
    """Sheet, three beams and seven stripes of the reference cases; a pixel's error would bias every fit."""
    z_mm = (58.0, 62.0)
    assert WALL.beams(draw(Sheet((-60.0, 60.0), z_mm), WALL)) == (Beam((-60.0, 60.0), z_mm, 1.0),)
    rays = WALL.beams(draw(Rays((-40.0, 0.0, 40.0), z_mm), WALL))
    assert [beam.y_mm for beam in rays] == [(-42.0, -38.0), (-2.0, 2.0), (38.0, 42.0)]
    stripes = WALL.beams(draw(Stripes(16.0, y_mm=(-60.0, 60.0), z_mm=z_mm), WALL))
    assert [beam.y_mm for beam in stripes] == [(16.0 * k - 4, 16.0 * k + 4) for k in range(-3, 4)]


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_beams_repaint_any_picture(gamma):
    """Merging rectangles must neither lose, add nor move light, whatever the picture."""
    wall = Wall(shape=(23, 31), y_mm=(40.0, -53.0), z_mm=(10.0, 79.0), irradiance=3.0, gamma=gamma)
    chance = np.random.default_rng(3)
    pixels = chance.choice(np.array([0, 0, 90, 255], np.uint8), wall.shape)
    pixels[5:9] = pixels[5]
    beams = wall.beams(Pattern("random", pixels))
    np.testing.assert_allclose(painted(wall, beams), 3.0 * (pixels / 255.0) ** gamma, rtol=1e-12)
    power = 3.0 * ((pixels / 255.0) ** gamma).sum() * np.prod(wall.pixel_mm)
    assert sum(beam.power for beam in beams) == pytest.approx(power, rel=1e-12)


def test_beams_are_cut_at_the_tank():
    tank = Tank(size_mm=(240.0, 160.0, 120.0))
    assert FINE.beams(draw(Full(), FINE), tank) == (Beam((-80.0, 80.0), (0.0, 120.0), 1.0),)


def test_a_pattern_of_another_projector_is_refused():
    with pytest.raises(SequenceError, match=r'pattern "full" has shape \[120, 160\] and the projector \[768, 1024\]'):
        FINE.beams(draw(Full(), WALL))


def test_gray_code_numbers_every_column_and_row_and_neighbours_differ_in_one_bit():
    series = gray_code_series(FINE)
    assert len(series) == 40
    for axis, count in (("columns", 1024), ("rows", 768)):
        bits = [draw(code, FINE).pixels for code in series if code.axis == axis and not code.inverse]
        inverse = [draw(code, FINE).pixels for code in series if code.axis == axis and code.inverse]
        assert all((a ^ b == 255).all() for a, b in zip(bits, inverse, strict=True))
        gray = np.stack([picture[0] if axis == "columns" else picture[:, 0] for picture in bits]) > 0
        assert (np.abs(np.diff(gray.astype(int), axis=1)).sum(axis=0) == 1).all()
        binary = np.logical_xor.accumulate(gray, axis=0)
        assert (binary.T @ (1 << np.arange(len(bits))[::-1]) == np.arange(count)).all()


def test_phase_shift_gives_back_its_phase():
    pictures = np.stack([draw(PhaseShift(32.0, step, 4), FINE).pixels[0] for step in range(4)]).astype(float)
    shifts = 2 * np.pi * np.arange(4) / 4
    phase = np.arctan2(np.sin(shifts) @ pictures, np.cos(shifts) @ pictures)
    expected = 2 * np.pi * np.arange(1024) / 32
    assert np.abs(np.angle(np.exp(1j * (phase - expected)))).max() < 0.01


def test_checkers_of_opposite_phase_fill_the_wall():
    one, other = (draw(Checker(3, inverse), FINE).pixels.astype(int) for inverse in (False, True))
    assert (one + other == 255).all()
    assert one[0, 0] == 255
    assert one[0, 3] == 0
    assert one[3, 3] == 255


def test_hadamard_patterns_are_orthogonal():
    wall = Wall(shape=(24, 40), y_mm=(-1.0, 1.0), z_mm=(0.0, 1.0))
    signs = np.stack([draw(Hadamard(index, 8), wall).pixels.ravel() > 0 for index in range(64)]) * 2.0 - 1
    np.testing.assert_array_equal(signs @ signs.T, np.eye(64) * wall.shape[0] * wall.shape[1])


def test_a_picture_comes_from_its_file_pixel_by_pixel(tmp_path):
    picture = np.random.default_rng(1).integers(0, 256, WALL.shape, np.uint8)
    file = tmp_path / "picture.png"
    cv2.imwrite(str(file), picture)
    np.testing.assert_array_equal(draw(ImageFile(str(file)), WALL).pixels, picture)
    with pytest.raises(SequenceError, match=r"picture\.png: has shape \[120, 160\].*projector's shape \[768, 1024\]"):
        draw(ImageFile(str(file)), FINE)
    with pytest.raises(SequenceError, match="does not exist"):
        draw(ImageFile(str(tmp_path / "none.png")), WALL)
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(SequenceError, match="not a picture"):
        draw(ImageFile(str(tmp_path / "text.png")), WALL)


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        (lambda: Full(level=0), "level = 0 is outside 1…255"),
        (lambda: Sheet((-60.0, 60.0), (130.0, 140.0)), r"z_mm = \[130, 140\] lights no pixel"),
        (lambda: Sheet((60.0, -60.0), (50.0, 60.0)), r"y_mm = \[60, -60\] has no width; give \[low, high\]"),
        (lambda: Rays((0.0,), (58.0, 62.0), width_mm=0.1), "lights no pixel"),
        (lambda: Rays((), (58.0, 62.0)), "y_mm is empty"),
        (lambda: Stripes(0.5), "finer than the projector's pixels"),
        (lambda: Stripes(16.0, duty=1.0), "duty = 1.0 is outside"),
        (lambda: Stripes(16.0, y_mm=(1.0, 3.0)), "no whole stripe fits"),
        (lambda: GrayCode(8), "bit = 8 is outside 0…7"),
        (lambda: PhaseShift(1.0, 0), "finer than the pixels"),
        (lambda: PhaseShift(16.0, 4), "step = 4 is outside"),
        (lambda: Checker(0), "no cell"),
        (lambda: Hadamard(0, 12), "no power of two"),
        (lambda: Hadamard(64, 8), "index = 64 is outside"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_a_sentence(kind, reason):
    with pytest.raises(SequenceError, match=reason):
        draw(kind(), WALL)
