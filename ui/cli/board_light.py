"""The projector's patterns on a board that is held still, as the camera sees them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape

from tankrig.calibration.board import Board, BoardView
from tankrig.calibration.gray_code import Decoded, decode
from tankrig.calibration.lit_corners import LitBoard, lit_corners
from tankrig.calibration.pictures import Pictures
from tankrig.calibration.projector_halo import CameraStray, seen_of_halves
from tankrig.calibration.radiometry import Radiometry
from tankrig.devices import CameraDevice, Pixels, Projector
from tankrig.pattern import Pattern
from ui.cli.boards import Holder


@dataclass(frozen=True)
class BoardLight:
    """Shows patterns on a board, and finds its corners in the projector's picture.

    Parameters
    ----------
    projector, camera
        Of the rig, open.
    pictures
        Of the camera.
    holder
        Of the board, who is told how far the patterns are and what is not used.
    board
        What is held.
    patterns, halves
        Gray code and phase shift; and halves of the picture, which tell the projector's halo, or none.
    radiometry, stray
        Of the camera, where they are calibrated.
    """

    projector: Projector
    camera: CameraDevice
    pictures: Pictures
    holder: Holder
    board: Board
    patterns: Sequence[Pattern]
    halves: Sequence[Pattern]
    radiometry: Radiometry | None
    stray: CameraStray | None

    def corners(self, _: BoardView) -> LitBoard | None:
        """The corners of the board as it is held now; None where they cannot be used, which is told."""
        frames = self._frames()
        self.projector.show(self.patterns[0])
        view = self.holder.look(frames[0], "  with the patterns")
        if view is None:
            return None
        code, of_halves = frames[: len(self.patterns)], frames[len(self.patterns) :]
        decoded = decode(code, self.projector.shape, self.camera.saturation)
        light, beside = self._brightness(frames[:2], of_halves, decoded)
        found = replace(lit_corners(view, decoded, self.board, light), halves=beside)
        if found.fault:
            self.holder.console.print(f"  [red]not used: {escape(found.fault)}[/red]", highlight=False)
            return None
        return found

    def _frames(self) -> list[Pixels]:
        """One of each pattern, then one of each half."""
        count = len(self.patterns) + len(self.halves)
        with self.holder.console.status("patterns") as status:
            return self.pictures.of_patterns(
                self.projector,
                (*self.patterns, *self.halves),
                lambda done: status.update(f"patterns: {done} of {count}"),
            )

    def _brightness(
        self, white_and_black: Sequence[Pixels], of_halves: Sequence[Pixels], decoded: Decoded
    ) -> tuple[NDArray[np.float32] | None, NDArray[Any]]:
        """The white picture's light, None where no radiometry tells it; and what halves light beside themselves."""
        none = np.zeros((0, 3))
        if not self.radiometry or not self.radiometry.knows(self.pictures.settings.gain):
            return None, none
        frames = *white_and_black, *of_halves
        white, black, *halves = (self.radiometry.corrected(frame, self.pictures.settings) for frame in frames)
        light, *lit = ((one - black).astype("f4") for one in (white, *halves))
        if not self.stray or not lit:
            return light, none
        left, right = lit
        return light, seen_of_halves((light, left, right), decoded, self.stray, self.projector.shape[1] // 2 - 0.5)
