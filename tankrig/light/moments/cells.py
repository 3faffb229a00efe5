"""The coarse cells that the tank is cut into."""

from dataclasses import dataclass

from tankrig.scene import Tank


@dataclass(frozen=True)
class Cells:
    """Equal cells that fill the tank.

    Parameters
    ----------
    counts
        How many along x, y and z.
    size_mm
        Their sides.
    """

    counts: tuple[int, int, int]
    size_mm: tuple[float, float, float]

    @classmethod
    def of(cls, tank: Tank, side_mm: float) -> "Cells":
        """Cells with sides of about `side_mm`, at least four along each side of the tank.

        Examples
        --------
        >>> Cells.of(Tank((240.0, 160.0, 120.0)), 8.0).counts
        (30, 20, 15)
        """
        across, along, up = (max(4, round(side / side_mm)) for side in tank.size_mm)
        x, y, z = tank.size_mm
        return cls((across, along, up), (x / across, y / along, z / up))
