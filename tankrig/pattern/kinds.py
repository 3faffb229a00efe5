"""The kinds of patterns that a sequence can name, as data that draws itself for a projector."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from tankrig import bounded_reading
from tankrig.errors import SequenceError
from tankrig.pattern.pattern import Pattern
from tankrig.pattern.wall import Wall
from tankrig.ranges import Within, require_ranges
from tankrig.scene.description import CLOSED, Interval

Axis = Literal["columns", "rows"]
LEAST_PIXELS = 4
"""Of the projector in a period of a wave: with fewer, its four shifts are no longer the same wave."""
Level = Annotated[int, Within(1, 255, "is outside 1…255; give the brightness of lit pixels")]
MOST_MM = 1e6
"""Of a pattern; the sides of tanks are shorter."""
MOST_PX = 2**20


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise SequenceError(message)


class PatternKind(Protocol):
    """A pattern before it is drawn; a frozen dataclass whose first field `kind` is its name in files."""

    @property
    def kind(self) -> str:
        """Its name in sequence files."""

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """(rows, columns) pixels for the projector that lights `wall`."""


def draw(kind: PatternKind, wall: Wall, name: str = "") -> Pattern:
    """Draw a pattern for the projector that lights `wall`.

    Parameters
    ----------
    kind
        What to draw.
    wall
        The projector's shape, and where its pixels fall.
    name
        What to call it; the kind's name where empty.

    Raises
    ------
    SequenceError
        When it cannot be drawn with this projector.

    Examples
    --------
    >>> wall = Wall(shape=(60, 80), y_mm=(-80.0, 80.0), z_mm=(0.0, 120.0))
    >>> [beam.y_mm for beam in wall.beams(draw(Rays(y_mm=(-40.0, 0.0, 40.0), width_mm=4.0, z_mm=(58.0, 62.0)), wall))]
    [(-42.0, -38.0), (-2.0, 2.0), (38.0, 42.0)]
    """
    return Pattern(name or kind.kind, np.ascontiguousarray(kind.draw(wall), dtype=np.uint8))


@dataclass(frozen=True)
class _Kind:
    """What all kinds share: closed to unknown keys when read from a file, and ranges that their numbers are within."""

    __pydantic_config__: ClassVar = CLOSED

    def __post_init__(self) -> None:
        require_ranges(self, SequenceError)


@dataclass(frozen=True)
class Dark(_Kind):
    """No light at all."""

    kind: Literal["dark"] = "dark"

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        return np.zeros(wall.shape, np.uint8)


@dataclass(frozen=True)
class Full(_Kind):
    """Every pixel lit."""

    kind: Literal["full"] = "full"
    level: Level = 255

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        return np.full(wall.shape, self.level, np.uint8)


@dataclass(frozen=True)
class Sheet(_Kind):
    """One rectangle of light; flat and wide, a sheet."""

    y_mm: Interval
    z_mm: Interval
    kind: Literal["sheet"] = "sheet"
    level: Level = 255

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        return _lit(_inside(wall, "y", *self.y_mm), _inside(wall, "z", *self.z_mm), self.level)


@dataclass(frozen=True)
class Rays(_Kind):
    """Thin beams side by side.

    Parameters
    ----------
    y_mm
        Their centres.
    width_mm
        Of each along y.
    z_mm
        (low, high) of all.
    """

    y_mm: tuple[float, ...]
    z_mm: Interval
    width_mm: Annotated[float, Within(0.0, MOST_MM, "is no width; give a length in mm", above=True)] = 4.0
    kind: Literal["rays"] = "rays"
    level: Level = 255

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        _require(len(self.y_mm) > 0, "y_mm is empty; give the centre of each ray")
        half = self.width_mm / 2
        across = np.any([_inside(wall, "y", centre - half, centre + half) for centre in self.y_mm], axis=0)
        return _lit(across, _inside(wall, "z", *self.z_mm), self.level)


@dataclass(frozen=True)
class Stripes(_Kind):
    """Light that is switched on and off along y, one stripe centred on y = 0.

    Parameters
    ----------
    period_mm
        From stripe to stripe.
    duty
        Lit part of the period.
    y_mm, z_mm
        (low, high) of the striped area; the whole wall where left out. Only whole stripes are drawn.
    """

    period_mm: Annotated[float, Within(0.0, MOST_MM, "is not positive; give a length in mm", above=True)]
    duty: Annotated[
        float, Within(0.0, 1.0, "is outside 0 < duty < 1; give the lit part of a period", above=True, below=True)
    ] = 0.5
    y_mm: Interval | None = None
    z_mm: Interval | None = None
    kind: Literal["stripes"] = "stripes"
    level: Level = 255

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        low, high = self.y_mm or sorted(wall.y_mm)
        half = self.duty * self.period_mm / 2
        first, last = np.ceil((low + half) / self.period_mm), np.floor((high - half) / self.period_mm)
        # Those that light nothing of the wall, which an area without end would have without end, are left out.
        first = max(first, np.floor((min(wall.y_mm) - half) / self.period_mm))
        last = min(last, np.ceil((max(wall.y_mm) + half) / self.period_mm))
        _require(first <= last, f"period_mm = {self.period_mm}: no whole stripe fits into y_mm = [{low}, {high}]")
        _require(
            min(half * 2, self.period_mm - half * 2) >= wall.pixel_mm[1],
            f"period_mm = {self.period_mm} is finer than the projector's pixels, {wall.pixel_mm[1]:.3g} mm; raise it",
        )
        centres = self.period_mm * np.arange(first, last + 1)  # no more than the wall has pixels
        across = np.any([_inside(wall, "y", centre - half, centre + half) for centre in centres], axis=0)
        return _lit(across, _inside(wall, "z", *(self.z_mm or wall.z_mm)), self.level)


@dataclass(frozen=True)
class Wave(_Kind):
    """Light that rises and falls along y as (1 + cos 2π(y/period − shift))/2 of the light of `level`.

    Levels are chosen by what they were measured to give, so that the light is a cosine and not the numbers.

    Parameters
    ----------
    period_mm
        From crest to crest.
    z_mm
        (low, high) of the sheet that it is drawn in.
    shift
        By which part of a period the crest that would be at y = 0 is moved.
    y_mm
        (low, high) of the sheet; the whole wall where left out.
    """

    period_mm: Annotated[float, Within(0.0, MOST_MM, "is not positive; give a length in mm", above=True)]
    z_mm: Interval
    shift: Annotated[float, Within(-1.0, 1.0, "is outside −1…1; give a part of the period")] = 0.0
    y_mm: Interval | None = None
    kind: Literal["wave"] = "wave"
    level: Level = 255

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        finest = LEAST_PIXELS * wall.pixel_mm[1]
        _require(
            finest <= self.period_mm,
            f"period_mm = {self.period_mm} is finer than {LEAST_PIXELS} of the projector's pixels, {finest:.3g} mm; "
            "raise it",
        )
        wanted = 0.5 * (1.0 + np.cos(2 * np.pi * (wall.y_centres_mm / self.period_mm - self.shift)))
        known = wall.fractions[: self.level + 1]
        levels = np.abs(known - wanted[:, None] * known[-1]).argmin(axis=1)
        across = _inside(wall, "y", *(self.y_mm or sorted(wall.y_mm)))
        lit = np.outer(_inside(wall, "z", *self.z_mm), across)
        return np.where(lit, levels, 0).astype(np.uint8)


@dataclass(frozen=True)
class Cells(_Kind):
    """Cells side by side along y, in sheets at some heights, each with light of its own: what `tankrig advise` designs.

    Levels are chosen by what they were measured to give, so that each cell has the part of the light that it is said to
    have.

    Parameters
    ----------
    y_mm
        (low, high) of all cells.
    z_mm
        (low, high) of each sheet; they do not overlap.
    light
        Of each sheet, its cells' parts of the light of `level`, 0 … 1, in the order of rising y; as many in each.
    """

    y_mm: Interval
    z_mm: tuple[Interval, ...]
    light: tuple[tuple[float, ...], ...]
    kind: Literal["cells"] = "cells"
    level: Level = 255

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = {len(one) for one in self.light}
        _require(
            len(self.light) == len(self.z_mm) and len(counts) == 1 and min(counts) > 0,
            f"light has {[len(one) for one in self.light]} cells in {len(self.z_mm)} sheets; give each sheet of z_mm "
            "as many",
        )
        _require(
            all(0.0 <= part <= 1.0 for one in self.light for part in one),
            "light has a part outside 0…1; give each cell's part of the light",
        )
        _require(
            self.y_mm[0] < self.y_mm[1], f"y_mm = {list(self.y_mm)} is no width; give the lower and the upper edge"
        )
        edges = [edge for one in sorted(self.z_mm) for edge in one]
        _require(
            all(low < high for low, high in self.z_mm) and edges == sorted(edges),
            f"z_mm = {[list(one) for one in self.z_mm]} has a sheet without height, or two that overlap; part them",
        )

    @property
    def cell_mm(self) -> float:
        """Width of a cell."""
        return (self.y_mm[1] - self.y_mm[0]) / len(self.light[0])

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        _require(
            self.cell_mm >= wall.pixel_mm[1],
            f"cells of {self.cell_mm:.3g} mm are finer than the projector's pixels, {wall.pixel_mm[1]:.3g} mm; give "
            "fewer",
        )
        across = _inside(wall, "y", *self.y_mm)
        cell = np.clip((wall.y_centres_mm - self.y_mm[0]) // self.cell_mm, 0, len(self.light[0]) - 1).astype(int)
        known = wall.fractions[: self.level + 1]
        picture = np.zeros(wall.shape, np.uint8)
        for z_mm, light in zip(self.z_mm, self.light, strict=True):
            levels = np.abs(known - known[-1] * np.array(light)[:, None]).argmin(axis=1)
            picture[_inside(wall, "z", *z_mm)] = np.where(across, levels[cell], 0)
        return picture


@dataclass(frozen=True)
class GrayCode(_Kind):
    """One bit of the binary-reflected Gray code of the column's or the row's number; bit 0 is the coarsest."""

    bit: int
    axis: Axis = "columns"
    inverse: bool = False
    kind: Literal["gray-code"] = "gray-code"

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        count = wall.shape[1 if self.axis == "columns" else 0]
        bits = gray_code_bits(count)
        _require(0 <= self.bit < bits, f"bit = {self.bit} is outside 0…{bits - 1}, which {count} {self.axis} need")
        number = np.arange(count)
        lit = ((number ^ (number >> 1)) >> (bits - 1 - self.bit) & 1).astype(bool)
        return _along(self.axis, np.where(lit ^ self.inverse, 255, 0), wall)


@dataclass(frozen=True)
class PhaseShift(_Kind):
    """A sine along one axis, shifted by `step` of `steps` parts of its period."""

    period_px: Annotated[float, Within(2.0, MOST_PX, "is finer than the pixels, or than none; give 2 or more")]
    step: int
    steps: int = 4
    axis: Axis = "columns"
    kind: Literal["phase-shift"] = "phase-shift"

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        _require(0 <= self.step < self.steps, f"step = {self.step} is outside 0…{self.steps - 1}")
        count = wall.shape[1 if self.axis == "columns" else 0]
        phase = 2 * np.pi * (np.arange(count) / self.period_px - self.step / self.steps)
        return _along(self.axis, np.round(127.5 * (1 + np.cos(phase))), wall)


@dataclass(frozen=True)
class Checker(_Kind):
    """A checkerboard; fine ones separate what was scattered once from what was scattered often."""

    cell_px: Annotated[int, Within(1, MOST_PX, "is no cell; give 1 or more")]
    inverse: bool = False
    kind: Literal["checker"] = "checker"

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        row, column = np.indices(wall.shape) // self.cell_px
        return np.where((row + column + self.inverse) % 2 == 0, 255, 0).astype(np.uint8)


@dataclass(frozen=True)
class Hadamard(_Kind):
    """One of the size² two-dimensional Hadamard patterns of size × size cells, in natural order.

    Cell (r, c) of pattern `index` = i·size + j is lit where (−1)^(popcount(i & r) + popcount(j & c)) = 1.
    """

    index: int
    size: int = 16
    inverse: bool = False
    kind: Literal["hadamard"] = "hadamard"

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        size = self.size
        _require(
            size >= 2 and size & (size - 1) == 0 and size <= min(wall.shape),
            f"size = {size} is no power of two that the projector's {min(wall.shape)} rows can show",
        )
        _require(0 <= self.index < size**2, f"index = {self.index} is outside 0…{size**2 - 1}")
        i, j = divmod(self.index, size)
        row, column = (np.arange(count) * size // count for count in wall.shape)
        odd = (np.bitwise_count(i & row)[:, None] + np.bitwise_count(j & column)) % 2 == 1
        return np.where(odd ^ self.inverse, 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class ImageFile(_Kind):
    """An 8-bit grey picture in the projector's shape, from a file; a path relative to the sequence's folder."""

    path: str
    kind: Literal["image"] = "image"

    def draw(self, wall: Wall) -> NDArray[np.uint8]:
        """See `PatternKind`."""
        try:
            picture = bounded_reading.picture(Path(self.path))
        except FileNotFoundError as error:
            raise SequenceError(f"{self.path}: does not exist; give the path of a picture") from error
        except (OSError, ValueError) as error:
            why = bounded_reading.reason(error)
            raise SequenceError(
                f"{self.path}: is not a picture that can be read ({why}); give an 8-bit grey PNG"
            ) from error
        _require(
            picture.dtype == np.uint8 and picture.shape == wall.shape,
            f"{self.path}: has shape {list(picture.shape)} and type {picture.dtype}; "
            f"give 8-bit grey pixels in the projector's shape {list(wall.shape)}",
        )
        return np.asarray(picture, np.uint8)


KINDS = (Dark, Full, Sheet, Rays, Stripes, Wave, Cells, GrayCode, PhaseShift, Checker, Hadamard, ImageFile)
"""All kinds, in the order in which a person meets them."""

AnyKind = Dark | Full | Sheet | Rays | Stripes | Wave | Cells | GrayCode | PhaseShift | Checker | Hadamard | ImageFile


def gray_code_bits(count: int) -> int:
    """How many bits number `count` columns or rows."""
    return max(1, (count - 1).bit_length())


def gray_code_series(wall: Wall) -> tuple[GrayCode, ...]:
    """All patterns that number the projector's columns and rows, each followed by its inverse."""
    axes: tuple[tuple[Axis, int], ...] = (("columns", wall.shape[1]), ("rows", wall.shape[0]))
    return tuple(
        GrayCode(bit, axis, inverse)
        for axis, count in axes
        for bit in range(gray_code_bits(count))
        for inverse in (False, True)
    )


def _inside(wall: Wall, name: Literal["y", "z"], low: float, high: float) -> NDArray[np.bool_]:
    """Which columns (y) or rows (z) have their centre in [low, high]."""
    _require(low < high, f"{name}_mm = [{low:g}, {high:g}] has no width; give [low, high] with low < high")
    centres = wall.y_centres_mm if name == "y" else wall.z_centres_mm
    inside: NDArray[np.bool_] = (centres >= low) & (centres <= high)
    edges = sorted(wall.y_mm if name == "y" else wall.z_mm)
    _require(
        bool(inside.any()),
        f"{name}_mm = [{low:g}, {high:g}] lights no pixel: the projector reaches {name} = {edges[0]:g}…{edges[1]:g} mm "
        f"in pixels of {wall.pixel_mm[name == 'y']:.3g} mm; move or widen it",
    )
    return inside


def _lit(columns: NDArray[np.bool_], rows: NDArray[np.bool_], level: int) -> NDArray[np.uint8]:
    return (np.outer(rows, columns) * level).astype(np.uint8)


def _along(axis: Axis, levels: NDArray[np.generic], wall: Wall) -> NDArray[np.uint8]:
    line = levels.astype(np.uint8)
    return np.broadcast_to(line if axis == "columns" else line[:, None], wall.shape).copy()
