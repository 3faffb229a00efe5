"""What is written down about doses."""

from dataclasses import dataclass, field

from tankrig.devices import Delivered

COUNT_KEYS = ("count_ul", "count_low_ul", "count_high_ul")
"""Keys under which a run's journal notes what the doser had counted, µl: best value and bounds."""


@dataclass(frozen=True)
class DoseIntent:
    """A dose is about to begin.

    Parameters
    ----------
    total_ul
        Ink that the tank is to hold when it is done, µl.
    from_ul
        Ink that it holds now, µl.
    doser
        Identity of the doser.
    """

    total_ul: float
    from_ul: float
    doser: str


@dataclass(frozen=True)
class DoseDone:
    """A dose is over.

    Parameters
    ----------
    delivered_ul, delivered_low_ul, delivered_high_ul
        Ink that the tank holds now, with hard bounds, µl.
    complete
        Whether it is what was wanted.
    doser
        Identity of the doser.
    count_ul, count_low_ul, count_high_ul
        What the doser had counted then, µl, by which a lost ledger can be judged. Journals of earlier versions have
        neither these nor the identity.
    """

    delivered_ul: float
    delivered_low_ul: float
    delivered_high_ul: float
    complete: bool
    doser: str | None = field(default=None, compare=False)
    count_ul: float | None = field(default=None, compare=False)
    count_low_ul: float | None = field(default=None, compare=False)
    count_high_ul: float | None = field(default=None, compare=False)


@dataclass(frozen=True)
class NotedCount:
    """What a doser had counted when something was written down.

    Parameters
    ----------
    doser
        Its identity.
    count
        What it had counted, µl.
    """

    doser: str
    count: Delivered

    @property
    def device(self) -> str:
        """The doser itself, whatever correction its volumes have.

        >>> NotedCount("cavro 1f ×1.02", Delivered(0.0, 0.0, 0.0)).device
        'cavro 1f'
        """
        return _device_and_correction(self.doser)[0]

    def on_scale_of(self, doser: str) -> Delivered | None:
        """The count in the µl of `doser`, which may be the same device with another correction; None if it is another.

        A correction stands in an identity with six digits: the bounds are widened by that rounding.

        >>> NotedCount("cavro 1f", Delivered(100.0, 100.0, 100.0)).on_scale_of("cavro 1f ×1.02").volume_ul
        102.0
        >>> NotedCount("cavro 1f", Delivered(100.0, 100.0, 100.0)).on_scale_of("cavro 20")
        """
        if doser == self.doser:
            return self.count
        device, correction = _device_and_correction(doser)
        own_device, own_correction = _device_and_correction(self.doser)
        if device != own_device:
            return None
        volume_ul, low_ul, high_ul = (correction / own_correction * value for value in self.count)
        rounding_ul = SCALE_ROUNDING * abs(high_ul)
        return Delivered(volume_ul, low_ul - rounding_ul, high_ul + rounding_ul)


SCALE_ROUNDING = 1e-5
"""Relative error of a count that was brought to another correction's scale."""


def device_of(doser: str) -> str:
    """The device that an identity names, whatever correction its volumes have.

    >>> device_of("rig-doser 7 ×0.98"), device_of("rig-doser 7")
    ('rig-doser 7', 'rig-doser 7')
    """
    return _device_and_correction(doser)[0]


def _device_and_correction(doser: str) -> tuple[str, float]:
    device, mark, factor = doser.rpartition(" ×")
    try:
        return (device, float(factor)) if mark else (doser, 1.0)
    except ValueError:
        return doser, 1.0


@dataclass(frozen=True)
class JointCount:
    """The doser's count and the tank's, at one moment; from then on both go up together."""

    doser: str
    tank: Delivered
    count: Delivered

    def tank_at(self, count: Delivered) -> Delivered:
        """What the tank holds when the doser has counted `count`.

        >>> joint = JointCount("d", tank=Delivered(100.0, 100.0, 100.0), count=Delivered(500.0, 500.0, 500.0))
        >>> joint.tank_at(Delivered(520.0, 519.0, 520.0))
        Delivered(volume_ul=120.0, low_ul=119.0, high_ul=120.0)
        """
        return Delivered(
            self.tank.volume_ul + count.volume_ul - self.count.volume_ul,
            max(0.0, self.tank.low_ul + count.low_ul - self.count.high_ul),
            self.tank.high_ul + count.high_ul - self.count.low_ul,
        )

    def count_at(self, tank_ul: float) -> float:
        """The doser's count when the tank holds `tank_ul`."""
        return self.count.volume_ul + tank_ul - self.tank.volume_ul
