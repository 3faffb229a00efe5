"""A prediction as a file: NumPy's .npz with the array names of the reference images."""

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.files import whole_file
from tankrig.prediction import Prediction
from tankrig.scene import Scene
from tankrig.scene.footprint import footprints

ARRAY_NAMES: Mapping[int | str, str] = {
    1: "order1",
    2: "order2",
    3: "order3",
    "4-20": "order4_20",
    ">20": "order_gt20",
}
"""By class of orders of scattering."""


def write_prediction(path: Path, prediction: Prediction, scene: Scene, about: Mapping[str, Any]) -> None:
    """Write a prediction so that `tankrig fit` and NumPy read it; the file is there whole or not at all.

    Parameters
    ----------
    path
        The .npz file. Arrays, (rows, columns), W/mm²/sr: `total`; `order1` … `order_gt20` and `stderr` where the
        prediction has them. `x_mm`, `y_mm`: pixel centres on the plane z = Lz, (columns,) and (rows,), or of a
        calibrated camera (rows, columns) both. `metadata`: JSON text.
    prediction, scene
        What was predicted, and of what.
    about
        More to note in the metadata; plain numbers and text.

    Raises
    ------
    StoreError
        When the file cannot be written.
    """
    centres = footprints(scene.camera, scene.tank).centres_mm
    plain = scene.camera.kind != "calibrated"
    arrays = {
        "total": prediction.image,
        **{ARRAY_NAMES[order]: image for order, image in prediction.orders.items()},
        "x_mm": centres[0, :, 0] if plain else centres[..., 0],
        "y_mm": centres[:, 0, 1] if plain else centres[..., 1],
        "metadata": np.array(json.dumps({"model": prediction.model, **about, "scene": _described(scene)})),
    }
    if prediction.stderr is not None:
        arrays["stderr"] = prediction.stderr
    with whole_file(path) as unfinished:
        np.savez_compressed(unfinished, allow_pickle=False, **arrays)


def error_of_prediction(path: Path, scale: float = 1.0) -> NDArray[np.float64] | None:
    """The standard error of a predicted image, (rows, columns), as `write_prediction` keeps it; None of other files.

    Other programs' files may have an array of that name, which is noise that differs from pixel to pixel.
    """
    if path.suffix.lower() != ".npz":
        return None
    try:
        with np.load(path, allow_pickle=False) as arrays:
            if "stderr" not in arrays or "model" not in json.loads(str(arrays["metadata"])):
                return None
            return scale * np.asarray(arrays["stderr"], float)
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        return None  # what is wrong with a file is told by who reads its image


def _described(scene: Scene) -> dict[str, Any]:
    """A scene's fields; without a phase function where Henyey–Greenstein needs none, as earlier versions wrote it."""
    described = asdict(scene)
    if scene.medium.phase is None:
        del described["medium"]["phase"]
    return described
