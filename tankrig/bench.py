"""A bench: what stays the same from pattern to pattern and from dose to dose, and the scenes it makes."""

from dataclasses import dataclass
from typing import Literal

from tankrig.errors import SceneError
from tankrig.pattern.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.scene.description import CLOSED, Camera, Medium, Projector, Scene, Tank, Vector


@dataclass(frozen=True)
class Bench:
    """Geometry and radiometry of a rig, as calibrated.

    Parameters
    ----------
    tank
        The water.
    wall
        Where the projector's pixels fall on the plane x = 0.
    light
        "collimated", or "pinhole" from `light_position_mm`.
    camera
        Its frames have the camera's shape.
    light_position_mm
        Of the projector's pinhole, x < 0.

    Examples
    --------
    >>> from tankrig.pattern.kinds import Sheet, draw
    >>> bench = Bench(
    ...     Tank(), Wall((120, 160), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (80, 120), 2.0)
    ... )
    >>> sheet = draw(Sheet((-60.0, 60.0), (58.0, 62.0)), bench.wall)
    >>> bench.scene(sheet, Medium(0.0002, 0.0198, 0.5)).projector.beams[0].power
    480.0
    """

    __pydantic_config__ = CLOSED
    tank: Tank
    wall: Wall
    light: Literal["collimated", "pinhole"]
    camera: Camera
    light_position_mm: Vector | None = None

    def __post_init__(self) -> None:
        if self.light == "pinhole" and (self.light_position_mm is None or self.light_position_mm[0] >= 0.0):
            raise SceneError("light_position_mm is missing; a pinhole needs [x, y, z] in mm with x < 0")

    def scene(self, pattern: Pattern, medium: Medium) -> Scene:
        """What the camera looks at when the projector shows `pattern`.

        Raises
        ------
        SceneError
            When the pattern lights nothing in the tank.
        """
        beams = self.wall.beams(pattern, self.tank)
        if not beams:
            raise SceneError(f'pattern "{pattern.name}" lights nothing in the tank, so there is nothing to predict')
        return Scene(self.tank, medium, Projector(self.light, beams, self.light_position_mm), self.camera)
