"""What a person sees in a picture that tankrig drew: the words in it, and the images that it shows."""

import base64
import re
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.colors import Normalize

from tankrig.figures.tank_image import FALSE_COLOUR, brightness
from tankrig.live.exposures import exposures_of
from tankrig.live.formatting import with_error
from tankrig.live.results import fits_in
from tankrig.run.reading import open_run

PNG = re.compile(r"data:image/png;base64,([A-Za-z0-9+/=]+)")


def words_in(drawing: Path) -> list[str]:
    """Titles, labels and sentences in a drawing (.svg), in which matplotlib notes beside its outlines what they say."""
    return re.findall(r"<!-- (.*?) -->", drawing.read_text(encoding="utf-8"), re.DOTALL)


def likeness(picture: Path, image: np.ndarray, colours: str, scale: Normalize) -> float:
    """How well the best place in a picture fits an image drawn in such colours: 1 as drawn, about 0 where it is not.

    Looks in grey at a third of the picture's size, for sizes of the image between a tenth and half of the width.
    """
    return likeness_in(picture.read_bytes(), image, colours, scale)


def likeness_in(picture: bytes, image: np.ndarray, colours: str, scale: Normalize) -> float:
    """The same of a picture in memory."""
    seen = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert seen is not None, "that is no picture"
    seen = cv2.resize(seen, None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
    drawn = (255 * mpl.colormaps[colours](np.asarray(scale(image[::-1])))[..., 2::-1]).astype(np.uint8)
    drawn, best = cv2.cvtColor(drawn, cv2.COLOR_BGR2GRAY), -1.0
    for width in np.geomspace(0.1, 0.5, 50) * seen.shape[1]:
        size = round(width), round(width * image.shape[0] / image.shape[1])
        if size[1] < seen.shape[0]:
            there = cv2.matchTemplate(seen, cv2.resize(drawn, size, interpolation=cv2.INTER_AREA), cv2.TM_CCOEFF_NORMED)
            best = max(best, float(there.max()))
    return best


def report_shows(page: str, run: Path) -> None:
    """A run's report says what its fits found at each dose and of the ink, and shows the last dose's photographs."""
    recorded = open_run(run)
    doses, series = fits_in([event.fields for event in recorded.fits])
    for one in doses:
        assert f'<td class="n">{with_error(one.medium.sigma_s, one.sd[1])}</td>' in page, f"{one.dose_ml} ml"
    assert series is not None
    number, half = with_error(series.ink.sigma_s, series.sd[1]).split(" ± ")
    assert f"<b>{number}</b><i>± {half}</i>" in page
    pictures = [base64.b64decode(found) for found in PNG.findall(page)]
    exposures = exposures_of(recorded)
    for photograph in exposures.photographs(exposures.dose):
        # A bench's photograph is drawn beside what covers it; light from the other side fits less.
        seen, turned = (
            max(likeness_in(one, image, FALSE_COLOUR, brightness(image)) for one in pictures)
            for image in (photograph.image, photograph.image[:, ::-1])
        )
        assert seen > max(0.8, turned), f"{photograph.pattern} at {photograph.dose_ml} ml is not to be seen: {seen:.2f}"
