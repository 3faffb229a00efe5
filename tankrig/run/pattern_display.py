"""Displaying patterns, and taking frames proven to be of them, each with what was true when it was exposed."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Protocol

from tankrig.devices import CameraSettings, Confirming, Delivered, Frame
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern
from tankrig.run.burst import IncompleteBurstError, take_burst
from tankrig.run.conditions import Conditions, clamped, spanning
from tankrig.run.rig import Rig
from tankrig.run.writer import RunWriter

CAMERA_TIMEOUT_S = 5.0
_BURST_TAKES = 3


class Tank(Protocol):
    """Whoever knows what the tank holds."""

    def delivered(self) -> Delivered:
        """Ink in the tank now."""


class PatternDisplay:
    """Shows patterns one after another and takes frames of each.

    Parameters
    ----------
    rig
        Its projector shows, its camera looks.
    writer
        Told how the camera was set, and with a warning, once for each setting, where it set something else than was
        asked for.
    tank
        Asked what it holds, around each exposure.
    """

    def __init__(self, rig: Rig, writer: RunWriter, tank: Tank) -> None:
        self._rig, self._writer, self._tank = rig, writer, tank
        self._asked: CameraSettings | None = None
        self._set = CameraSettings(0.0)
        self._told: set[CameraSettings] = set()
        self._pattern = ""
        self._after_ns = 0
        self._held = Delivered(0.0, 0.0, 0.0)

    def show(self, pattern: Pattern, settings: CameraSettings) -> None:
        """Show a pattern; one that was there for the frame before is left there, and no frame is lost for it."""
        if (pattern.hash, settings) == (self._pattern, self._asked):
            return
        if settings != self._asked:
            self._configure(settings)
        self._held = self._tank.delivered()  # exposures that count begin after this
        self._after_ns = self._rig.projector.show(pattern).bound_ns
        self._pattern = pattern.hash

    def _configure(self, settings: CameraSettings) -> None:
        camera = self._rig.camera
        self._asked, self._set = None, camera.configure(settings)
        self._writer.put("note", text="camera", asked=asdict(settings), **asdict(self._set))
        self._asked = settings
        if clamped(settings, self._set) and settings not in self._told:
            self._told.add(settings)
            asked, actual = (f"{one.exposure_ms:g} ms at gain {one.gain:g}" for one in (settings, self._set))
            self._writer.put(
                "note",
                text=f"{camera.name}: was asked for {asked} and has set {actual}, with which its frames are recorded "
                f"and fitted; ask for what it can do to be rid of this line",
                warning=True,
            )

    def burst(self, patterns: Sequence[Pattern], settings: CameraSettings) -> tuple[list[Frame], Conditions]:
        """One frame of each pattern, taken in one burst, and what was true meanwhile; again where frames are lost.

        Raises
        ------
        DeviceError
            When the devices cannot, or frames are lost again and again.
        """
        self.forget()
        if settings != self._asked:
            self._configure(settings)
        for take in range(1, _BURST_TAKES + 1):
            before = self._tank.delivered()
            try:
                frames, timing = take_burst(self._rig.projector, self._rig.camera, patterns, self._set.exposure_ms)
            except IncompleteBurstError as error:
                if take == _BURST_TAKES:
                    raise
                self._writer.put("note", text=f"a burst is taken again: {error}", warning=True)
            else:
                break
        # The light is within the exposure, so that it is the light that says for how long.
        lit = replace(self._set, exposure_ms=timing.lit_ms)
        return frames, Conditions(spanning(before, self._tank.delivered()), lit)

    def forget(self) -> None:
        """Time goes by, or others may use the rig: show the next pattern anew, whichever it is."""
        self._pattern = ""

    def frame(self) -> tuple[Frame, Conditions]:
        """The next frame, and what was true when it was exposed.

        Raises
        ------
        DeviceError
            When the camera gives none, or one that cannot be of the pattern, or of another shape.
        """
        camera = self._rig.camera
        frame = camera.capture(self._after_ns, 2e-3 * self._set.exposure_ms + CAMERA_TIMEOUT_S)
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
        before, self._held = self._held, self._tank.delivered()
        return frame, Conditions(spanning(before, self._held), self._set)
