"""The Cavro pump as a doser."""

from drivers.clock import Clock, SystemClock
from drivers.counted.account import CountedPump
from drivers.dosing.calibrated import correction
from drivers.dosing.doser import PumpDoser
from drivers.serial_line import PortOpener, open_port

from .pump import CavroPump
from .settings import CavroSettings


class CavroDoser(PumpDoser):
    """A Cavro pump; implements `tankrig.devices.Doser`.

    Parameters
    ----------
    settings
        From the rig file.
    clock, opener
        Its time, and how its port is opened (tests).
    """

    pump: CountedPump

    def __init__(self, settings: CavroSettings, clock: Clock | None = None, opener: PortOpener = open_port) -> None:
        name, time = f"Cavro pump on {settings.port}", clock or SystemClock(settings.time_scale)
        factor = correction(settings.calibration, name, {"syringe_ul": settings.syringe_ul})
        self._settings = settings
        self._plunger = CavroPump(settings, name, time, opener)
        pump = CountedPump(self._plunger, "cavro", settings.count_file, name)
        super().__init__(pump, time, dose_limit_ul=settings.dose_limit_ul, correction=factor)

    def what_moves(self) -> str:
        """Model, firmware and speed, for a sentence."""
        model = {"xcalibur": "XCalibur", "xlp": "XLP"}[self._settings.model]
        return f"{model} with firmware {self._plunger.model!r} at {self._settings.speed_ul_per_s:g} µl/s"

    def initialise(self) -> None:
        """Let the pump find its zero. A person has hung the tube into a waste vessel: the syringe is emptied.

        Raises
        ------
        DeviceError
            If it cannot.
        """
        with self._in_use("initialise"):
            self.pump.counter_moved()
            self._plunger.initialise()
            self._read()
