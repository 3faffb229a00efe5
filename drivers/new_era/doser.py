"""The New Era pump as a doser."""

from drivers.clock import Clock, SystemClock
from drivers.counted.account import CountedPump
from drivers.dosing.calibrated import correction
from drivers.dosing.doser import PumpDoser
from drivers.serial_line import PortOpener, open_port

from .pump import NewEraPump
from .settings import NewEraSettings


class NewEraDoser(PumpDoser):
    """A New Era pump; implements `tankrig.devices.Doser`.

    Parameters
    ----------
    settings
        From the rig file.
    clock, opener
        Its time, and how its port is opened (tests).
    """

    def __init__(self, settings: NewEraSettings, clock: Clock | None = None, opener: PortOpener = open_port) -> None:
        name, time = f"New Era pump on {settings.port}", clock or SystemClock(settings.time_scale)
        factor = correction(settings.calibration, name, {"diameter_mm": settings.diameter_mm})
        pump = CountedPump(NewEraPump(settings, name, time, opener), "new-era", settings.count_file, name)
        super().__init__(pump, time, dose_limit_ul=settings.dose_limit_ul, correction=factor)
