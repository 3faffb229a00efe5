"""The pattern on the wall, and frames that are proven to be of it."""

from dataclasses import asdict

from tankrig.devices import CameraSettings, Confirming, Frame
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern
from tankrig.run.rig import Rig
from tankrig.run.writer import RunWriter

_CAMERA_TIMEOUT_S = 5.0


class Shown:
    """Shows patterns one after another and takes frames of each.

    Parameters
    ----------
    rig
        Its projector shows, its camera looks.
    writer
        Told how the camera was set.
    """

    def __init__(self, rig: Rig, writer: RunWriter) -> None:
        self._rig, self._writer = rig, writer
        self._settings: CameraSettings | None = None
        self._pattern = ""
        self._after_ns = 0

    def show(self, pattern: Pattern, settings: CameraSettings) -> None:
        """Show a pattern; one that was there for the frame before is left there, and no frame is lost for it."""
        if (pattern.hash, settings) == (self._pattern, self._settings):
            return
        if settings != self._settings:
            actual = self._rig.camera.configure(settings)
            self._writer.put("note", text="camera", asked=asdict(settings), **asdict(actual))
            self._settings = settings
        self._after_ns = self._rig.projector.show(pattern).bound_ns
        self._pattern = pattern.hash

    def forget(self) -> None:
        """Time goes by, or others may use the rig: show the next pattern anew, whichever it is."""
        self._pattern = ""

    def frame(self) -> Frame:
        """The next frame.

        Raises
        ------
        DeviceError
            When the camera gives none, or one that cannot be of the pattern, or of another shape.
        """
        camera = self._rig.camera
        exposure_s = self._settings.exposure_ms / 1000 if self._settings else 0.0
        frame = camera.capture(self._after_ns, 2 * exposure_s + _CAMERA_TIMEOUT_S)
        if isinstance(self._rig.projector, Confirming):
            self._rig.projector.confirm()
        if frame.exposure_start_ns <= self._after_ns:
            early_ms = (self._after_ns - frame.exposure_start_ns) / 1e6
            raise DeviceError(
                f"{camera.name}: gave a frame whose exposure began {early_ms:g} ms too early to be of the pattern that "
                f"is shown; check its timestamps (tankrig doctor)"
            )
        if frame.pixels.shape != camera.shape:
            raise DeviceError(
                f"{camera.name}: gave a frame of shape {list(frame.pixels.shape)} rather than {list(camera.shape)}; "
                f"set its format again, and check its cable"
            )
        self._after_ns = frame.exposure_start_ns
        return frame
