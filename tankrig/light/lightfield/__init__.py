"""The paper's light-field convolution: the tank's light and camera rays in a medium without walls.

spectrum (the kernel per wave vector) → kernel (in space) → convolution (with the lit volume, along the camera's rays)
→ model (images by order).
"""

from tankrig.light.lightfield.model import left_out, lightfield_orders

__all__ = ["left_out", "lightfield_orders"]
