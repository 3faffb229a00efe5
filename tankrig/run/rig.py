"""A rig: three open devices and what is known about them."""

import contextlib
import fcntl
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tankrig.bench import Bench
from tankrig.calibration.file import Calibration
from tankrig.devices import CameraDevice, Doser, Projector
from tankrig.dosing import DoseLimits
from tankrig.errors import StoreError
from tankrig.sequence import ExposureRule, Pace


class RigLock:
    """Keeps a rig for one program; held until `close` or the end of the program, however that ends.

    Parameters
    ----------
    path
        A file that all programs using the rig agree on; made if it is not there.
    rig
        What to call the rig in messages.

    Raises
    ------
    StoreError
        When another program holds it, or the file cannot be made.
    """

    def __init__(self, path: Path, rig: str) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise StoreError(
                f"{path}: the lock of rig {rig} cannot be made ({error.strerror}); give its folder in the rig file"
            ) from error
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.pread(self._handle, 32, 0).decode().strip() or "?"
            os.close(self._handle)
            raise StoreError(
                f"rig {rig} is in use by another program (process {holder}); let that end first"
            ) from error
        os.ftruncate(self._handle, 0)
        os.pwrite(self._handle, f"{os.getpid()}\n".encode(), 0)

    def close(self) -> None:
        """Let go of the rig; may be called any number of times."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


@dataclass(frozen=True)
class Rig:
    """Three open devices and what is known about them.

    Parameters
    ----------
    name
        For people.
    projector, camera, doser
        Open; the doser is the bare device, which the run puts a `GuardedDoser` around.
    bench
        Geometry and radiometry.
    limits
        Budgets for ink.
    ledger
        File of the tank's ledger.
    pace
        How fast it is.
    exposure
        What exposures must keep to.
    flash_before_run
        Whether the camera is asked, before a run begins, if it sees what the projector is told to show.
    calibrations
        By kind, what was measured of it and counts.
    lock
        Keeps other programs off.
    """

    name: str
    projector: Projector
    camera: CameraDevice
    doser: Doser
    bench: Bench
    limits: DoseLimits
    ledger: Path
    pace: Pace = field(default_factory=Pace)
    exposure: ExposureRule = field(default_factory=ExposureRule)
    flash_before_run: bool = False
    calibrations: Mapping[str, Calibration] = field(default_factory=dict)
    lock: RigLock | None = None

    def close(self) -> None:
        """Stop and let go of the devices, the doser first; may be called any number of times."""
        with contextlib.ExitStack() as last_first:
            for device in (self.lock, self.projector, self.camera, self.doser):
                if device is not None:
                    last_first.callback(device.close)
