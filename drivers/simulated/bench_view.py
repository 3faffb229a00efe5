"""What the camera of a simulated bench sees of a board, by the room's light and the projector's."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.board import Board
from tankrig.pattern import Pattern

from .bench_optics import (
    DEPTHS_MM,
    FINER,
    behind_camera_lens,
    blurred_part,
    camera_rays,
    illumination,
    thrown_in_depth,
    vignetting,
)
from .bench_poses import FILLED, Held, Place, board_pose
from .bench_trap import TrapInView
from .bench_truth import Array, TrueBench

Map = NDArray[np.float32]

_TEXELS_PER_MM = 10
_WHITE, _BLACK, _FLOOR = 0.85, 0.05, 0.03
_DIMMED = 0.05
"""The room's light when the projector is looked at."""
_NODE_PX, _SAMPLES = 12, 2
"""From node to node, and samples along each side of a pixel."""
_SAMPLING_PX2 = 0.032
"""Variance that sampling the print adds to edges besides pixels' own area; the lens's blur has that much less."""
_BESIDE = 0.5 * _SAMPLES**2 * (_SAMPLING_PX2 + (1.0 / 12.0 - 1.0 / 16.0))
_AS_PRINT = np.array([_BESIDE, 1.0 - 2.0 * _BESIDE, _BESIDE], np.float32)
"""Spreads the projector's light over neighbouring samples by the variance that the print gets by being sampled, and
the two samples of a pixel lack of its area's."""


class BoardInView:
    """One placing of a board; works out once where each camera pixel looks, then pictures for whatever is projected.

    Light is followed from the camera's pixels, four to each, to the board and from there to the projector's
    pixels: exactly on a grid of nodes, between them by cubic splines (error below 1e-4 pixels). Not in the picture are
    reflections, and what else the tank holds.

    Parameters
    ----------
    bench, board, place, number
        See `board_pose`.
    """

    def __init__(self, bench: TrueBench, board: Board, place: Place, number: int) -> None:
        self._bench, self._board, self._filled = bench, board, place in FILLED
        self._lit = place.endswith("slant")
        self._rotation, self._origin = board_pose(bench, board, place, number)
        self._fade = vignetting(
            bench.camera, *np.meshgrid(*(np.arange(n, dtype=float) for n in bench.camera.shape[::-1]))
        )
        self._box = self._bounding_box()
        self._look()

    def radiance(self, shown: Mapping[Pattern, float]) -> Array:
        """(rows, columns) W/mm²/sr towards the camera, by the patterns that are `shown` for parts of the time."""
        import cv2

        room = self._bench.room * (_DIMMED if self._lit else 1.0)
        picture = np.full(self._bench.camera.shape, _FLOOR * room, np.float32)
        if self._box is not None:
            top, bottom, left, right = self._box
            light = np.full(self._albedo.shape, room, np.float32)
            if self._lit:
                for pattern, part in shown.items():
                    light += np.float32(part * self._bench.full) * self._beam * self._thrown(pattern)
            size = (right - left, bottom - top)
            seen = self._albedo * light
            blurred: NDArray[np.floating] = picture.copy()
            picture[top:bottom, left:right] = cv2.resize(seen, size, interpolation=cv2.INTER_AREA)
            # Between samples, where half a pixel's blur is one: in whole pixels it would not be the Gaussian it is.
            blur_px = _SAMPLES * np.sqrt(max(self._bench.camera.blur_px**2 - _SAMPLING_PX2, 0.01))
            soft = blurred_part(self._bench, seen, float(blur_px), self._window)
            blurred[top:bottom, left:right] = cv2.resize(soft.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            return np.asarray(behind_camera_lens(self._bench, picture, blurred) * self._fade, np.float64)
        return np.asarray(behind_camera_lens(self._bench, picture, picture) * self._fade, np.float64)

    def _thrown(self, pattern: Pattern) -> Map:
        """Light of the projector's pixels where each sample is lit from, of that of a white one."""
        import cv2

        x, y = self._from
        place = self._depth * np.float32((len(DEPTHS_MM) - 1) / DEPTHS_MM[-1])
        first, last = int(place.min()), int(np.ceil(place.max()))  # a board is in few of the depths
        layers = thrown_in_depth(self._bench, pattern, self._filled, DEPTHS_MM[first : last + 1])
        seen: Map = np.zeros(x.shape, np.float32)
        for number, light in enumerate(layers):
            share = np.maximum(0.0, 1.0 - np.abs(place - first - number)) if len(layers) > 1 else np.ones(1)
            if share.any():
                there = cv2.remap(light, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
                seen += share.astype(np.float32) * there
        return np.asarray(cv2.sepFilter2D(seen, -1, _AS_PRINT, _AS_PRINT), np.float32)

    def _bounding_box(self) -> tuple[int, int, int, int] | None:
        """Rows and columns of the picture that the plate can be in."""
        rows, columns = self._bench.camera.shape
        y, x = np.linspace(-0.5, rows - 0.5, 81), np.linspace(-0.5, columns - 0.5, 121)
        board, _ = self.on_board(*np.meshgrid(x, y))
        inside = self._on_plate(board, 6.0)
        if not inside.any():
            return None
        found_y, found_x = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        top, bottom = y[max(found_y[0] - 1, 0)], y[min(found_y[-1] + 1, 80)]
        left, right = x[max(found_x[0] - 1, 0)], x[min(found_x[-1] + 1, 120)]
        return max(int(top), 0), min(int(bottom) + 1, rows), max(int(left), 0), min(int(right) + 1, columns)

    def _look(self) -> None:
        """Albedo and lighting of every sample in the box."""
        import cv2

        if self._box is None:
            return
        top, bottom, left, right = self._box
        rows, columns = self._bench.camera.shape
        nodes_y, nodes_x = (
            np.linspace(low - 0.5, high - 0.5, max(6, (high - low) // _NODE_PX))
            for low, high in ((top, bottom), (left, right))
        )
        fine = [
            (np.arange((high - low) * _SAMPLES) + 0.5) / _SAMPLES + low - 0.5
            for low, high in ((top, bottom), (left, right))
        ]
        self._window = fine[0] / (rows - 1) * 2.0 - 1.0, fine[1] / (columns - 1) * 2.0 - 1.0
        board, points = self.on_board(*np.meshgrid(nodes_x, nodes_y))
        u, v = (_spline(nodes_y, nodes_x, board[..., k], fine) for k in range(2))
        margin = self._board.margin_mm
        where = [((one + margin) * _TEXELS_PER_MM - 0.5).astype(np.float32) for one in (u, v)]
        step_mm = float(np.median(np.abs(np.diff(u, axis=1))) + np.median(np.abs(np.diff(v, axis=1))))
        print_out = cv2.GaussianBlur(_plate(self._board), (0, 0), max(0.35 * step_mm * _TEXELS_PER_MM, 0.1))
        self._albedo: Map = cv2.remap(
            print_out, where[0], where[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_FLOOR
        )
        if self._lit:
            pixels, strength = illumination(self._bench, points, self._rotation.T[:2], self._filled)
            self._from = [
                ((_spline(nodes_y, nodes_x, pixels[..., k], fine) + 0.5) * FINER - 0.5).astype(np.float32)
                for k in range(2)
            ]
            depth = _spline(nodes_y, nodes_x, points[..., 0], fine).astype(np.float32)
            self._depth: Map = np.clip(depth, DEPTHS_MM[0], DEPTHS_MM[-1])
            self._beam: Map = _spline(nodes_y, nodes_x, strength, fine).astype(np.float32)

    def on_board(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Where camera pixels look: (…, 3) in the board's own mm as it was meant to be, and in the tank's frame."""
        start, way = camera_rays(self._bench, np.stack([x, y], axis=-1), self._filled)
        normal = self._rotation[:, 2]
        point = start + (((self._origin - start) @ normal) / (way @ normal))[..., None] * way
        return (point - self._origin) @ self._rotation / self._bench.board_scale, point

    def _on_plate(self, board: Array, beyond_mm: float) -> NDArray[np.bool_]:
        reach = self._board.margin_mm + beyond_mm
        middle = np.array(self._board.size_mm) / 2
        return np.asarray((np.abs(board[..., :2] - middle) < middle + reach).all(axis=-1))


class BoardsInView:
    """The board, or a light trap, wherever it is held before the camera of a bench; nowhere at first.

    Parameters
    ----------
    bench
        Where.
    board
        What.
    """

    def __init__(self, bench: TrueBench, board: Board) -> None:
        self.bench = bench
        self._board = board
        self._view: BoardInView | TrapInView | None = None

    @property
    def held(self) -> bool:
        """Whether there is something before the camera."""
        return self._view is not None

    def hold(self, place: Held, number: int) -> None:
        """Put the board or the trap there, or take it away."""
        if place == "nothing":
            self._view = None
        elif place == "trap" or place == "card":  # of which a type checker knows what is left
            self._view = TrapInView(self.bench, number if place == "card" else None)
        else:
            self._view = BoardInView(self.bench, self._board, place, number)

    def radiance(self, shown: Mapping[Pattern, float]) -> Array:
        """See `BoardInView`; a trap is seen in the room's light alone."""
        if self._view is None:
            return np.zeros(self.bench.camera.shape)
        return self._view.radiance() if isinstance(self._view, TrapInView) else self._view.radiance(shown)


def _plate(board: Board) -> Map:
    """Albedo of the board with its white margin."""
    squares = board.picture(_TEXELS_PER_MM).astype(np.float32) / 255.0
    rim = round(board.margin_mm * _TEXELS_PER_MM)
    return np.asarray(_BLACK + (_WHITE - _BLACK) * np.pad(squares, rim, constant_values=1.0), np.float32)


def _spline(y: Array, x: Array, values: Array, fine: list[Array]) -> Array:
    from scipy.interpolate import RectBivariateSpline

    return np.asarray(RectBivariateSpline(y, x, values)(fine[0], fine[1]))
