"""Every pixel format gives back the counts that were packed as the kernel describes it, whatever pads the lines."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.v4l2.pixels import BIG_ENDIAN, FIRST_OF_TWO_BYTES, FORMATS, MIPI_10, MIPI_12, RUN_OF_10, format_name
from drivers.v4l2.settings import V4l2CameraSettings


def packed(name: str, line: list[int]) -> list[int]:
    """Bytes of a line, bit by bit as userspace-api/media/v4l has them."""
    packing = FORMATS[name].packing
    if packing is MIPI_10 or packing is MIPI_12:
        low = 2 if packing is MIPI_10 else 4
        found = []
        for at in range(0, len(line), packing.pixels):
            group = line[at : at + packing.pixels]
            found += [value >> low for value in group]
            found.append(sum((value & (1 << low) - 1) << low * place for place, value in enumerate(group)))
        return found
    if packing is RUN_OF_10:
        run = "".join(f"{value:010b}" for value in line)
        return [int(run[at : at + 8], 2) for at in range(0, len(run), 8)]
    if packing is BIG_ENDIAN:
        return [byte for value in line for byte in (value >> 8, value & 255)]
    if packing is FIRST_OF_TWO_BYTES:
        return [byte for value in line for byte in (value, 128)]
    return [byte for value in line for byte in ((value & 255, value >> 8) if FORMATS[name].bits > 8 else (value,))]


@given(st.sampled_from(sorted(FORMATS)), st.integers(1, 4), st.integers(1, 5), st.integers(0, 9), st.randoms())
def test_what_was_packed_comes_out_again(name, rows, groups, padding, random):
    rows, columns, most = 2 * rows, 4 * groups, 2 ** FORMATS[name].bits - 1
    counts = np.array([[random.randint(0, most) for _ in range(columns)] for _ in range(rows)])
    lines = [packed(name, [int(value) for value in line]) + [0xEE] * padding for line in counts]
    assert FORMATS[name].line_bytes(columns) == len(lines[0]) - padding
    buffer = np.array([byte for line in lines for byte in line], np.uint8)
    found = FORMATS[name].counts(buffer[: len(buffer) - padding], (rows, columns), len(lines[0]))
    assert found.dtype == (np.uint8 if FORMATS[name].bits == 8 else np.uint16)
    np.testing.assert_array_equal(found, counts)


MOSAICS = sorted(name for name in FORMATS if FORMATS[name].mosaic and FORMATS[name].bits < 16)


@given(st.sampled_from(MOSAICS), st.sampled_from(["green", "all"]), st.integers(1, 3), st.integers(1, 3), st.randoms())
def test_a_cell_is_the_sum_of_its_pixels_and_saturates_with_any_of_them(name, cells, rows, columns, random):
    format_, most = FORMATS[name], 2 ** FORMATS[name].bits - 1
    counts = np.array([[random.choice((0, 1, most - 1, most)) for _ in range(2 * columns)] for _ in range(2 * rows)])
    grey = format_.grey(counts.astype(np.uint16), cells, most)
    for row in range(rows):
        for column in range(columns):
            cell = counts[2 * row : 2 * row + 2, 2 * column : 2 * column + 2].ravel()
            chosen = [v for v, colour in zip(cell, format_.mosaic, strict=True) if cells == "all" or colour == "G"]
            assert len(chosen) == format_.added(cells)
            assert grey[row, column] == (len(chosen) * most if most in chosen else sum(chosen))


def test_no_two_formats_share_a_code_and_each_is_known_by_it():
    assert len({format_.code for format_ in FORMATS.values()}) == len(FORMATS)
    assert all(format_name(format_.code) == name for name, format_ in FORMATS.items())
    assert format_name(int.from_bytes(b"MJPG", "little")) == "MJPG"


@pytest.mark.parametrize("bayer", ["green", "all"])
def test_a_sum_that_does_not_fit_16_bits_is_refused_with_what_does(bayer):
    settings = {"device": "/dev/video0", "format": "SRGGB16", "shape": [4, 4], "bayer": bayer}
    fit = 15 if bayer == "green" else 14
    with pytest.raises(ValidationError, match=f"give camera.bits, the significant bits of a pixel, at most {fit}"):
        V4l2CameraSettings(**settings)
    assert V4l2CameraSettings(**settings, bits=fit).saturation <= 65535


def test_settings_of_rig_files_of_before_mean_what_they_meant():
    old = {"device": "/dev/video0", "format": "Y16", "shape": [48, 64], "bits": 12, "settle_frames": 3, "gain_one": 16}
    settings = V4l2CameraSettings(**old, turn_deg=90, mirror=True, controls={"gamma": 100}, card="A", fps=30.0)
    assert (settings.saturation, settings.settle_frames, settings.timestamps) == (4095, 3, None)
