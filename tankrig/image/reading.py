"""From a file to an image: NumPy's .npz and .npy, and 16-bit or floating-point PNG and TIFF."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig import bounded_reading
from tankrig.checked_toml import MOST
from tankrig.errors import ImageError

NUMPY_SUFFIXES = (".npz", ".npy")
PICTURE_SUFFIXES = (".png", ".tif", ".tiff")
MOST_COUNTS = 65_535
DEFAULT_ARRAY = "total"
"""Array taken from an .npz of several when none is named: what predictions and reference images call the whole."""


def read_frame(path: str | os.PathLike[str], array: str | None = None) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read a raw frame of a camera, counts of 8 or 16 bits.

    Parameters
    ----------
    path, array
        As for `read_image`.

    Raises
    ------
    ImageError
        In one sentence: the file, what is wrong with it, and what to do.
    """
    values = _shaped(Path(path), _values(path, array))
    if values.dtype.kind in "iu" and values.size and 0 <= values.min() <= values.max() <= MOST_COUNTS:
        return values.astype(np.uint16)
    raise ImageError(f"{path}: holds no counts from 0 to {MOST_COUNTS}; give a frame as the camera delivered it")


def read_any(path: str | os.PathLike[str], array: str | None = None) -> NDArray[np.generic]:
    """Read a grey image as it is, of whatever type its pixels are.

    Parameters
    ----------
    path, array
        As for `read_image`.

    Raises
    ------
    ImageError
        In one sentence: the file, what is wrong with it, and what to do.
    """
    return _shaped(Path(path), _values(path, array))


def read_mask(path: str | os.PathLike[str]) -> NDArray[np.bool_]:
    """Read a mask: an image of any type, True where it is not 0.

    Raises
    ------
    ImageError
        In one sentence: the file, what is wrong with it, and what to do.
    """
    return np.asarray(_shaped(Path(path), _values(path, None)) != 0)


def read_image(path: str | os.PathLike[str], array: str | None = None, scale: float = 1.0) -> NDArray[np.float64]:
    """Read a grey image; its first row is the scene's first, at y = −Ly/2.

    Parameters
    ----------
    path
        .npz, .npy, or a PNG or TIFF of one channel with 16 bits or floating point.
    array
        Which array of an .npz; None for its only image, or the one called "total".
    scale
        Radiance per count, W/mm²/sr; the image is multiplied by it.

    Returns
    -------
    (rows, columns) array

    Raises
    ------
    ImageError
        In one sentence: the file, what is wrong with it, and what to do.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(Path(folder, "two.npz"), total=np.ones((2, 3)), order1=np.zeros((2, 3)))
    ...     read_image(Path(folder, "two.npz"), scale=0.5)
    array([[0.5, 0.5, 0.5],
           [0.5, 0.5, 0.5]])
    """
    if not 1.0 / MOST <= scale <= MOST:
        raise ImageError(f"scale = {scale} is not a positive finite number; give the radiance per count")
    return scale * _checked(Path(path), _values(path, array))


def _values(path: str | os.PathLike[str], array: str | None) -> NDArray[np.generic]:
    """What a file holds."""
    file = Path(path)
    suffix = file.suffix.lower()
    if file.is_dir():
        raise ImageError(f"{file}: is a folder; give an image file in it")
    if suffix not in NUMPY_SUFFIXES + PICTURE_SUFFIXES:
        raise ImageError(
            f"{file}: is none of {', '.join(NUMPY_SUFFIXES + PICTURE_SUFFIXES)}; convert it to one of them"
        )
    if array is not None and suffix != ".npz":
        raise ImageError(f'{file}: holds one image only, no array "{array}"; leave the array\'s name out')
    try:
        if suffix in NUMPY_SUFFIXES:
            return _read_numpy(file, array)
        values = bounded_reading.picture(file)
        if (count := bounded_reading.pages(file)) > 1:
            raise ImageError(f"{file}: holds {count} pictures, and nobody said which; save one of them as a file")
        return values
    except ImageError:
        raise
    except OSError as error:
        reason = bounded_reading.reason(error)
        raise ImageError(f"{file}: cannot be read ({reason}); give a whole image file") from error
    except ValueError as error:
        reason = f"damaged, or not what its name says: {error}"
        raise ImageError(f"{file}: cannot be read ({reason}); give a whole image file") from error


def _read_numpy(file: Path, array: str | None) -> NDArray[np.generic]:
    shapes = bounded_reading.array_shapes(file)
    name = "" if "" in shapes else _choose(file, array, {name: len(shape) for name, shape in shapes.items()})
    return bounded_reading.arrays(file, name)[name]


def _choose(file: Path, array: str | None, dimensions: dict[str, int]) -> str:
    """Name of the array to read, among those with two dimensions."""
    images = [name for name, count in dimensions.items() if count == 2]
    there = f"the images there are {', '.join(images)}" if images else "there is no image in it"
    if array is not None:
        if array not in images:
            raise ImageError(f'{file}: holds no image "{array}"; {there}')
        return array
    if DEFAULT_ARRAY in images:
        return DEFAULT_ARRAY
    if len(images) != 1:
        raise ImageError(f"{file}: {there}; " + ("name one of them as the array" if images else "give another file"))
    return images[0]


def _shaped(file: Path, values: NDArray[np.generic]) -> NDArray[np.generic]:
    if values.ndim != 2:
        raise ImageError(
            f"{file}: has shape {list(values.shape)}, so not one grey image; give (rows, columns) of one channel"
        )
    return values


def _checked(file: Path, values: NDArray[np.generic]) -> NDArray[np.float64]:
    values = _shaped(file, values)
    if values.dtype.kind in "iub" and values.dtype.itemsize < 2:
        raise ImageError(
            f"{file}: has 8 bits per pixel, whose steps hide the dim light that the fit needs; "
            "save the camera's image with 16 bits"
        )
    if values.dtype.kind not in "iuf":
        raise ImageError(f"{file}: holds {values.dtype}, not real numbers; give an image of integers or floats")
    return values.astype(np.float64)
