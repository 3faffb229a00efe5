"""A camera's stream of frames, through OpenCV: asked for in its native bit depth, and everything read back."""

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import DeviceError

from .settings import V4l2CameraSettings

SELECT_TIMEOUT_S = 1
"""After so long without a frame OpenCV's `grab` returns."""
_BUFFERS = 4


class FrameStream:
    """Streams from the first `grab` on.

    Parameters
    ----------
    settings
        From the rig file.
    offered
        Formats that the camera offers, for messages.

    Raises
    ------
    DeviceError
        When it cannot be opened, or does not give what was asked for.
    """

    def __init__(self, settings: V4l2CameraSettings, offered: tuple[str, ...]) -> None:
        # OpenCV reads this once in a process, when it first waits for a frame; its own choice is 10 s.
        os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(SELECT_TIMEOUT_S))
        import cv2

        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
        self._cv2: Any = cv2
        self._settings = settings
        self._capture = cv2.VideoCapture(str(settings.device), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise DeviceError(f"{settings.device}: is used by another program; close that one")
        rows, columns = settings.shape
        for name, value in (
            ("FOURCC", cv2.VideoWriter.fourcc(*_padded(settings.format))),
            ("FRAME_WIDTH", columns),
            ("FRAME_HEIGHT", rows),
            ("BUFFERSIZE", _BUFFERS),
            ("CONVERT_RGB", 0),
            ("FPS", settings.fps or 0.0),
        ):
            if value or name == "CONVERT_RGB":
                self._capture.set(getattr(cv2, f"CAP_PROP_{name}"), value)
        try:
            self._require_asked(offered)
        except DeviceError:
            self.close()
            raise

    @property
    def period_ns(self) -> int:
        """From frame to frame, as the camera says."""
        fps = self._capture.get(self._cv2.CAP_PROP_FPS)
        return round(1e9 / fps) if fps > 0.0 else 0

    def grab(self) -> int | None:
        """Wait for the next frame in the queue; its timestamp, ns, or None when none has come for a while."""
        if not self._capture.grab():
            return None
        return round(self._capture.get(self._cv2.CAP_PROP_POS_MSEC) * 1e6)

    def pixels(self) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Of the frame that was grabbed, turned as the rig file says: an array of their own.

        Raises
        ------
        DeviceError
            When it is torn, or its counts need more bits than the rig file says there are.
        """
        settings = self._settings
        there, raw = self._capture.retrieve()
        if not there or raw.shape[:2] != settings.shape:
            raise DeviceError(
                f"{settings.device}: gave a torn frame; use a shorter cable, or a port that it shares with nothing"
            )
        pixels: NDArray[Any] = raw[..., 0] if raw.ndim == 3 else raw
        if int(pixels.max()) > settings.saturation:
            raise DeviceError(
                f"{settings.device}: gave the count {pixels.max()} where {settings.saturation} is the highest; correct "
                f"camera.bits in the rig file"
            )
        pixels = np.rot90(pixels, settings.turn_deg // 90)
        return (pixels[:, ::-1] if settings.mirror else pixels).copy()

    def close(self) -> None:
        """Stop streaming."""
        self._capture.release()

    def _require_asked(self, offered: tuple[str, ...]) -> None:
        settings, cv2 = self._settings, self._cv2
        given = int(self._capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace").strip()
        if given != settings.format:
            raise DeviceError(
                f"{settings.device}: does not give format {settings.format}; it offers {', '.join(offered)}: choose "
                f"another camera.format in the rig file"
            )
        shape = tuple(int(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH))
        if shape != settings.shape:
            raise DeviceError(
                f"{settings.device}: gives {list(shape)} pixels (rows, columns) and not {list(settings.shape)}; "
                f"correct camera.shape in the rig file"
            )
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        if settings.fps and abs(fps - settings.fps) > 0.02 * settings.fps:
            raise DeviceError(
                f"{settings.device}: gives {fps:g} frames/s, not {settings.fps:g}; correct camera.fps in the rig file"
            )
        if self._capture.get(cv2.CAP_PROP_CONVERT_RGB):
            raise DeviceError(f"{settings.device}: OpenCV insists on converting to RGB; use another camera.format")


def _padded(name: str) -> str:
    return name.ljust(4)
