"""What is written down about doses."""

from dataclasses import dataclass

from tankrig.devices import Delivered


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
    """

    delivered_ul: float
    delivered_low_ul: float
    delivered_high_ul: float
    complete: bool


@dataclass(frozen=True)
class Joint:
    """The doser's count and the tank's, at one moment; from then on both go up together."""

    doser: str
    tank: Delivered
    count: Delivered

    def tank_at(self, count: Delivered) -> Delivered:
        """What the tank holds when the doser has counted `count`.

        >>> joint = Joint("d", tank=Delivered(100.0, 100.0, 100.0), count=Delivered(500.0, 500.0, 500.0))
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
