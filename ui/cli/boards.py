"""What the commands that look at a board share: its description, who holds it, and what is seen of it meanwhile."""

import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Self, TypeVar

import click

from tankrig.errors import DeviceError
from ui.cli.options import FINITE
from ui.guide import console, emit, guided, picture, somebody, watching

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.calibration.board import Board, BoardView
    from tankrig.calibration.pictures import Pictures
    from tankrig.devices import CameraDevice

Command = TypeVar("Command", bound=Callable[..., Any])
_TRIES = 3
"""Views that are tried for each that is wanted, where nobody can be asked to hold the board better."""

_REQUESTS = {
    "air": "Hold the board before the camera, in air, another way than before: all over the picture, near and far, "
    "tilted by 30° to all sides.",
    "floor": "Lay the board on the floor of the empty tank, printed side up, its first corner in the corner of the "
    "entry wall and the wall y = +Ly/2, its long side along x.",
    "flooded": "Fill the tank without moving the board, and let the water settle.",
    "water": "Hold the board anywhere in the water, wholly under it.",
    "slant": "Hold the board in the empty tank at a slant, so that camera and projector see its printed side.",
    "flooded slant": "Hold the board in the water at a slant of about 45°, so that camera and projector see its "
    "printed side; nearer, farther, higher, lower than before.",
}


def board_options(command: Command) -> Command:
    """`--board`, `--square-mm`, … , which `board_of` makes a board of."""
    options = (
        click.option("--board", "squares", default="7x5", show_default=True, metavar="NxN", help="Columns and rows."),
        click.option(
            "--square-mm", type=FINITE, default=20.0, show_default=True, help="Side of a square, measured on the print."
        ),
        click.option(
            "--square-sd-mm",
            type=FINITE,
            default=0.0012,
            show_default=True,
            help="How well that is known: standard deviation.",
        ),
        click.option("--marker-mm", type=FINITE, default=15.0, show_default=True, help="Side of a marker."),
        click.option("--dictionary", default="DICT_4X4_50", show_default=True, help="Of its markers (OpenCV's name)."),
        click.option(
            "--margin-mm", type=FINITE, default=5.0, show_default=True, help="From the squares to the plate's edge."
        ),
        click.option("--thickness-mm", type=FINITE, default=3.0, show_default=True, help="Of the plate."),
        click.option("--exposure-ms", type=FINITE, help="Of the pictures; default: what suits the board."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def board_of(squares: str, **how: Any) -> "Board":
    """The board that the options describe."""
    from tankrig.calibration.board import Board

    try:
        columns, rows = (int(word) for word in squares.lower().split("x"))
    except ValueError:
        raise click.BadParameter(f"{squares!r} is not columns x rows, such as 7x5", param_hint="--board") from None
    return Board(columns, rows, **how)


@contextmanager
def opened(description: "RigFile", *kinds: str) -> Iterator[list[Any]]:
    """Devices of a rig, while no other program uses it."""
    from contextlib import ExitStack

    from drivers.registry import open_device
    from tankrig.run.rig import RigLock

    with ExitStack() as last_first:
        last_first.callback(RigLock(description.lock, description.name).close)
        devices = []
        for kind in kinds:
            settings = dict(getattr(description, kind))
            devices.append(open_device(settings.pop("driver"), settings))
            last_first.callback(devices[-1].close)
        yield devices


class Holder:
    """Asks for a board to be held, shows what the camera sees of it, and takes the pictures that are good.

    In a `with` statement it has the board taken away at the end, however that comes.

    Parameters
    ----------
    camera
        Open; a simulated one holds the board by itself.
    pictures
        Of it.
    board
        What is held.

    Raises
    ------
    click.UsageError
        When there is nobody to hold it.
    """

    def __init__(self, camera: "CameraDevice", pictures: "Pictures", board: "Board") -> None:
        self._hold = getattr(camera, "hold", None)
        if self._hold is None and not somebody():
            raise click.UsageError("somebody has to hold the board; run this on a terminal")
        self._camera, self._pictures, self._board = camera, pictures, board
        self.console = console()
        self._seen: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._hold is None:
            self._say("The board can be taken away.")
            return
        with suppress(DeviceError):  # a camera that is gone sees no board
            self._hold("nothing")

    def good_views(self, place: str, count: int, take: "Callable[[BoardView], _Taken | None]") -> "list[_Taken]":
        """So many of what `take` makes of good views; fewer where no better ones can be had.

        Parameters
        ----------
        place
            Where to hold the board.
        count
            How many.
        take
            Called with each good view while the board is still held; None: that one is not used.
        """
        taken: list[_Taken] = []
        number = 0
        # Who holds a board by himself holds it no better when asked again: not after as many failures, nor for ever.
        while len(taken) < count and (self._hold is None or number < (_TRIES * count if taken else count)):
            self._place(place, number)
            found = self.look(self._pictures.suit(), f"{place} {len(taken) + 1} of {count}")
            made = take(found) if found is not None else None
            number += 1
            if made is not None:
                taken.append(made)
        return taken

    def look(self, pixels: Any, name: str) -> "BoardView | None":
        """Say how well a picture shows the board; the view, where it can be used."""
        from rich.markup import escape

        from tankrig.calibration.board import find_board
        from tankrig.errors import ImageError

        picture(name, pixels, self._camera.saturation)
        try:
            view = find_board(pixels, self._board, self._camera.saturation)
        except ImageError as error:
            self._say(f"[red]{escape(f'{name}: {error}')}[/red]")
            return None
        self._seen.append(view.corners_px)
        self._say(f"{name}: {self._in_words(view)}")
        return None if view.fault else view

    def _say(self, line: str) -> None:
        self.console.print(line, highlight=False, soft_wrap=True)

    def _in_words(self, view: "BoardView") -> str:
        import numpy as np
        from rich.markup import escape

        from tankrig.calibration.camera import covered

        covers = covered(np.concatenate(self._seen), view.shape).mean()
        seen = f"{self._in_words_now(view)}, contrast {view.contrast:.0%}, covers {covers:.0%} so far"
        return seen + (f" [red]not used: {escape(view.fault)}[/red]" if view.fault else "")

    def _place(self, place: str, number: int) -> None:
        if self._hold is not None:
            self._hold(place, number)
            return
        if guided():
            emit("ask", _REQUESTS[place])
        else:
            self._say(f"{_REQUESTS[place]} Then Enter.")
        self._watch()

    def _watch(self) -> None:
        """Live feedback until there is an answer."""
        from tankrig.calibration.board import find_board
        from tankrig.errors import ImageError

        with watching(self.console) as show:
            while not select.select([sys.stdin], [], [], 0.0)[0]:
                pixels = self._pictures.suit()
                picture("the board", pixels, self._camera.saturation)
                try:
                    view = find_board(pixels, self._board, self._camera.saturation)
                    show(view.fault or f"good: {self._in_words_now(view)}")
                except ImageError as error:
                    show(str(error))
        if not sys.stdin.readline():  # nobody is there any more
            raise click.Abort

    def _in_words_now(self, view: "BoardView") -> str:
        return f"{len(view.ids)} corners, blur {view.blur_px:.1f} px, {view.saturated:.0%} saturated"


_Taken = TypeVar("_Taken")
