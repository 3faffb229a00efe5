"""How sharp a picture is."""

import numpy as np
from numpy.typing import NDArray


def sharpness(pixels: NDArray[np.generic]) -> float:
    """Fine structure of a picture over its brightness; largest when it is in focus.

    The standard deviation of the Laplacian over the mean of the picture; it rises with noise, too, so compare pictures
    of one scene and one exposure.

    Parameters
    ----------
    pixels
        (rows, columns), any real type.

    Examples
    --------
    >>> stripes = np.tile([100.0, 200.0], (16, 8))
    >>> sharpness(stripes) > 4 * sharpness((stripes + np.roll(stripes, 1, axis=1)) / 2 + np.arange(16.0))
    True
    """
    import cv2

    picture = pixels.astype(np.float32)
    mean = float(picture.mean())
    return float(cv2.Laplacian(picture, cv2.CV_32F).std()) / mean if mean > 0.0 else 0.0
