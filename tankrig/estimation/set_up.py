"""Small errors of the set-up, fitted along with the medium: a beam too high, a picture moved, turned or scaled.

What they do to orders 1 and 2 is computed exactly, with no noise and whatever edges they carry over pixels; what they
do to the rest, which is smooth, is linear, with derivatives computed once.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.estimation.astray import ASTRAY
from tankrig.estimation.parameters import Block, Values
from tankrig.scene import Medium, Projector, Scene

Array = NDArray[np.float64]
Image = NDArray[np.floating]

USUAL = {"z_mm": 0.5, "y_mm": 0.5, "tilt_mrad": 2.0, "scale": 0.005}
"""What can be off, and by how much a carefully built rig may be."""
FAR_MM = 1e7
"""Distance of the pinhole that stands for collimated light from another direction."""
TOLERANCE = 0.01
STEP = 0.25
"""Step by which orders 1 and 2 are differenced, in standard deviations."""
BATCHES = 4
"""Shifted lattices of light paths for the derivatives of orders ≥ 3."""
SMOOTH_STEP = {"z_mm": 0.5, "y_mm": 0.5, "scale": 0.01}
"""Step by which orders ≥ 3 are differenced, in each term's unit."""
FURTHEST_OFF, LONGEST_MOVE = 6.0, 2.0
"""Standard deviations by which anything may be misaligned, at most and in one step."""


@dataclass(frozen=True)
class Misalignment:
    """What may be off in a scene, and what that does to its image.

    Parameters
    ----------
    scene
        As described.
    sd
        Standard deviation of each term: "z_mm" and "y_mm" move all light up and along y, "tilt_mrad" turns it about the
        vertical towards +y, "scale" is the share by which a pixel is larger than described.
    max_order
        Highest order of scattering that the image holds; None: all.
    smooth
        (terms, rows, columns) derivatives of orders ≥ 3 by the terms in standard deviations; None: 0.

    Raises
    ------
    SceneError
        When a term is unknown or its standard deviation not positive.
    """

    scene: Scene
    sd: Mapping[str, float]
    max_order: int | None = None
    smooth: Array | None = None

    def __post_init__(self) -> None:
        for name, sd in self.sd.items():
            if name not in USUAL:
                raise SceneError(f'nuisance = "{name}" is unknown; use one of {", ".join((*USUAL, *ASTRAY))}')
            if not (isinstance(sd, float | int) and math.isfinite(sd) and sd > 0.0):
                raise SceneError(f"nuisance {name} = {sd!r} is no standard deviation; give a positive number")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms, in the order of every vector of them."""
        return tuple(self.sd)

    def change(self, medium: Medium, off: Array) -> Array:
        """What the image gains, (rows, columns), when each term is off by so many standard deviations, (terms,)."""
        if not off.any():
            return np.zeros(self.scene.camera.shape)
        sharp = self._low_orders(self._moved(off), medium) - self._low_orders(self.scene, medium)
        return sharp if self.smooth is None else sharp + np.tensordot(off, self.smooth, 1)

    def slopes(self, medium: Medium, off: Array) -> Array:
        """Derivatives of `change` by the terms in standard deviations, (terms, rows, columns)."""
        found = []
        for unit in STEP * np.eye(len(off)):
            ahead, behind = (self._low_orders(self._moved(off + by), medium) for by in (unit, -unit))
            found.append((ahead - behind) / (2.0 * STEP))
        sharp = np.stack(found)
        return sharp if self.smooth is None else sharp + self.smooth

    def at(self, medium: Medium) -> "Misalignment":
        """The same with the derivatives of orders ≥ 3 at a medium."""
        if not self.sd or (self.max_order is not None and self.max_order < 3):
            return self
        return replace(self, smooth=np.stack([sd * self._smooth_slope(name, medium) for name, sd in self.sd.items()]))

    def _smooth_slope(self, name: str, medium: Medium) -> Array:
        """Derivative of orders ≥ 3 by one term, in its unit; the same paths on both sides."""
        if name == "tilt_mrad":
            # Light that comes from aside is, seen from above, light moved in proportion to its way.
            way_mm = self.scene.camera.pixel_mm * (np.arange(self.scene.camera.shape[1]) + 0.5)
            return 1e-3 * way_mm * self._smooth_slope("y_mm", medium)
        step = SMOOTH_STEP[name]
        ahead, behind = (self._high_orders(moved(self.scene, {name: by}), medium) for by in (step, -step))
        return (ahead - behind) / (2.0 * step)

    def _moved(self, off: Array) -> Scene:
        return moved(self.scene, {name: float(by) * sd for (name, sd), by in zip(self.sd.items(), off, strict=True)})

    def _low_orders(self, scene: Scene, medium: Medium) -> Array:
        from tankrig.light.tank import low_orders

        return low_orders(replace(scene, medium=medium), TOLERANCE, 1 if self.max_order == 1 else 2)

    def _high_orders(self, scene: Scene, medium: Medium) -> Array:
        from tankrig.light.tank import tank_image

        orders = tank_image(replace(scene, medium=medium), TOLERANCE, self.max_order, batches=BATCHES).orders
        high: Array = np.sum([image for order, image in orders.items() if order not in (1, 2)], axis=0)
        return high


@dataclass(frozen=True)
class SetUpBlock(Block):
    """What may be off in the set-up, in standard deviations.

    Parameters
    ----------
    misalignment
        What it does to the image.
    weight
        (k,) how many times its own precision the prior of each term weighs, see `overconfidence`.
    """

    misalignment: Misalignment
    weight: Array
    name: ClassVar[str] = "set-up"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms."""
        return self.misalignment.names

    @property
    def low(self) -> Array:
        """As far as is believed."""
        return np.full(len(self.names), -FURTHEST_OFF)

    @property
    def high(self) -> Array:
        """As far as is believed."""
        return np.full(len(self.names), FURTHEST_OFF)

    @property
    def longest_step(self) -> Array:
        """Edges that come off pixels' edges bend the way."""
        return np.full(len(self.names), LONGEST_MOVE)

    @property
    def prior_weight(self) -> Array:
        """As given."""
        return self.weight

    def added(self, values: Values, liquid: Medium) -> Image:
        """See `Misalignment.change`."""
        return self.misalignment.change(liquid, values[self.name])

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """See `Misalignment.slopes`."""
        return self.misalignment.slopes(liquid, values[self.name])


def moved(scene: Scene, off: Mapping[str, float]) -> Scene:
    """A scene with its light moved up by "z_mm", along y by "y_mm", turned by "tilt_mrad", seen at another "scale".

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.001, 0.02, 0.5), light, Camera("orthographic", (80, 120), 2.0))
    >>> moved(scene, {"z_mm": 0.5}).projector.beams[0].z_mm
    (58.5, 62.5)
    """
    scale, tilt = off.get("scale", 0.0), 1e-3 * off.get("tilt_mrad", 0.0)
    _, width, height = scene.tank.size_mm
    # A picture starts at the tank's corner; larger pixels shift its middle, and everything is shifted to be there.
    y_mm, z_mm = off.get("y_mm", 0.0) + 0.5 * scale * width, off.get("z_mm", 0.0)
    beams = tuple(
        replace(beam, y_mm=_inside(beam.y_mm, y_mm, -width / 2, width / 2), z_mm=_inside(beam.z_mm, z_mm, 0.0, height))
        for beam in scene.projector.beams
    )
    light, camera = scene.projector, scene.camera
    kind, position = light.kind, light.position_mm
    if kind == "collimated" and tilt:
        kind, position = "pinhole", (-FAR_MM, 0.0, 0.5 * height)
    if kind != "collimated" and position is not None:
        x, y, z = position
        position = (x, y + y_mm + tilt * x, z + z_mm)
    seen_from = camera.position_mm
    if seen_from is not None:
        seen_from = (seen_from[0], seen_from[1] + 0.5 * scale * width, seen_from[2])
    return replace(
        scene,
        projector=Projector(
            kind, beams, position, blur=light.blur, halo=light.halo, wide_lens=light.wide_lens,
            black_level=light.black_level,
        ),
        camera=replace(camera, pixel_mm=camera.pixel_mm * (1.0 + scale), position_mm=seen_from),
    )  # fmt: skip


def _inside(edges: tuple[float, float], by: float, low: float, high: float) -> tuple[float, float]:
    """Edges moved, the wall's part of them."""
    return max(low, edges[0] + by), min(high, edges[1] + by)
