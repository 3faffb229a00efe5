"""The finite tank: orders 1 and 2 exact, all further orders by light paths on a lattice."""

from tankrig.light.tank.model import tank_image

__all__ = ["tank_image"]
