"""The ChArUco board that is held in view, and how well a picture shows it."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.calibration.edge_blur import square_edges_px
from tankrig.errors import ImageError

Points = NDArray[np.float64]

LEAST_CORNERS = 6
MOST_SATURATED = 0.02
LEAST_CONTRAST = 0.08
MOST_BLUR_PX = 2.5
LEAST_MARKERS = 4
"""From which on a picture shows a board."""
_COMMON = ("DICT_4X4_100", "DICT_5X5_100", "DICT_6X6_100", "DICT_7X7_100", "DICT_APRILTAG_36h11")
"""Dictionaries that boards are made of, which begin with their first markers."""
_LEAST_RANGE = 0.01
"""Between a picture's dark and bright parts, of the camera's range, from which on markers are looked for."""
_WRONG_LAYOUT = 0.06
"""Of a square: markers that lie farther from where the description has them than this are another board's."""


@dataclass(frozen=True)
class Board:
    """A printed ChArUco board; x to the right, y down, z away from who looks at it, from the first square's corner.

    Parameters
    ----------
    columns, rows
        Squares.
    square_mm, marker_mm
        Their sides, measured on the print.
    dictionary
        Of the markers, by OpenCV's name.
    margin_mm
        From the squares to the edge of the plate.
    thickness_mm
        Of the plate.
    square_sd_mm
        Standard deviation of `square_mm`: as for a width of seven squares that was measured to within 0.015 mm.

    Examples
    --------
    >>> board = Board()
    >>> board.size_mm, board.corners_mm[0].tolist(), len(board.corners_mm)
    ((140.0, 100.0), [20.0, 20.0, 0.0], 24)
    """

    columns: int = 7
    rows: int = 5
    square_mm: float = 20.0
    marker_mm: float = 15.0
    dictionary: str = "DICT_4X4_50"
    margin_mm: float = 5.0
    thickness_mm: float = 3.0
    square_sd_mm: float = 0.0012

    def __post_init__(self) -> None:
        import cv2

        if not (min(self.columns, self.rows) >= 3 and 0.0 < self.marker_mm < self.square_mm):
            raise ImageError(
                f"a board of {self.columns} × {self.rows} squares of {self.square_mm:g} mm with markers of "
                f"{self.marker_mm:g} mm cannot be; give at least 3 × 3 squares, and markers smaller than squares"
            )
        if not 0.0 <= self.square_sd_mm < 0.1 * self.square_mm:
            raise ImageError(
                f"squares of {self.square_mm:g} ± {self.square_sd_mm:g} mm are not measured; give the standard "
                f"deviation of one square's side, in mm"
            )
        if self.dictionary not in _dictionaries():
            raise ImageError(f"dictionary {self.dictionary!r} is unknown; use one of {', '.join(_dictionaries())}")
        known = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary)).bytesList)
        if self.columns * self.rows // 2 > known:
            raise ImageError(
                f"a board of {self.columns} × {self.rows} squares has more markers than the {known} of "
                f"{self.dictionary}; name the dictionary that it was printed from"
            )

    @property
    def size_mm(self) -> tuple[float, float]:
        """(width, height) of the squares together."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    @cached_property
    def corners_mm(self) -> Points:
        """(corners, 3) where four squares meet, in the board's frame, in the order of their ids."""
        return np.asarray(self.charuco.getChessboardCorners(), float)

    @cached_property
    def charuco(self) -> Any:
        """As OpenCV has it."""
        import cv2

        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_mm, self.marker_mm, dictionary)

    def picture(self, pixels_per_mm: float) -> NDArray[np.uint8]:
        """To print; squares begin at its edges."""
        width, height = (round(side * pixels_per_mm) for side in self.size_mm)
        drawn: NDArray[np.uint8] = self.charuco.generateImage((width, height), marginSize=0, borderBits=1)
        return drawn


@dataclass(frozen=True, eq=False)
class BoardView:
    """What a picture shows of a board.

    Parameters
    ----------
    ids
        (n,) which corners.
    corners_px
        (n, 2) x, y; pixel centres at whole numbers.
    shape
        (rows, columns) of the picture.
    blur_px
        Standard deviation of the blur of edges.
    contrast
        Between white and black squares, of the camera's range.
    saturated
        Part of the board's pixels that are at the highest count.
    edge_px
        Standard deviation of the edges between squares, pixels' own area and all; NaN where too few are seen.
    edges
        (n, 3) x and y of each, and its standard deviation.
    """

    ids: NDArray[np.int64]
    corners_px: Points
    shape: tuple[int, int]
    blur_px: float
    contrast: float
    saturated: float
    edge_px: float = float("nan")
    edges: Points = field(default_factory=lambda: np.zeros((0, 3)))

    def points_mm(self, board: Board) -> Points:
        """(n, 3) the same corners on the board."""
        found: Points = board.corners_mm[self.ids]
        return found

    @property
    def fault(self) -> str | None:
        """Why it should not be used, and what to do; None where it can be."""
        if len(self.ids) < LEAST_CORNERS:
            return f"only {len(self.ids)} of the board's corners are seen; show more of it, less tilted"
        if self.saturated > MOST_SATURATED:
            return f"{100 * self.saturated:.0f} % of the board is saturated; shorten the exposure or dim the light"
        if self.contrast < LEAST_CONTRAST:
            return f"white and black differ by {100 * self.contrast:.1f} % of the range; expose longer or add light"
        if self.blur_px > MOST_BLUR_PX:
            return f"edges are blurred by {self.blur_px:.1f} pixels; focus, hold the board still, expose shorter"
        return None


def rms_length(vectors: Points) -> float:
    """Root mean square length of vectors, (n, 2) or (n, 3), in their unit.

    Examples
    --------
    >>> rms_length(np.array([[3.0, 4.0], [0.0, 5.0]]))
    5.0
    """
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def find_board(pixels: NDArray[Any], board: Board, saturation: int) -> BoardView:
    """Find a board's corners in a picture.

    Parameters
    ----------
    pixels
        (rows, columns), 8 or 16 bits.
    board
        What to look for.
    saturation
        The camera's highest count.

    Raises
    ------
    ImageError
        When no board is seen, or another one.
    """
    import cv2

    picture = _eight_bits(pixels)
    detector = cv2.aruco.CharucoDetector(board.charuco)
    corners, ids, markers, marker_ids = detector.detectBoard(picture)
    if marker_ids is None or len(marker_ids) == 0:
        full = float((pixels >= 0.995 * saturation).mean())
        if full > MOST_SATURATED:
            raise ImageError(
                f"no board is seen, and {100 * full:.0f} % of the picture is saturated; shorten the exposure"
            )
        raise ImageError(_no_board(picture, board))
    _refuse_another(board, markers, marker_ids)
    if ids is None or len(ids) < 4:
        raise ImageError(
            f"{len(marker_ids)} of the board's markers are seen, but not enough of its corners; show more of the board"
        )
    known = np.asarray(ids, np.int64).ravel()
    found = _refined(pixels, np.asarray(corners, np.float32).reshape(-1, 1, 2), known, board)
    rows, columns = pixels.shape
    edges = square_edges_px(pixels, found[_edges(known, board)], 0.5 * (1.0 - board.marker_mm / board.square_mm))
    edge = float(np.median(edges[:, 2])) if len(edges) >= LEAST_CORNERS else float("nan")
    return BoardView(known, found, (rows, columns), *_quality(pixels, found, known, board, saturation), edge, edges)


def markers_of_any_board(pixels: NDArray[Any], saturation: int) -> tuple[int, str]:
    """How many different markers of calibration boards a picture shows, and of which dictionary.

    Parameters
    ----------
    pixels
        (rows, columns), 8 or 16 bits.
    saturation
        The camera's highest count.

    Returns
    -------
    (int, str)
        Of the dictionary that most are of; fewer than `LEAST_MARKERS` of them may be chance. 0 where the picture is so
        dark or even that nothing in it could be told from noise.
    """
    import cv2

    dark, bright = np.percentile(pixels[::4, ::4], (1.0, 99.0))
    if bright - dark < _LEAST_RANGE * saturation:
        return 0, ""
    picture = _eight_bits(pixels)
    how = cv2.aruco.DetectorParameters()
    how.errorCorrectionRate = 0.0  # bits that are wrong make markers of anything
    seen = []
    for name in _COMMON:
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)), how)
        _, ids, _ = detector.detectMarkers(picture)
        seen.append((0 if ids is None else len(np.unique(ids)), name))
    return max(seen)


def _refined(pixels: NDArray[Any], corners: NDArray[np.float32], ids: NDArray[np.int64], board: Board) -> Points:
    """Corners to a few hundredths of a pixel, from all bits, in windows that no marker reaches into."""
    import cv2

    side = _square_px(corners[:, 0].astype(float), ids, board)
    reach = int(np.clip(0.5 * (1.0 - board.marker_mm / board.square_mm) * side, 2, 12))
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    # Blur halves the pull towards the pixels' grid that the method has on edges along it.
    smooth = cv2.GaussianBlur(pixels.astype(np.float32), (0, 0), float(np.clip(reach / 8.0, 0.8, 1.5)))
    better = cv2.cornerSubPix(smooth, corners.copy(), (reach, reach), (-1, -1), until)
    return np.asarray(better, float).reshape(-1, 2)


def _eight_bits(pixels: NDArray[Any]) -> NDArray[np.uint8]:
    """The detector's kind of picture, from the darkest to the brightest."""
    values = pixels.astype(np.float32)
    low, high = np.percentile(values[::4, ::4], (0.2, 99.8))
    scaled = (values - low) * (255.0 / max(float(high - low), 1.0))
    return np.asarray(np.clip(scaled, 0, 255), np.uint8)


def _no_board(picture: NDArray[np.uint8], board: Board) -> str:
    """In words, with the dictionary that the board in view seems to be of."""
    import cv2

    for name in _dictionaries():
        if name != board.dictionary:
            detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name)))
            _, ids, _ = detector.detectMarkers(picture)
            if ids is not None and len(ids) >= 4:
                return f"the markers in view are of {name}, not {board.dictionary}; describe the board that is there"
    return "no board is seen; hold it in view, in focus, lit evenly, and check that it is the one described"


def _refuse_another(board: Board, markers: Any, marker_ids: Any) -> None:
    """Every marker must lie where the description has it, by one homography."""
    import cv2

    ids = np.asarray(marker_ids).ravel()
    known = np.asarray(board.charuco.getIds()).ravel()
    if (~np.isin(ids, known)).sum() >= 2:
        raise ImageError(
            f"the board in view has marker {ids.max()} and the one described only {len(known)} markers; give its "
            f"number of squares"
        )
    places = np.asarray(board.charuco.getObjPoints())
    inside = np.isin(ids, known)
    if inside.sum() < 4:
        return
    mm = np.concatenate([places[known.tolist().index(one)][:, :2] for one in ids[inside]])
    px = np.concatenate([np.asarray(one).reshape(4, 2) for one, keep in zip(markers, inside, strict=True) if keep])
    homography, _ = cv2.findHomography(px, mm, 0)
    if homography is None:
        return
    off = np.linalg.norm(cv2.perspectiveTransform(px[None].astype(float), homography)[0] - mm, axis=1)
    if np.median(off) > _WRONG_LAYOUT * board.square_mm:
        raise ImageError(
            f"the markers lie {np.median(off):.1f} mm from where a board of {board.columns} × {board.rows} squares of "
            f"{board.square_mm:g} mm with markers of {board.marker_mm:g} mm has them; measure and describe that board"
        )


def _edges(ids: NDArray[np.int64], board: Board) -> NDArray[np.int64]:
    """(edges, 2) which of the corners are both ends of an edge between squares."""
    at, across = {int(one): index for index, one in enumerate(ids)}, board.columns - 1
    ends = [
        (at[one], at[one + step])
        for one in at
        for step in (1, across)
        if one + step in at and (step == across or one % across < across - 1)
    ]
    return np.array(ends, np.int64).reshape(-1, 2)


def _quality(
    pixels: NDArray[Any], corners: Points, ids: NDArray[Any], board: Board, saturation: int
) -> tuple[float, float, float]:
    """Blur in pixels, contrast, and saturated part, in patches about the corners."""
    import cv2

    side = _square_px(corners, ids, board)
    reach = int(np.clip(0.4 * side, 3, 24))
    rows, columns = pixels.shape
    blurs, contrasts, full, counted = [], [], 0, 0
    for x, y in np.rint(corners).astype(int):
        if not (reach <= x < columns - reach and reach <= y < rows - reach):
            continue
        patch = pixels[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(np.float32)
        low, high = np.percentile(patch, (5, 95))
        down, across = np.gradient(cv2.GaussianBlur(patch, (0, 0), 0.5))
        steepest = float(np.percentile(np.hypot(down, across), 98))
        blurs.append((high - low) / (np.sqrt(2.0 * np.pi) * max(steepest, 1e-6)))
        contrasts.append((high - low) / saturation)
        full += int((patch >= 0.995 * saturation).sum())
        counted += patch.size
    if not blurs:
        return 0.0, 0.0, 0.0
    return float(np.median(blurs)), float(np.median(contrasts)), full / counted


def _square_px(corners: Points, ids: NDArray[Any], board: Board) -> float:
    """Side of a square in the picture: the shortest distance of neighbours, over what it is on the board."""
    px = np.linalg.norm(corners[:, None] - corners[None], axis=-1)
    mm = np.linalg.norm(board.corners_mm[ids][:, None] - board.corners_mm[ids][None], axis=-1)
    neighbours = (mm > 0.0) & (mm < 1.1 * board.square_mm)
    return float(np.min(px[neighbours])) if neighbours.any() else 10.0


def _dictionaries() -> tuple[str, ...]:
    import cv2

    found = [name for name in dir(cv2.aruco) if name.startswith("DICT_") and name[-2:].isdigit()]
    return tuple(sorted(found, key=lambda name: (name[:9], len(name), name)))
