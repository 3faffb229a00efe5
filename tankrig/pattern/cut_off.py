"""Light that a pattern asks for beyond the wall that the projector can light: it is cut off, and a person is told."""

from collections.abc import Iterator

from tankrig.pattern.kinds import Cells, PatternKind, Rays, Sheet, Stripes, Wave
from tankrig.pattern.wall import Wall
from tankrig.scene.description import Interval, Tank


def cut_off(kind: PatternKind, wall: Wall, tank: Tank) -> Iterator[str]:
    """Where a pattern reaches beyond the tank's wall or the projector's picture: a sentence for each direction.

    Patterns that say no mm, such as a full one, ask for what there is, and nothing of them is cut off. Less than half
    of the projector's pixel counts for nothing.

    Parameters
    ----------
    kind
        The pattern.
    wall
        What the projector can light.
    tank
        Whose wall is lit.

    Examples
    --------
    >>> wall = Wall((120, 160), (-80.0, 80.0), (0.0, 150.0))
    >>> list(cut_off(Sheet((-60.0, 60.0), (110.0, 130.0)), wall, Tank()))
    ["z = 110 … 130 mm reaches beyond the tank's wall, 0 … 120 mm; what is beyond is cut off"]
    >>> list(cut_off(Rays((-79.0, 0.0), (58.0, 62.0), width_mm=4.0), wall, Tank()))
    ["y = -81 … 2 mm reaches beyond the tank's wall, -80 … 80 mm; what is beyond is cut off"]
    >>> list(cut_off(Sheet((-80.0, 80.0), (58.0, 62.0)), wall, Tank()))
    []
    """
    _, width, height = tank.size_mm
    tall, wide = wall.pixel_mm
    across, up = _asked(kind)
    for name, asked, of_tank, shown, pixel_mm in (
        ("y", across, (-0.5 * width, 0.5 * width), wall.y_mm, wide),
        ("z", up, (0.0, height), wall.z_mm, tall),
    ):
        picture = (min(shown), max(shown))
        for edges, whose in ((of_tank, "tank's wall"), (picture, "projector's picture")):
            if asked and (asked[0] < edges[0] - 0.5 * pixel_mm or asked[1] > edges[1] + 0.5 * pixel_mm):
                yield (
                    f"{name} = {asked[0]:g} … {asked[1]:g} mm reaches beyond the {whose}, {edges[0]:g} … {edges[1]:g} "
                    "mm; what is beyond is cut off"
                )
                break


def _asked(kind: PatternKind) -> tuple[Interval | None, Interval | None]:
    """Along y and z, from where to where a pattern is to be lit; None where it does not say."""
    match kind:
        case Rays() if kind.y_mm:
            half = 0.5 * kind.width_mm
            return (min(kind.y_mm) - half, max(kind.y_mm) + half), kind.z_mm
        case Sheet() | Stripes() | Wave():
            return kind.y_mm, kind.z_mm
        case Cells():
            return kind.y_mm, (min(low for low, _ in kind.z_mm), max(high for _, high in kind.z_mm))
        case _:
            return None, None
