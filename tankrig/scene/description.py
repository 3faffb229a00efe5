"""What is in the tank, what lights it and what looks at it: frozen, checked, in mm and W."""

import math
from dataclasses import dataclass, field
from typing import Literal, SupportsFloat

from tankrig.errors import SceneError

Vector = tuple[float, float, float]
Interval = tuple[float, float]

CLOSED = {"extra": "forbid", "strict": True}
"""Read by the scene file's validation: an unknown key is refused, and a number in quotes is not a number."""


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise SceneError(message)


def _finite(name: str, given: object) -> float:
    value = float(given) if isinstance(given, SupportsFloat) else math.nan
    _require(math.isfinite(value), f"{name} = {given!r} is not a finite number; give a finite one")
    return value


def _number(owner: object, name: str) -> float:
    """Make a field a finite float, in place."""
    value = _finite(name, getattr(owner, name))
    object.__setattr__(owner, name, value)  # the only way to set a field of a frozen dataclass
    return value


def _numbers(owner: object, name: str, count: int) -> tuple[float, ...]:
    """Make a field a tuple of `count` finite floats, in place."""
    given = tuple(getattr(owner, name))
    _require(len(given) == count, f"{name} = {list(given)} has {len(given)} numbers; give {count}")
    values = tuple(_finite(f"{name}[{index}]", value) for index, value in enumerate(given))
    object.__setattr__(owner, name, values)
    return values


@dataclass(frozen=True)
class Tank:
    """A box of water: x ∈ [0, Lx], y ∈ [−Ly/2, Ly/2], z ∈ [0, Lz]; light enters at x = 0, the surface is z = Lz.

    Parameters
    ----------
    size_mm
        (Lx, Ly, Lz).
    surface
        "matched": nothing happens at z = Lz. "fresnel": water below, air above. The other faces are black and matched.
    refractive_index
        Of the water; read when the surface is "fresnel".
    """

    __pydantic_config__ = CLOSED
    size_mm: Vector = (240.0, 160.0, 120.0)
    surface: Literal["matched", "fresnel"] = "matched"
    refractive_index: float = 1.33

    def __post_init__(self) -> None:
        _require(
            min(_numbers(self, "size_mm", 3)) > 0.0,
            f"size_mm = {list(self.size_mm)} has a side that is not positive; give three lengths in mm",
        )
        _require(
            1.0 <= _number(self, "refractive_index") <= 3.0,
            f"refractive_index = {self.refractive_index} is outside 1…3; water has 1.33",
        )
        _require(
            self.surface in ("matched", "fresnel"), f'surface = "{self.surface}" is unknown; use "matched" or "fresnel"'
        )

    @property
    def surface_index(self) -> float:
        """Refractive index that the surface shows: 1 when matched."""
        return self.refractive_index if self.surface == "fresnel" else 1.0


@dataclass(frozen=True)
class Medium:
    """Absorption and scattering coefficients in 1/mm and the asymmetry g of a Henyey–Greenstein phase function.

    Examples
    --------
    >>> milk = Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.5)
    >>> round(milk.sigma_t, 6), round(milk.albedo, 6)
    (0.02, 0.99)
    """

    __pydantic_config__ = CLOSED
    sigma_a: float
    sigma_s: float
    g: float

    def __post_init__(self) -> None:
        for name in ("sigma_a", "sigma_s"):
            value = _number(self, name)
            _require(value >= 0.0, f"{name} = {value} is negative; give a coefficient in 1/mm that is zero or more")
        _require(
            -1.0 < _number(self, "g") < 1.0,
            f"g = {self.g} is outside −1 < g < 1; give the mean cosine of one scattering",
        )

    @property
    def sigma_t(self) -> float:
        """Extinction σt = σa + σs in 1/mm."""
        return self.sigma_a + self.sigma_s

    @property
    def albedo(self) -> float:
        """Single-scattering albedo ϖ = σs/σt; 0 for clear water."""
        return self.sigma_s / self.sigma_t if self.sigma_t > 0.0 else 0.0


@dataclass(frozen=True)
class Beam:
    """A rectangle of the plane x = 0 that the projector lights.

    Parameters
    ----------
    y_mm, z_mm
        (low, high) edges in mm.
    irradiance
        Flux per area of the plane x = 0, W/mm² (the cosine is included).
    """

    __pydantic_config__ = CLOSED
    y_mm: Interval
    z_mm: Interval
    irradiance: float = 1.0

    def __post_init__(self) -> None:
        for name in ("y_mm", "z_mm"):
            low, high = _numbers(self, name, 2)
            _require(low < high, f"{name} = [{low}, {high}] has no width; give [low, high] with low < high")
        _require(
            _number(self, "irradiance") >= 0.0, f"irradiance = {self.irradiance} is negative; give W/mm², zero or more"
        )

    @property
    def power(self) -> float:
        """Flux through the rectangle, W."""
        return self.irradiance * (self.y_mm[1] - self.y_mm[0]) * (self.z_mm[1] - self.z_mm[0])


@dataclass(frozen=True)
class Projector:
    """What lights the tank through x = 0.

    Parameters
    ----------
    kind
        "collimated": along +x. "pinhole": straight rays from `position_mm`.
    beams
        Rectangles of the plane x = 0; where they overlap they add.
    position_mm
        Of the pinhole, outside the tank (x < 0); ignored when collimated.
    """

    __pydantic_config__ = CLOSED
    kind: Literal["collimated", "pinhole"]
    beams: tuple[Beam, ...]
    position_mm: Vector | None = None

    def __post_init__(self) -> None:
        _require(
            self.kind in ("collimated", "pinhole"), f'kind = "{self.kind}" is unknown; use "collimated" or "pinhole"'
        )
        object.__setattr__(self, "beams", tuple(self.beams))
        _require(len(self.beams) > 0, "beams = [] lights nothing; give at least one beam")
        if self.kind == "pinhole":
            _require(
                self.position_mm is not None, "position_mm is missing; a pinhole projector needs [x, y, z] with x < 0"
            )
            position = _numbers(self, "position_mm", 3)
            _require(
                position[0] < 0.0,
                f"position_mm = {list(position)} is not outside the wall x = 0; give x < 0",
            )


@dataclass(frozen=True)
class Camera:
    """What looks down on the tank: a grid of square pixels on the plane z = Lz that starts at x = 0, y = −Ly/2.

    Parameters
    ----------
    kind
        "orthographic": looks along −z. "pinhole": looks from `position_mm`.
    shape
        (rows along y, columns along x).
    pixel_mm
        Side of a pixel on the plane z = Lz.
    position_mm
        Of the pinhole, above the water; ignored when orthographic.
    """

    __pydantic_config__ = CLOSED
    kind: Literal["orthographic", "pinhole"]
    shape: tuple[int, int]
    pixel_mm: float
    position_mm: Vector | None = None

    def __post_init__(self) -> None:
        _require(
            self.kind in ("orthographic", "pinhole"),
            f'kind = "{self.kind}" is unknown; use "orthographic" or "pinhole"',
        )
        object.__setattr__(self, "shape", tuple(self.shape))
        _require(
            len(self.shape) == 2 and min(self.shape) >= 1 and max(self.shape) <= 16384,
            f"shape = {list(self.shape)} is no picture; give [rows, columns] between 1 and 16384",
        )
        _require(
            _number(self, "pixel_mm") > 0.0,
            f"pixel_mm = {self.pixel_mm} is not positive; give the side of a pixel in mm",
        )
        if self.kind == "pinhole":
            _require(
                self.position_mm is not None, "position_mm is missing; a pinhole camera needs [x, y, z] above the water"
            )
            _numbers(self, "position_mm", 3)


@dataclass(frozen=True)
class Scene:
    """Everything a model needs to know: tank, medium, projector, camera.

    Raises
    ------
    SceneError
        When a beam leaves the wall x = 0 or a pinhole camera is not above the water.

    Examples
    --------
    >>> scene = Scene(
    ...     tank=Tank(),
    ...     medium=Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.5),
    ...     projector=Projector("collimated", beams=(Beam((-2.0, 2.0), (58.0, 62.0)),)),
    ...     camera=Camera("orthographic", shape=(80, 120), pixel_mm=2.0),
    ... )
    >>> scene.projector.beams[0].power
    16.0
    """

    __pydantic_config__ = CLOSED
    tank: Tank
    medium: Medium
    projector: Projector
    camera: Camera
    source: str = field(default="", repr=False, compare=False)
    """The file the scene came from, for messages."""

    def __post_init__(self) -> None:
        _, width, height = self.tank.size_mm
        for index, beam in enumerate(self.projector.beams):
            for name, (low, high), (bottom, top) in (
                ("y_mm", beam.y_mm, (-width / 2, width / 2)),
                ("z_mm", beam.z_mm, (0.0, height)),
            ):
                _require(
                    bottom <= low and high <= top,
                    f"projector.beams[{index}].{name} = [{low}, {high}] leaves the tank, whose wall spans "
                    f"[{bottom:g}, {top:g}] mm; move or cut the beam",
                )
        if self.camera.kind == "pinhole":
            assert self.camera.position_mm is not None
            _require(
                self.camera.position_mm[2] > height,
                f"camera.position_mm = {list(self.camera.position_mm)} is not above the water, "
                f"z = {height:g} mm; raise it",
            )
