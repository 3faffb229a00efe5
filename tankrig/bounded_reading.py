"""Reading files that may be damaged, or not what their names say: sizes are looked at before memory is taken.

Everything here raises `OSError` where the operating system refuses, and `ValueError` where the content is not what was
asked for; whoever reads says in a sentence of their own which file that was and what to do.
"""

import errno
import io
import json
import math
import os
import stat
import struct
import tomllib
import zipfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

MOST_TEXT_BYTES = 16 * 2**20
"""Of a TOML file, or of a table of numbers as text; the largest that tankrig writes has some 100 kB."""
MOST_JSON_BYTES = 2**28
"""Of a run's `zarr.json`, which holds the run's settings."""
MOST_PIXELS = 2**27
"""Of a picture; 16384 × 8192."""
MOST_ARRAY_BYTES = 2**31
"""Of all arrays of a file together, as they are in memory."""

_MOST_HEADER_BYTES = 10_000
_TIFF_KIND, _TIFF_WIDTH, _TIFF_HEIGHT = 254, 256, 257
_TIFF_HEADS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_REDUCED = 1
"""Bit of a TIFF's field 254 (NewSubfileType) that says that a picture is a smaller copy of another."""
_MOST_PAGES = 1000
"""Counted of a TIFF, whose pages may follow each other in a circle."""
_TIFF_NUMBERS = {1: "B", 3: "H", 4: "I", 16: "Q"}
"""Struct's letters of the field types that a width or a height may have (TIFF 6.0, and BigTIFF's 16)."""


def whole_bytes(path: Path, most: int) -> bytes:
    """All that a file holds.

    Parameters
    ----------
    path
        Of a file; a device or a pipe, which might have no end, is refused.
    most
        Bytes that it may have.

    Raises
    ------
    OSError
        When it cannot be read, is larger, or is no file.
    ValueError
        When the path is none.
    """
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(file, "rb") as opened:
        mode = os.fstat(file).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is a device or a pipe, not a file", str(path))
        data = opened.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it has more than the {most / 2**20:.0f} MiB that may be read", str(path))
    return data


def reason(error: OSError | ValueError) -> str:
    """Why something could not be read, in a few words for the reader's sentence."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return "it is no UTF-8 text" if isinstance(error, UnicodeDecodeError) else str(error)


def text(path: Path, most: int = MOST_TEXT_BYTES) -> str:
    """What a UTF-8 file says; raises as `whole_bytes`, and ValueError where it is no text."""
    return whole_bytes(path, most).decode("utf-8-sig")


def parsed_toml(content: str) -> dict[str, Any]:
    """A TOML document; raises ValueError where it is none, or is nested deeper than Python's stack."""
    try:
        return tomllib.loads(content)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def parsed_json(data: bytes | str) -> Any:
    """A JSON document in which every number is finite.

    Raises
    ------
    ValueError
        When it is none, or is nested deeper than anything that tankrig writes.

    Examples
    --------
    >>> parsed_json('{"shape": [2, 3]}')
    {'shape': [2, 3]}
    >>> parsed_json('[1e999]')
    Traceback (most recent call last):
    ValueError: 1e999 is not a finite number
    """
    try:
        return json.loads(data, parse_float=_finite, parse_constant=_finite)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits} is not a finite number")
    return value


# -- arrays ------------------------------------------------------------------------------------------------------------


def array_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the arrays of an .npz file, or the shape of an .npy's under the name "".

    Only headers are read. When this returns, all of the arrays together take `MOST_ARRAY_BYTES` at most.

    Raises
    ------
    OSError
        When the file cannot be read.
    ValueError
        When it is damaged or something else, holds Python objects, or says that it has more than that.
    """
    try:
        with path.open("rb") as file:
            if file.read(2) != b"PK":
                file.seek(0)
                shape, size = _header(file)
                shapes, sizes = {"": shape}, [size]
            else:
                shapes, sizes = {}, []
                with zipfile.ZipFile(file) as archive:
                    for member in archive.infolist():
                        with archive.open(member) as opened:
                            shape, size = _header(opened)
                        shapes[member.filename.removesuffix(".npy")] = shape
                        sizes.append(size)
    except (OSError, ValueError):
        raise
    except Exception as error:  # zipfile, zlib and NumPy's parser raise a dozen kinds on damaged bytes
        raise ValueError(f"damaged ({type(error).__name__})") from error
    if sum(sizes) > MOST_ARRAY_BYTES:
        raise ValueError(f"its arrays would take {sum(sizes):.3g} bytes, more than the {MOST_ARRAY_BYTES:.3g} allowed")
    return shapes


def _header(file: Any) -> tuple[tuple[int, ...], int]:
    """Shape, and bytes in memory, of the array whose .npy text begins here."""
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"arrays in version {version} of NumPy's format are not read")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file, max_header_size=_MOST_HEADER_BYTES)
    if dtype.hasobject:
        raise ValueError("it holds Python objects")
    if any(length < 0 for length in shape):
        raise ValueError(f"its shape is {shape}")
    return shape, math.prod(shape) * dtype.itemsize


def arrays(path: Path, *names: str) -> dict[str, NDArray[np.generic]]:
    """The arrays of an .npz file by their names, or an .npy's under the name ""; raises as `array_shapes`.

    Parameters
    ----------
    path
        Of the file.
    names
        Those to read; all where none is given.
    """
    known = array_shapes(path)
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return {"": loaded}
        with loaded:
            return {name: loaded[name] for name in names or known}
    except (OSError, ValueError):
        raise
    except Exception as error:  # as above; a chunk may be damaged where the header is not
        raise ValueError(f"damaged ({type(error).__name__})") from error


# -- pictures ----------------------------------------------------------------------------------------------------------


def picture(path: Path, flags: int | None = None) -> NDArray[np.generic]:
    """The pixels of a picture file, by OpenCV.

    Parameters
    ----------
    path
        Of the file.
    flags
        OpenCV's, of `cv2.imread`; as the file has them where left out.

    Raises
    ------
    OSError
        When it cannot be read.
    ValueError
        When it is no picture, is damaged, or says that it has more than `MOST_PIXELS`.
    """
    import cv2

    data = whole_bytes(path, MOST_ARRAY_BYTES)
    size = picture_size(data)
    if size is not None and not 0 < math.prod(size) <= MOST_PIXELS:
        raise ValueError(f"its {size[0]} × {size[1]} pixels are more than the {MOST_PIXELS} that may be read")
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        buffer = np.frombuffer(data, np.uint8)
        values = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED if flags is None else flags) if data else None
    except cv2.error as error:
        raise ValueError("damaged") from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if values is None:
        raise ValueError("no picture that can be decoded")
    pixels: NDArray[np.generic] = values
    return pixels


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Rows and columns of which a PNG's or a TIFF's header speaks; None where it does not say.

    >>> picture_size(bytes.fromhex("89504e470d0a1a0a0000000d49484452000000030000000510"))
    (5, 3)
    """
    if data.startswith(b"\x89PNG\r\n\x1a\n") and len(data) >= 24:
        columns, rows = struct.unpack_from(">II", data, 16)
        return rows, columns
    if data[:4] in _TIFF_HEADS:
        try:
            return _tiff_size(io.BytesIO(data))
        except struct.error:  # cut off
            return None
    return None


def pages(path: Path) -> int:
    """Pictures that a TIFF file holds, its previews not among them; 1 of any other file, and of a damaged one.

    Raises
    ------
    OSError
        When it cannot be read.
    """
    with path.open("rb") as file:
        if file.read(4) not in _TIFF_HEADS:
            return 1
        try:
            kinds = [page.get(_TIFF_KIND, 0) for page in islice(_tiff_pages(file), _MOST_PAGES)]
        except struct.error:  # cut off
            return 1
    return max(1, sum(not kind & _REDUCED for kind in kinds))


def _tiff_size(file: BinaryIO) -> tuple[int, int] | None:
    """Of the first picture of a TIFF or BigTIFF file."""
    found = next(_tiff_pages(file), {})
    if _TIFF_WIDTH not in found or _TIFF_HEIGHT not in found:
        return None
    return found[_TIFF_HEIGHT], found[_TIFF_WIDTH]


def _tiff_pages(file: BinaryIO) -> Iterator[dict[int, int]]:
    """Kind, width and height, by their tags, of each picture of a TIFF or BigTIFF file, however many."""
    file.seek(0)
    head = file.read(4)
    order, big = "<" if head.startswith(b"II") else ">", b"+" in head
    # BigTIFF: 2 bytes size of an offset, 2 of zero; then offsets and counts have 8 bytes in place of 4 and 2.
    offset_code, count_code, entry_size, value_at = ("Q", "Q", 20, 12) if big else ("I", "H", 12, 8)

    def unpacked(code: str) -> int:
        (value,) = struct.unpack(order + code, file.read(struct.calcsize(order + code)))
        return int(value)

    if big:
        file.seek(8)
    while offset := unpacked(offset_code):
        file.seek(min(offset, 2**62))
        found = {}
        count = unpacked(count_code)
        for _ in range(min(count, 1000)):
            entry = file.read(entry_size)
            tag, kind = struct.unpack_from(f"{order}HH", entry)
            if tag in (_TIFF_KIND, _TIFF_WIDTH, _TIFF_HEIGHT) and kind in _TIFF_NUMBERS:
                (found[tag],) = struct.unpack_from(order + _TIFF_NUMBERS[kind], entry, value_at)
        yield found
        if count > 1000:
            return
