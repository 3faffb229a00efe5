"""Where the simulated operator holds the board."""

from typing import Literal, get_args

import numpy as np

from tankrig.calibration.board import Board

from .bench_truth import TANK_MM, Array, TrueBench

Place = Literal["air", "floor", "flooded", "water", "slant", "flooded slant"]
"""Held before the camera; laid into the corner of the empty tank's floor, the same with water over it; held in the
water; held at a slant for camera and projector to see it, in the empty tank and in the water."""
Held = Place | Literal["trap", "card", "nothing"]
"""What a person may be asked for: a light trap in place of the board, the same with a white card on it, or "nothing",
which takes all away, and the camera sees the tank."""
PLACES: tuple[Place, ...] = get_args(Place)
FILLED: tuple[Place, ...] = ("flooded", "water", "flooded slant")


def board_pose(bench: TrueBench, board: Board, place: Place, number: int) -> tuple[Array, Array]:
    """Rotation (3, 3) and origin (3,) of the board in the tank's frame: X = origin + rotation · (board's x, y, z).

    Parameters
    ----------
    bench
        Where.
    board
        What.
    place
        See `Place`.
    number
        Of the view; no two are alike, but the board that is laid down stays where it is.
    """
    random = np.random.default_rng((number, PLACES.index(place)))
    if place == "air":
        return _before_camera(bench, board, number, random)
    if place in ("floor", "flooded"):
        return _in_corner(bench, board)
    if place == "water":
        steep, aside = np.deg2rad(random.uniform(0.0, 25.0)), random.uniform(0.0, 2.0 * np.pi)
        normal = np.array([np.sin(steep) * np.cos(aside), np.sin(steep) * np.sin(aside), np.cos(steep)])
        along = np.array([1.0, random.uniform(-0.15, 0.15), 0.0])
    else:
        steep, aside = np.deg2rad(random.uniform(35.0, 50.0 if number % 2 == 0 else 40.0)), random.uniform(-0.2, 0.2)
        normal = np.array([-np.sin(steep), np.sin(aside) * np.cos(steep), np.cos(steep)])
        along = np.array([0.0, -1.0, 0.0]) if number % 2 == 0 else np.array([1.0, 0.0, 0.0])
    rotation = _facing(normal, along)
    return rotation, _inside(bench, board, rotation, number, random)


def _before_camera(bench: TrueBench, board: Board, number: int, random: np.random.Generator) -> tuple[Array, Array]:
    """One after the other in the nine parts of the picture, nearer and farther, tilted all ways."""
    camera, (rows, columns) = bench.camera, bench.camera.shape
    across, down = number * 4 % 9 % 3 - 1, number * 4 % 9 // 3 - 1
    aim = np.array([(columns - 1) / 2 + 0.3 * across * columns, (rows - 1) / 2 + 0.27 * down * rows, 1.0])
    distance = (camera.centre_mm[2] - bench.level_mm) * random.uniform(0.75, 1.1)
    centre = camera.rotation.T @ (np.linalg.solve(camera.matrix, aim) * distance - camera.translation_mm)
    steep, aside = np.deg2rad(random.uniform(10.0, 40.0)), random.uniform(0.0, 2.0 * np.pi)
    normal = np.array([np.sin(steep) * np.cos(aside), np.sin(steep) * np.sin(aside), np.cos(steep)])
    turn = random.uniform(-0.6, 0.6) + (number % 2) * np.pi / 2
    rotation = _facing(normal, np.array([np.cos(turn), np.sin(turn), 0.0]))
    return rotation, centre - rotation @ _middle(bench, board)


def _in_corner(bench: TrueBench, board: Board) -> tuple[Array, Array]:
    """Printed side up, its first corner in the corner of the walls x = 0 and y = Ly/2, its long side along x."""
    c, s = np.cos(bench.laid_rad), np.sin(bench.laid_rad)
    rotation = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])
    x, y = board.margin_mm + bench.laid_mm[0], TANK_MM[1] / 2 - board.margin_mm - bench.laid_mm[1]
    return rotation, np.array([x, y, board.thickness_mm])


def _facing(normal: Array, along: Array) -> Array:
    """Printed side towards `normal`, the board's x as much as can be along `along`."""
    away = -normal / np.linalg.norm(normal)
    x = along - (along @ away) * away
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(away, x), away], axis=1)


def _inside(bench: TrueBench, board: Board, rotation: Array, number: int, random: np.random.Generator) -> Array:
    """Origin that puts the plate into the water, or where the water will be; one after the other along the tank."""
    width, height = board.size_mm
    m = board.margin_mm
    plate = [[-m, -m, 0], [width + m, -m, 0], [-m, height + m, 0], [width + m, height + m, 0]]
    spread = (np.array(plate) - _middle(bench, board)) @ rotation.T
    low, high = -spread.min(axis=0), -spread.max(axis=0)
    room = np.array([low + 4.0, np.array([TANK_MM[0], 0.0, bench.level_mm]) + high - 4.0])
    room[:, 1] = -TANK_MM[1] / 2 + low[1] + 2.0, TANK_MM[1] / 2 + high[1] - 2.0
    sides = np.array([number * 2 % 5 / 5, 0.85 * (number // 2 % 2), 0.85 * ((number // 2 + number) % 2)])
    part = sides + random.uniform(0.0, 0.15, 3)
    return np.asarray(room[0] + part * np.maximum(room[1] - room[0], 0.0) - rotation @ _middle(bench, board))


def _middle(bench: TrueBench, board: Board) -> Array:
    return np.array([*board.size_mm, 0.0]) / 2 * bench.board_scale
