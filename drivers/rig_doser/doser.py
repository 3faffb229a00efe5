"""The rig's own doser."""

from drivers.clock import Clock, SystemClock
from drivers.dosing.calibrated import correction
from drivers.dosing.doser import PumpDoser
from drivers.serial_line import PortOpener, open_port

from .pump import RigPump
from .settings import RigDoserSettings


class RigDoser(PumpDoser):
    """The rig's own doser on a serial port; implements `tankrig.devices.Doser`.

    Opening it resets its board.

    Parameters
    ----------
    settings
        From the rig file.
    clock, opener
        Its time, and how its port is opened (tests).
    """

    def __init__(self, settings: RigDoserSettings, clock: Clock | None = None, opener: PortOpener = open_port) -> None:
        name, time = f"doser on {settings.port}", clock or SystemClock(settings.time_scale)
        factor = correction(settings.calibration, name, {"steps_per_ul": settings.steps_per_ul})
        pump = RigPump(settings, name, time, opener)
        super().__init__(pump, time, dose_limit_ul=settings.dose_limit_ul, correction=factor)
