"""Images from files: every kind that people have reads back exactly, everything else is refused in words."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from tankrig.bounded_reading import pages
from tankrig.errors import ImageError
from tankrig.image.reading import read_image

COUNTS = (np.arange(600).reshape(20, 30) * 100).astype(np.uint16)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "A.TIFF"])
def test_sixteen_bit_pictures_keep_every_count(tmp_path: Path, name: str) -> None:
    """A reader that halves the bit depth loses the dim light that tells σa."""
    cv2.imwrite(str(tmp_path / name), COUNTS)
    assert (read_image(tmp_path / name) == COUNTS).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_floating_point_tiff_keeps_its_values(tmp_path: Path, kind: type) -> None:
    """Calibrated images are floating point; rounding them would be noise."""
    values = (COUNTS / 7.0).astype(kind)
    cv2.imwrite(str(tmp_path / "a.tif"), values)
    assert (read_image(tmp_path / "a.tif") == values).all()


def test_scale_turns_counts_into_radiance(tmp_path: Path) -> None:
    """With a known scale the gain is known, which is worth a factor of ten on σa."""
    np.save(tmp_path / "a.npy", COUNTS)
    assert np.allclose(read_image(tmp_path / "a.npy", scale=2e-8), COUNTS * 2e-8, rtol=1e-15)


def test_a_preview_beside_a_picture_is_no_second_one(tmp_path: Path) -> None:
    """Cameras' programs put a smaller copy into the file; its kind, field 254, says so."""
    for file in (tmp_path / "two.tif", tmp_path / "preview.tif"):
        cv2.imwritemulti(str(file), [COUNTS, COUNTS // 2])
    data = bytearray((tmp_path / "preview.tif").read_bytes())
    assert data[:2] == b"II"
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    (second,) = struct.unpack_from("<I", data, first + 2 + 12 * count)
    (fields,) = struct.unpack_from("<H", data, second)
    places = [second + 2 + 12 * number for number in range(fields)]
    kind = next((place for place in places if struct.unpack_from("<H", data, place) == (254,)), places[0])
    struct.pack_into("<HHII", data, kind, 254, 4, 1, 1)
    (tmp_path / "preview.tif").write_bytes(data)
    np.testing.assert_array_equal(read_image(tmp_path / "preview.tif"), COUNTS)
    assert (pages(tmp_path / "two.tif"), pages(tmp_path / "preview.tif")) == (2, 1)
    (tmp_path / "circle.tif").write_bytes(data[: first + 2 + 12 * count] + struct.pack("<I", first) + data[second:])
    assert pages(tmp_path / "circle.tif") == 1000, "which are as many as are counted"


def test_npz_gives_the_array_asked_for(tmp_path: Path) -> None:
    """Predictions hold many arrays; fitting order 1 for the whole would be silently wrong."""
    np.savez(tmp_path / "many.npz", total=COUNTS, order1=COUNTS // 2, params=np.zeros(3))
    np.savez(tmp_path / "one.npz", frame=COUNTS, x_mm=np.zeros(30))
    assert (read_image(tmp_path / "many.npz") == COUNTS).all()
    assert (read_image(tmp_path / "many.npz", "order1") == COUNTS // 2).all()
    assert (read_image(tmp_path / "one.npz") == COUNTS).all()


def test_npz_lists_its_images_where_it_must_be_told(tmp_path: Path) -> None:
    """Who mistypes an array's name needs to see the names there are."""
    np.savez(tmp_path / "two.npz", left=COUNTS, right=COUNTS, params=np.zeros(3))
    for array in (None, "total", "params"):
        with pytest.raises(ImageError, match="left, right"):
            read_image(tmp_path / "two.npz", array)


def write(path: Path) -> None:
    """Write the broken file that `path`'s stem names."""
    whole = {".png": cv2.imencode(".png", COUNTS)[1], ".tif": cv2.imencode(".tif", COUNTS)[1]}
    suffix = path.suffix
    if path.stem == "eight bits":
        np.save(path, COUNTS.astype(np.uint8)) if suffix == ".npy" else cv2.imwrite(str(path), COUNTS.astype(np.uint8))
    elif path.stem == "colour":
        cv2.imwrite(str(path), np.dstack([COUNTS] * 3))
    elif path.stem == "cut":
        path.write_bytes(whole[suffix].tobytes()[:-200])
    elif path.stem == "empty":
        path.write_bytes(b"")
    elif path.stem == "text":
        path.write_text("not an image, whatever its name says")
    elif path.stem == "objects":
        np.save(path, np.array([{}]), allow_pickle=True)
    elif path.stem == "complex":
        np.save(path, COUNTS + 1j)
    elif path.stem == "cube":
        np.save(path, np.ones((2, 3, 4)))
    elif path.stem == "folder":
        path.mkdir()
    elif path.stem == "two":
        cv2.imwritemulti(str(path), [COUNTS, COUNTS // 2])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.png", "No such file"),
        ("folder.tif", "is a folder; give an image file in it"),
        ("photo.jpg", "convert"),
        ("eight bits.png", "8 bits"),
        ("eight bits.tif", "8 bits"),
        ("eight bits.npy", "8 bits"),
        ("colour.png", "one channel"),
        ("cube.npy", "one channel"),
        ("cut.png", "damaged"),
        ("cut.tif", "damaged"),
        ("empty.png", "damaged"),
        ("empty.npz", "damaged"),
        ("text.npy", "damaged"),
        ("text.npz", "damaged"),
        ("objects.npy", "damaged"),
        ("complex.npy", "real numbers"),
        ("two.tif", "holds 2 pictures, and nobody said which"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_sentence(tmp_path: Path, name: str, words: str) -> None:
    """A traceback, or worse a picture of zeros, would leave the person at the bench to guess."""
    write(tmp_path / name)
    with pytest.raises(ImageError, match=words) as caught:
        read_image(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_that_cannot_be_are_refused(tmp_path: Path) -> None:
    """A negative scale would turn light into darkness; an array's name means nothing in a picture."""
    cv2.imwrite(str(tmp_path / "a.png"), COUNTS)
    with pytest.raises(ImageError, match="scale"):
        read_image(tmp_path / "a.png", scale=-1.0)
    with pytest.raises(ImageError, match="array"):
        read_image(tmp_path / "a.png", "total")
