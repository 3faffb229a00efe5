"""Boards are found and judged, and the projector's light on them decoded; what is wrong with a picture is named."""

import re

import numpy as np
import pytest

from drivers.simulated.bench_truth import random_bench
from drivers.simulated.bench_view import BoardInView
from tankrig.calibration.board import Board, find_board
from tankrig.calibration.gray_code import decode, gray_code_patterns
from tankrig.errors import ImageError

from .calibrated_bench import BOARD, SMALL, Photographer

SATURATION = 4095


@pytest.fixture(scope="module")
def photographer() -> Photographer:
    return Photographer(random_bench(1, *SMALL))


# Gray code


def seen(shape: tuple[int, int], gamma: float, ambient: float, noise: float) -> tuple[list[np.ndarray], np.ndarray]:
    """What a camera with twice the pixels sees of the patterns on grey paper, and the true columns."""
    import cv2

    random = np.random.default_rng(3)
    y, x = np.mgrid[0 : 2 * shape[0], 0 : 2 * shape[1]].astype(np.float32)
    across, down = 0.52 * x - 3.0, 0.49 * y + 0.02 * x
    albedo = np.where((x // 37 + y // 31) % 2, 0.9, 0.25)
    frames = []
    for pattern in gray_code_patterns(shape):
        light = cv2.GaussianBlur(((pattern.pixels / 255.0) ** gamma).astype(np.float32), (0, 0), 0.7)
        lit = cv2.remap(light, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        values = albedo * (3000.0 * lit + ambient) + random.normal(0.0, noise, x.shape)
        frames.append(np.clip(values, 0, SATURATION).astype(np.uint16))
    return frames, across


def test_decoding_survives_gamma_ambient_light_and_paper() -> None:
    """Else a projector pixel would be taken for its neighbour, and the light for another ray's."""
    frames, across = seen((96, 128), gamma=2.2, ambient=300.0, noise=8.0)
    decoded = decode(frames, (96, 128), SATURATION)
    inside = (across > 2) & (across < 125) & decoded.lit
    assert decoded.known[inside].mean() > 0.97
    assert np.quantile(np.abs(decoded.columns - across)[decoded.known], 0.999) < 0.25
    assert np.std((decoded.columns - across)[decoded.known]) < 0.08
    outside = (across < -2) | (across > 130)
    assert not decoded.known[outside].any()
    assert np.isnan(decoded.columns[~decoded.known]).all()


def test_what_is_too_bright_is_not_decoded() -> None:
    frames, _ = seen((48, 64), gamma=1.0, ambient=2000.0, noise=2.0)
    decoded = decode(frames, (48, 64), SATURATION)
    assert decoded.saturated.any()
    assert not (decoded.known & decoded.saturated).any()


def test_missing_frames_are_refused() -> None:
    frames, _ = seen((48, 64), gamma=1.0, ambient=0.0, noise=2.0)
    with pytest.raises(ImageError, match="takes 26 frames of one shape; take all of them again"):
        decode(frames[:-1], (48, 64), SATURATION)


# The board


def test_corners_are_found_where_they_are(photographer: Photographer) -> None:
    """To a tenth of a pixel, against the twin's own rays."""
    for place, number in (("air", 3), ("flooded", 0), ("flooded slant", 1)):
        view = photographer.view(place, number)
        held = BoardInView(photographer.bench, BOARD, place, number)
        on_board, _ = held.on_board(*view.corners_px.T)
        off_mm = np.linalg.norm(on_board[:, :2] - view.points_mm(BOARD)[:, :2], axis=1)
        assert off_mm.max() < 0.12 * 0.625 * (1.5 if "slant" in place else 1.0)
        assert view.fault is None
        assert 0.5 < view.blur_px < 1.3


@pytest.mark.parametrize(
    ("board", "reason"),
    [
        (Board(dictionary="DICT_6X6_50"), "the markers in view are of DICT_4X4_"),
        (Board(columns=5, rows=7), "from where a board of 5 × 7 squares"),
        (Board(marker_mm=12.0), "from where a board of 7 × 5 squares of 20 mm with markers of 12 mm has them"),
        (Board(columns=5, rows=5), "give its number of squares"),
    ],
)
def test_another_board_is_named(photographer: Photographer, board: Board, reason: str) -> None:
    """A board described wrongly would make a wrong calibration that fits."""
    frame = photographer.frames("flooded", 0)[0]
    with pytest.raises(ImageError, match=re.escape(reason)):
        find_board(frame, board, SATURATION)


def test_bad_pictures_say_what_to_do(photographer: Photographer) -> None:
    import cv2

    frame = photographer.frames("air", 1)[0].astype(float)
    bad = {
        "shorten the exposure": np.minimum(2.0 * frame, SATURATION),
        "expose longer": 0.05 * frame,
        "hold the board still": cv2.GaussianBlur(cv2.resize(frame, None, fx=3, fy=3), (0, 0), 2.6),
    }
    for advice, pixels in bad.items():
        fault = find_board(pixels.astype(np.uint16), BOARD, SATURATION).fault
        assert fault is not None
        assert advice in fault
    with pytest.raises(ImageError, match="no board is seen"):
        find_board(np.full(SMALL[0], 700, np.uint16), BOARD, SATURATION)


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ({"columns": 2}, "give at least 3 × 3 squares"),
        ({"marker_mm": 25.0}, "markers smaller than squares"),
        ({"dictionary": "DICT_9X9"}, "dictionary 'DICT_9X9' is unknown"),
        ({"columns": 20, "rows": 20}, "has more markers than the 50 of DICT_4X4_50"),
    ],
)
def test_impossible_boards_are_refused(how: dict, reason: str) -> None:
    with pytest.raises(ImageError, match=re.escape(reason)):
        Board(**how)


@pytest.mark.long
def test_decoding_of_a_full_picture_takes_less_than_two_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    """A projector of 1024 × 768 seen by a camera of 1920 × 1080."""
    import time

    import cv2

    patterns = gray_code_patterns((768, 1024))
    frames = [cv2.resize(pattern.pixels, (1920, 1080)) for pattern in patterns]
    began = time.process_time()
    decode(frames, (768, 1024), 260)
    took = time.process_time() - began
    with capsys.disabled():
        print(f"{len(frames)} frames decoded in {took:.2f} s of one core")
    assert took < 2.0
