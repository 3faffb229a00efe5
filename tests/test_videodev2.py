"""The layouts and numbers that the V4L2 driver uses are those of the kernel's header, as a C compiler sees it."""

import ctypes
import shutil
import subprocess

import pytest

from drivers.v4l2 import videodev2
from drivers.v4l2.pixels import FORMATS

STRUCTURES = {
    "v4l2_capability": videodev2.Capability,
    "v4l2_fmtdesc": videodev2.FmtDesc,
    "v4l2_frmsize_discrete": videodev2.FrmSizeDiscrete,
    "v4l2_frmsize_stepwise": videodev2.FrmSizeStepwise,
    "v4l2_frmsizeenum": videodev2.FrmSizeEnum,
    "v4l2_pix_format": videodev2.PixFormat,
    "v4l2_format": videodev2.Format,
    "v4l2_fract": videodev2.Fract,
    "v4l2_captureparm": videodev2.CaptureParm,
    "v4l2_streamparm": videodev2.StreamParm,
    "v4l2_requestbuffers": videodev2.RequestBuffers,
    "v4l2_timecode": videodev2.TimeCode,
    "v4l2_buffer": videodev2.Buffer,
    "v4l2_ext_control": videodev2.ExtControl,
    "v4l2_ext_controls": videodev2.ExtControls,
    "v4l2_query_ext_ctrl": videodev2.QueryExtCtrl,
}
OURS = ("size", "union")
"""Names of unions that have none in the kernel's header."""
KERNEL_NAMES = {"Y16_BE": "Y16_BE", "Y10B": "Y10BPACK"}
NEWER = ("Y12P",)
"""Formats that Debian 12's header does not have yet."""


def compiled(folder, expressions: list[str]) -> list[int]:
    """Values of C expressions under linux/videodev2.h."""
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc, to read the kernel's header")
    source, program = folder / "numbers.c", folder / "numbers"
    lines = "\n".join(f'printf("%llu\\n", (unsigned long long)({expression}));' for expression in expressions)
    headers = "#include <stddef.h>\n#include <stdio.h>\n#include <sys/time.h>\n#include <linux/videodev2.h>\n"
    source.write_text(f"{headers}int main(void) {{\n{lines}\nreturn 0; }}\n")
    subprocess.run(["gcc", "-w", "-o", program, source], check=True)
    return [int(line) for line in subprocess.run([program], capture_output=True, text=True, check=True).stdout.split()]


def test_structures_lie_in_memory_as_the_kernels_do(tmp_path):
    expressions, ours = [], []
    for name, structure in STRUCTURES.items():
        expressions.append(f"sizeof(struct {name})")
        ours.append(ctypes.sizeof(structure))
        for field, *_ in structure._fields_:
            if field in OURS:
                continue
            place = getattr(structure, field)
            expressions += [f"offsetof(struct {name}, {field})", f"sizeof(((struct {name} *)0)->{field})"]
            ours += [place.offset, place.size]
    for name, field, place in (
        ("v4l2_frmsizeenum", "discrete", videodev2.FrmSizeEnum.discrete),
        ("v4l2_ext_control", "value", videodev2.ExtControl.value),
        ("v4l2_ext_control", "value64", videodev2.ExtControl.value64),
    ):
        expressions += [f"offsetof(struct {name}, {field})", f"sizeof(((struct {name} *)0)->{field})"]
        ours += [place.offset, place.size]
    found = compiled(tmp_path, expressions)
    assert [e for e, a, b in zip(expressions, ours, found, strict=True) if a != b] == []


def test_requests_flags_and_types_have_the_kernels_numbers(tmp_path):
    names = [name for name in vars(videodev2) if name.startswith(("V4L2_", "VIDIOC_"))]
    assert len(names) > 30
    found = compiled(tmp_path, [f"(unsigned)({name})" for name in names])
    assert {n: v for n, v in zip(names, found, strict=True) if v != getattr(videodev2, n)} == {}


def test_pixel_formats_have_the_kernels_codes(tmp_path):
    names = [name for name in FORMATS if name not in NEWER]
    found = compiled(tmp_path, [f"(unsigned)V4L2_PIX_FMT_{KERNEL_NAMES.get(name, name)}" for name in names])
    assert {n: hex(v) for n, v in zip(names, found, strict=True) if v != FORMATS[n].code} == {}
