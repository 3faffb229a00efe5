"""From a file to an image: NumPy's .npz and .npy, and 16-bit or floating-point PNG and TIFF."""

import math
import os
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
    if not (math.isfinite(scale) and scale > 0.0):
        raise ImageError(f"scale = {scale} is not a positive finite number; give the radiance per count")
    return scale * _checked(Path(path), _values(path, array))


def _values(path: str | os.PathLike[str], array: str | None) -> NDArray[np.generic]:
    """What a file holds."""
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in NUMPY_SUFFIXES + PICTURE_SUFFIXES:
        raise ImageError(
            f"{file}: is none of {', '.join(NUMPY_SUFFIXES + PICTURE_SUFFIXES)}; convert it to one of them"
        )
    if array is not None and suffix != ".npz":
        raise ImageError(f'{file}: holds one image only, no array "{array}"; leave the array\'s name out')
    try:
        return _read_numpy(file, array) if suffix in NUMPY_SUFFIXES else _read_picture(file)
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
        if isinstance(error, ImageError):
            raise
        reason = (
            error.strerror if isinstance(error, OSError) and error.strerror else "damaged, or not what its name says"
        )
        raise ImageError(f"{file}: cannot be read ({reason}); give a whole image file") from error


def _read_numpy(file: Path, array: str | None) -> NDArray[np.generic]:
    loaded = np.load(file, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return loaded
    with loaded:
        chosen: NDArray[np.generic] = loaded[_choose(file, array, {name: loaded[name].ndim for name in loaded.files})]
        return chosen


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


def _read_picture(file: Path) -> NDArray[np.generic]:
    import cv2

    data = np.frombuffer(file.read_bytes(), np.uint8)
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        values = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
    except cv2.error:
        values = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if values is None:
        raise ValueError("not decoded")
    picture: NDArray[np.generic] = values
    return picture


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
