"""A bench: what stays the same from pattern to pattern and from dose to dose, and the scenes it makes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.pattern.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.ranges import Within, require_ranges
from tankrig.scene.description import CLOSED, Beam, Camera, Medium, Projector, Scene, Tank, Vector
from tankrig.scene.footprint import typical_pixel_mm
from tankrig.scene.projection import beams_and_detail, warn_of_detail


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
        "collimated", "pinhole" from `light_position_mm`, or "calibrated" as `projector` is.
    camera
        Its frames have the camera's shape.
    light_position_mm
        Of the projector's pinhole, x < 0.
    projector
        As calibrated: then each of its pixels lights what it does behind the wall, whatever `wall` says, on which
        patterns are still drawn.
    polarisation
        Largest degree of the light's linear polarisation, 0 … 1; None where nobody has measured it. Models take light
        for unpolarised: `tankrig validate` counts what this may change.

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
    light: Literal["collimated", "pinhole", "calibrated"]
    camera: Camera
    light_position_mm: Vector | None = None
    projector: Projector | None = None
    polarisation: Annotated[float, Within(0.0, 1.0, "is outside 0 … 1; give a degree, 0 for none")] | None = None

    def __post_init__(self) -> None:
        require_ranges(self, SceneError)
        if self.light == "pinhole" and (self.light_position_mm is None or self.light_position_mm[0] >= 0.0):
            raise SceneError("light_position_mm is missing; a pinhole needs [x, y, z] in mm with x < 0")
        if self.light == "calibrated" and (self.projector is None or self.projector.matrix is None):
            raise SceneError('projector is missing; light = "calibrated" needs its matrix, rotation and position_mm')
        if self.camera.kind == "calibrated":
            pixel_mm = typical_pixel_mm(self.camera, self.tank)
            object.__setattr__(self, "camera", replace(self.camera, pixel_mm=pixel_mm))

    def scene(self, pattern: Pattern, medium: Medium) -> Scene:
        """What the camera looks at when the projector shows `pattern`.

        Raises
        ------
        SceneError
            When the pattern lights nothing in the tank.
        """
        if self.light == "calibrated":
            assert self.projector is not None
            beams, coarser = _lit(self.tank, self.projector, self.wall.response, _Shown(pattern.hash, pattern.pixels))
            warn_of_detail(coarser, stacklevel=3)
            return Scene(self.tank, medium, replace(self.projector, beams=beams), self.camera)
        beams = self.wall.beams(pattern, self.tank)
        if not beams:
            raise SceneError(f'pattern "{pattern.name}" lights nothing in the tank, so there is nothing to predict')
        return Scene(self.tank, medium, Projector(self.light, beams, self.light_position_mm), self.camera)


@dataclass(frozen=True)
class _Shown:
    """Pixels of a pattern, told apart by their hash."""

    hash: str
    pixels: NDArray[np.uint8] = field(compare=False)


@lru_cache(maxsize=16)
def _lit(
    tank: Tank, projector: Projector, response: tuple[float, ...], shown: _Shown
) -> tuple[tuple[Beam, ...], float]:
    """Beams of a picture and their detail; checks before a run, its fit and its report ask for the same ones."""
    if response:  # measured, and truer than any power law
        return beams_and_detail(tank, replace(projector, gamma=1.0), np.array(response)[shown.pixels])
    return beams_and_detail(tank, projector, shown.pixels)


@dataclass(frozen=True)
class KnownScenes:
    """A bench of which only the scenes are known that were photographed on it: that of somebody else's frames.

    Parameters
    ----------
    scenes
        By the name of their pattern; all of one tank and one camera.

    Raises
    ------
    SceneError
        When there is none, or tanks or cameras differ.
    """

    scenes: Mapping[str, Scene]

    def __post_init__(self) -> None:
        seen = list(self.scenes.items())
        if not seen:
            raise SceneError("there is no scene; give that of a frame with light")
        (first, known), *others = seen
        for name, scene in others:
            if (scene.tank, scene.camera) != (known.tank, known.camera):
                raise SceneError(
                    f'the scenes "{first}" and "{name}" are of different tanks or cameras; a run has one of each, so '
                    "make a run of each"
                )

    @property
    def tank(self) -> Tank:
        """The water."""
        return next(iter(self.scenes.values())).tank

    @property
    def camera(self) -> Camera:
        """Its frames have the camera's shape."""
        return next(iter(self.scenes.values())).camera

    def scene(self, pattern: Pattern, medium: Medium) -> Scene:
        """What the camera looked at when `pattern` was shown.

        Raises
        ------
        SceneError
            When nobody has said.
        """
        if pattern.name not in self.scenes:
            raise SceneError(f'nobody has said what the pattern "{pattern.name}" lights; give its scene')
        return replace(self.scenes[pattern.name], medium=medium)
