"""What a person sees in a picture that tankrig drew: the words in it, and the images that it shows."""

import re
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize


def words_in(drawing: Path) -> list[str]:
    """Titles, labels and sentences in a drawing (.svg), in which matplotlib notes beside its outlines what they say."""
    return re.findall(r"<!-- (.*?) -->", drawing.read_text(encoding="utf-8"), re.DOTALL)


def likeness(picture: Path, image: np.ndarray, colours: str, scale: Normalize) -> float:
    """How well the best place in a picture fits an image drawn in such colours: 1 as drawn, about 0 where it is not.

    Looks in grey at a third of the picture's size, for sizes of the image between a tenth and half of the width.
    """
    seen = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
    assert seen is not None, f"{picture} is no picture"
    seen = cv2.resize(seen, None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
    drawn = (255 * mpl.colormaps[colours](np.asarray(scale(image[::-1])))[..., 2::-1]).astype(np.uint8)
    drawn, best = cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY), -1.0
    for width in np.geomspace(0.1, 0.5, 50) * seen.shape[1]:
        size = round(width), round(width * image.shape[0] / image.shape[1])
        if size[1] < seen.shape[0]:
            there = cv2.matchTemplate(seen, cv2.resize(drawn, size, interpolation=cv2.INTER_AREA), cv2.TM_CCOEFF_NORMED)
            best = max(best, float(there.max()))
    return best
