"""What tankrig uses of the kernel's linux/videodev2.h: layouts, requests and numbers, under the kernel's own names.

A test compiles the header and compares each of them.
"""

import ctypes
from ctypes import c_char, c_int32, c_int64, c_long, c_ubyte, c_uint8, c_uint32, c_uint64, c_ulong
from typing import Any, ClassVar


class Capability(ctypes.Structure):
    """struct v4l2_capability."""

    _fields_: ClassVar[list[Any]] = [
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    ]


class FmtDesc(ctypes.Structure):
    """struct v4l2_fmtdesc."""

    _fields_: ClassVar[list[Any]] = [
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    ]


class FrmSizeStepwise(ctypes.Structure):
    """struct v4l2_frmsize_stepwise."""

    _fields_: ClassVar[list[Any]] = [
        (name, c_uint32) for name in ("min_width", "max_width", "step_width", "min_height", "max_height", "step_height")
    ]


class FrmSizeDiscrete(ctypes.Structure):
    """struct v4l2_frmsize_discrete."""

    _fields_: ClassVar[list[Any]] = [("width", c_uint32), ("height", c_uint32)]


class _FrmSize(ctypes.Union):
    _fields_: ClassVar[list[Any]] = [("discrete", FrmSizeDiscrete), ("stepwise", FrmSizeStepwise)]


class FrmSizeEnum(ctypes.Structure):
    """struct v4l2_frmsizeenum."""

    _anonymous_ = ("size",)
    _fields_: ClassVar[list[Any]] = [
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("size", _FrmSize),
        ("reserved", c_uint32 * 2),
    ]


class PixFormat(ctypes.Structure):
    """struct v4l2_pix_format."""

    _fields_: ClassVar[list[Any]] = [
        (name, c_uint32)
        for name in (
            *("width", "height", "pixelformat", "field", "bytesperline", "sizeimage"),
            *("colorspace", "priv", "flags", "ycbcr_enc", "quantization", "xfer_func"),
        )
    ]


class _Fmt(ctypes.Union):
    # Another member of the kernel's union holds pointers, which is what aligns it.
    _fields_: ClassVar[list[Any]] = [("pix", PixFormat), ("raw_data", c_ubyte * 200), ("_pointers", c_ulong)]


class Format(ctypes.Structure):
    """struct v4l2_format."""

    _fields_: ClassVar[list[Any]] = [("type", c_uint32), ("fmt", _Fmt)]


class Fract(ctypes.Structure):
    """struct v4l2_fract."""

    _fields_: ClassVar[list[Any]] = [("numerator", c_uint32), ("denominator", c_uint32)]


class CaptureParm(ctypes.Structure):
    """struct v4l2_captureparm."""

    _fields_: ClassVar[list[Any]] = [
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fract),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    ]


class _Parm(ctypes.Union):
    _fields_: ClassVar[list[Any]] = [("capture", CaptureParm), ("raw_data", c_ubyte * 200)]


class StreamParm(ctypes.Structure):
    """struct v4l2_streamparm."""

    _fields_: ClassVar[list[Any]] = [("type", c_uint32), ("parm", _Parm)]


class RequestBuffers(ctypes.Structure):
    """struct v4l2_requestbuffers."""

    _fields_: ClassVar[list[Any]] = [
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    ]


class TimeVal(ctypes.Structure):
    """struct timeval."""

    _fields_: ClassVar[list[Any]] = [("tv_sec", c_long), ("tv_usec", c_long)]


class TimeCode(ctypes.Structure):
    """struct v4l2_timecode."""

    _fields_: ClassVar[list[Any]] = [
        ("type", c_uint32),
        ("flags", c_uint32),
        ("frames", c_uint8),
        ("seconds", c_uint8),
        ("minutes", c_uint8),
        ("hours", c_uint8),
        ("userbits", c_uint8 * 4),
    ]


class _Memory(ctypes.Union):
    _fields_: ClassVar[list[Any]] = [("offset", c_uint32), ("userptr", c_ulong)]


class Buffer(ctypes.Structure):
    """struct v4l2_buffer."""

    _fields_: ClassVar[list[Any]] = [
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp", TimeVal),
        ("timecode", TimeCode),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _Memory),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    ]


class _Value(ctypes.Union):
    _pack_ = 1
    _layout_ = "ms"  # which later Pythons want said with _pack_
    _fields_: ClassVar[list[Any]] = [("value", c_int32), ("value64", c_int64)]


class ExtControl(ctypes.Structure):
    """struct v4l2_ext_control."""

    _pack_ = 1
    _layout_ = "ms"
    _anonymous_ = ("union",)
    _fields_: ClassVar[list[Any]] = [
        ("id", c_uint32),
        ("size", c_uint32),
        ("reserved2", c_uint32 * 1),
        ("union", _Value),
    ]


class ExtControls(ctypes.Structure):
    """struct v4l2_ext_controls."""

    _fields_: ClassVar[list[Any]] = [
        ("which", c_uint32),
        ("count", c_uint32),
        ("error_idx", c_uint32),
        ("request_fd", c_int32),
        ("reserved", c_uint32 * 1),
        ("controls", ctypes.POINTER(ExtControl)),
    ]


class QueryExtCtrl(ctypes.Structure):
    """struct v4l2_query_ext_ctrl."""

    _fields_: ClassVar[list[Any]] = [
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int64),
        ("maximum", c_int64),
        ("step", c_uint64),
        ("default_value", c_int64),
        ("flags", c_uint32),
        ("elem_size", c_uint32),
        ("elems", c_uint32),
        ("nr_of_dims", c_uint32),
        ("dims", c_uint32 * 4),
        ("reserved", c_uint32 * 32),
    ]


_WRITE, _READ = 1, 2


def _request(direction: int, number: int, argument: Any) -> int:
    """The number of an ioctl, as the macros _IOR, _IOW and _IOWR make it."""
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


VIDIOC_QUERYCAP = _request(_READ, 0, Capability)
VIDIOC_ENUM_FMT = _request(_READ | _WRITE, 2, FmtDesc)
VIDIOC_S_FMT = _request(_READ | _WRITE, 5, Format)
VIDIOC_REQBUFS = _request(_READ | _WRITE, 8, RequestBuffers)
VIDIOC_QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
VIDIOC_QBUF = _request(_READ | _WRITE, 15, Buffer)
VIDIOC_DQBUF = _request(_READ | _WRITE, 17, Buffer)
VIDIOC_STREAMON = _request(_WRITE, 18, c_int32)
VIDIOC_STREAMOFF = _request(_WRITE, 19, c_int32)
VIDIOC_G_PARM = _request(_READ | _WRITE, 21, StreamParm)
VIDIOC_S_PARM = _request(_READ | _WRITE, 22, StreamParm)
VIDIOC_G_EXT_CTRLS = _request(_READ | _WRITE, 71, ExtControls)
VIDIOC_S_EXT_CTRLS = _request(_READ | _WRITE, 72, ExtControls)
VIDIOC_ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FrmSizeEnum)
VIDIOC_QUERY_EXT_CTRL = _request(_READ | _WRITE, 103, QueryExtCtrl)

V4L2_BUF_TYPE_VIDEO_CAPTURE = 1
V4L2_MEMORY_MMAP = 1
V4L2_FIELD_NONE = 1
V4L2_FRMSIZE_TYPE_DISCRETE = 1

V4L2_CAP_VIDEO_CAPTURE = 0x00000001
V4L2_CAP_VIDEO_CAPTURE_MPLANE = 0x00001000
V4L2_CAP_STREAMING = 0x04000000
V4L2_CAP_DEVICE_CAPS = 0x80000000
V4L2_CAP_TIMEPERFRAME = 0x1000

V4L2_BUF_FLAG_ERROR = 0x00000040
V4L2_BUF_FLAG_TIMESTAMP_MASK = 0x0000E000
V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC = 0x00002000
V4L2_BUF_FLAG_TSTAMP_SRC_MASK = 0x00070000
V4L2_BUF_FLAG_TSTAMP_SRC_SOE = 0x00010000

V4L2_CTRL_TYPE_INTEGER = 1
V4L2_CTRL_TYPE_BOOLEAN = 2
V4L2_CTRL_TYPE_MENU = 3
V4L2_CTRL_TYPE_INTEGER64 = 5
V4L2_CTRL_TYPE_BITMASK = 8
V4L2_CTRL_TYPE_INTEGER_MENU = 9

V4L2_CTRL_FLAG_DISABLED = 0x0001
V4L2_CTRL_FLAG_READ_ONLY = 0x0004
V4L2_CTRL_FLAG_WRITE_ONLY = 0x0040
V4L2_CTRL_FLAG_HAS_PAYLOAD = 0x0100
V4L2_CTRL_FLAG_NEXT_CTRL = 0x80000000
V4L2_EXPOSURE_MANUAL = 1
