"""The simulated rig's doser: the real driver on a pseudo-terminal, with the emulator's own process behind it."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from drivers.emulation.truth import read_truth, state_in_use
from tankrig.errors import DeviceError

from .doser import RigDoser
from .settings import RigDoserSettings, SimulatedDoserSettings

_START_S = 20.0


class SimulatedDoser(RigDoser):
    """The rig's own doser with a computed motor.

    Its process outlives a killed program, as a real doser does, and is found again by the next one that opens the same
    folder; `close` ends a process that this object has started.

    Parameters
    ----------
    settings
        From the rig file.

    Raises
    ------
    DeviceError
        If the emulator does not start, or its doser does not answer.
    """

    def __init__(self, settings: SimulatedDoserSettings) -> None:
        self._folder, self._true_steps_per_ul = _nameable(settings.folder), settings.steps_per_ul
        self._process = _running(settings)
        try:
            super().__init__(
                RigDoserSettings(
                    port=str(settings.folder / "doser"),
                    steps_per_ul=settings.steps_per_ul,
                    dose_limit_ul=settings.dose_limit_ul,
                    time_scale=settings.time_scale,
                )
            )
        except BaseException:
            self._end_process()
            raise

    def true_ul(self) -> float:
        """Ink that the plunger has really pushed out since it was commissioned, µl; only the simulated tank may ask."""
        return read_truth(self._folder / "state").steps / self._true_steps_per_ul

    def close(self) -> None:
        """Stop a dose that runs, let go of the port, and end the emulator."""
        super().close()
        self._end_process()

    def _end_process(self) -> None:
        if self._process:
            self._process.terminate()
            self._process.wait(_START_S)


def _nameable(folder: Path) -> Path:
    """The folder; refused if its name cannot be written down."""
    try:
        str(folder).encode()
    except UnicodeEncodeError as error:
        shown = os.fsencode(folder).decode("utf-8", "backslashreplace")
        raise DeviceError(f"simulated doser in {shown}: that path is not valid UTF-8; use another folder") from error
    return folder


def _running(settings: SimulatedDoserSettings) -> subprocess.Popen[bytes] | None:
    """Start the emulator and wait for its link; None if one runs in that folder already."""
    folder, link = settings.folder, settings.folder / "doser"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if state_in_use(folder / "state"):
            return None
        link.unlink(missing_ok=True)
        with (folder / "emulator.log").open("wb") as log:
            process = subprocess.Popen(
                _command(settings, link), stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
    except OSError as error:
        raise DeviceError(f"simulated doser in {folder}: cannot start ({error}); give another folder") from error
    deadline = time.monotonic() + _START_S
    while not link.is_symlink():
        if process.poll() is not None or time.monotonic() > deadline:
            process.kill()
            raise DeviceError(f"simulated doser in {folder}: its process does not start; see {folder / 'emulator.log'}")
        time.sleep(0.005)
    return process


def _command(settings: SimulatedDoserSettings, link: Path) -> list[str]:
    options = {
        "--link": link,
        "--state": settings.folder / "state",
        "--rate": settings.rate,
        "--acceleration": settings.acceleration,
        "--time-scale": settings.time_scale,
        "--linger-s": settings.linger_s,
        "--faults": json.dumps(settings.faults),
        "--seed": settings.seed,
    }
    pairs = [str(word) for option in options.items() for word in option]
    return [sys.executable, "-m", "drivers.rig_doser.emulator", *pairs]
