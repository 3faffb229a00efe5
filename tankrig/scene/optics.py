"""What lenses and walls do to light besides being ideal: blur, halo, veil, a wide lens, and faces that reflect.

Each part says nothing by default. What has a part pays for it; a scene without any is as ideal as it always was.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from tankrig.checked_toml import MOST
from tankrig.ranges import Within
from tankrig.scene.checks import CLOSED, in_ranges, require

MOST_HALO = 0.2
"""Share of the light; a lens that loses more is broken, or the number is a percentage."""
MOST_VEIL = 0.5
WIDEST_HALO = 10.0
"""Times the tank's longest side; wider light is even over all that is seen, and a sum over so far has no end."""

BlurSigma = Annotated[
    float,
    Within(0.0, MOST, "is negative; give the standard deviation of the blur in mm"),
]
Share = Annotated[
    float,
    Within(
        0.0, MOST_HALO, f"is outside 0 … {MOST_HALO:g}; give the share of light that goes into the halo (0.02 is 2 %)"
    ),
]


@dataclass(frozen=True)
class Blur:
    """A Gaussian that a lens makes of a point: of a camera on the plane z = Lz, of a projector on the wall x = 0.

    Parameters
    ----------
    sigma_mm
        Its standard deviation; 0 is sharp. Of a camera, in the middle of its picture.
    corner_mm
        Of a camera, the same in the corners of its picture; between them it goes with the square of the distance from
        the middle. None: as in the middle.
    """

    __pydantic_config__ = CLOSED
    sigma_mm: BlurSigma = 0.0
    corner_mm: BlurSigma | None = None

    def __post_init__(self) -> None:
        in_ranges(self)

    @property
    def widest_mm(self) -> float:
        """Largest standard deviation anywhere."""
        return max(self.sigma_mm, self.corner_mm or 0.0)

    @property
    def narrowest_mm(self) -> float:
        """Smallest standard deviation anywhere."""
        return self.sigma_mm if self.corner_mm is None else min(self.sigma_mm, self.corner_mm)


SHARP = Blur()


@dataclass(frozen=True)
class Halo:
    """A share of the light that a lens spreads widely: a Gaussian on the plane where a `Blur` is one.

    Parameters
    ----------
    share
        0 … 0.2 of the light.
    sigma_mm
        Standard deviation; a scene has none of more than ten times the tank's longest side.
    """

    __pydantic_config__ = CLOSED
    share: Share = 0.0
    sigma_mm: Annotated[
        float, Within(0.0, MOST, "is not positive; give the halo's standard deviation in mm", above=True)
    ] = 30.0

    def __post_init__(self) -> None:
        in_ranges(self)


NO_HALO = Halo()


@dataclass(frozen=True)
class WideLens:
    """The projector's lens as a disc across the x axis: light is sharp at one distance, and blurred off it.

    Parameters
    ----------
    diameter_mm
        Of the disc, whose middle is the projector's `position_mm`, no wider than it is far from the wall; 0 is a
        pinhole.
    focus_mm
        The x at which pictures are sharp: 0 on the wall, more in the water.
    """

    __pydantic_config__ = CLOSED
    diameter_mm: Annotated[float, Within(0.0, MOST, "is negative; give the lens's width in mm, 0 for a pinhole")] = 0.0
    focus_mm: Annotated[
        float, Within(0.0, MOST, "is before the wall; give the x, 0 or more, where pictures are sharp")
    ] = 0.0

    def __post_init__(self) -> None:
        in_ranges(self)


PINHOLE = WideLens()


SAID = ("clear", "diffuse")
"""Kinds of faces whose `reflectance` somebody has to say."""


@dataclass(frozen=True)
class Face:
    """One of the tank's walls, or its floor, as light in the water meets it.

    Parameters
    ----------
    kind
        "black": nothing comes back. "glass": a pane with air behind it, clear: Fresnel's reflection, total beyond the
        critical angle, set off along the wall by the pane's thickness. "clear": a mirror that sends back `reflectance`
        at any angle. "diffuse": `reflectance` comes back alike in all directions (Lambert).
    reflectance
        0 … 1, of "clear" and "diffuse"; a file has to say it.
    thickness_mm, index
        Of a pane of "glass" and its refractive index; None: the tank's `wall_mm` and `wall_index`.
    """

    __pydantic_config__ = CLOSED
    kind: Literal["black", "glass", "clear", "diffuse"] = "black"
    reflectance: Annotated[float, Within(0.0, 1.0, "is outside 0 … 1; give the share of the light that comes back")] = (
        0.0
    )
    thickness_mm: (
        Annotated[float, Within(0.0, MOST, "is thinner than nothing; give the pane's thickness in mm")] | None
    ) = None
    index: Annotated[float, Within(1.0, 3.0, "is outside 1 … 3; glass has 1.52, acrylic 1.49")] | None = None

    def __post_init__(self) -> None:
        require(
            self.kind in ("black", "glass", "clear", "diffuse"),
            f'kind = "{self.kind}" is unknown; use "black", "glass", "clear" or "diffuse"',
        )
        in_ranges(self)

    @property
    def dark(self) -> bool:
        """Whether no light comes back."""
        return self.kind == "black" or (self.kind != "glass" and self.reflectance == 0.0)


BLACK = Face()


@dataclass(frozen=True)
class Faces:
    """The five faces of the tank below its surface.

    Parameters
    ----------
    entry, far
        At x = 0, where the light comes in, and at x = Lx.
    left, right
        At y = −Ly/2 and at y = Ly/2.
    floor
        At z = 0.
    """

    __pydantic_config__ = CLOSED
    entry: Face = BLACK
    far: Face = BLACK
    left: Face = BLACK
    right: Face = BLACK
    floor: Face = BLACK

    @property
    def all(self) -> tuple[Face, Face, Face, Face, Face]:
        """Entry, far, left, right, floor."""
        return self.entry, self.far, self.left, self.right, self.floor

    @property
    def clear(self) -> tuple[Face | None, ...]:
        """Those by way of which light goes on as it came, in their places; None in the others'."""
        return tuple(face if face.kind in ("glass", "clear") else None for face in self.all)

    @property
    def dark(self) -> bool:
        """Whether no light comes back from any."""
        return all(face.dark for face in self.all)


ALL_BLACK = Faces()


def widest_halo_mm(size_mm: tuple[float, float, float]) -> float:
    """Standard deviation beyond which a halo in a tank of this size is none; what is set by default is one in any.

    >>> widest_halo_mm((240.0, 160.0, 120.0)), widest_halo_mm((1.0, 1.0, 2.0))
    (2400.0, 30.0)
    """
    return max(WIDEST_HALO * max(size_mm), Halo().sigma_mm)


def wider_than(sigma_mm: float, widths_mm: list[float]) -> bool:
    """Whether a blur is wider than the widest of what is lit.

    Examples
    --------
    >>> wider_than(5.0, [4.0, 2.0]), wider_than(0.3, [4.0])
    (True, False)
    """
    return sigma_mm > max(widths_mm, default=math.inf)
