"""The Cavro pump as a doser."""

from drivers.counted.calibrated import correction
from drivers.counted.doser import CountedDoser
from drivers.counted.pump import Trust
from drivers.counted.record import Begun

from .pump import CavroPump
from .settings import CavroSettings


class CavroDoser(CountedDoser):
    """A Cavro pump; implements `tankrig.devices.Doser`.

    Parameters
    ----------
    settings
        From the rig file.
    """

    _pump: CavroPump

    def __init__(self, settings: CavroSettings) -> None:
        name = f"Cavro pump on {settings.port}"
        factor = correction(settings.calibration, name, {"syringe_ul": settings.syringe_ul})
        super().__init__(
            CavroPump(settings, name),
            "cavro",
            settings.count_file,
            dose_limit_ul=settings.dose_limit_ul,
            correction=factor,
            name=name,
            time_scale=settings.time_scale,
        )

    def trouble(self) -> str | None:
        """Why it cannot dose, and what to do; None if it can."""
        with self._in_use("look at it"):
            reading = self._pump.read()
            return None if reading.trust is Trust.EXACT else reading.why

    def initialise(self) -> None:
        """Let the pump find its zero. A person has hung the tube into a waste vessel: the syringe is emptied.

        Raises
        ------
        DeviceError
            If it cannot.
        """
        with self._in_use("initialise"):
            self._pump.initialise()
            if self._file.record.unsure is None:
                self._file.update(begun=Begun("renewal", self._now.best))
                self._take(self._pump.read())
