"""The images that a benchmark measures errors against: a folder of reference cases, or our own Monte Carlo."""

from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import ImageError
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank, load_scene

Array = NDArray[np.float64]

OWN_NOISE = 0.003
"""Relative L2 of the noise of references made by our own Monte Carlo."""

SHIPPED = {
    "thin-beam": ((0.002, 0.9, 0.0), ((-2.0, 2.0),)),
    "three-beams": ((0.02, 0.9, 0.5), ((-42.0, -38.0), (-2.0, 2.0), (38.0, 42.0))),
    "sheet": ((0.008, 0.99, 0.85), ((-60.0, 60.0),)),
}
"""Cases that need no folder: σt per mm, albedo and g; the beams' y in mm."""


@dataclass(frozen=True)
class Case:
    """A scene and what its image is known to be.

    Parameters
    ----------
    name
        Of the case.
    scene
        What is predicted.
    image, stderr
        (rows, columns) truth and its one-sigma error, W/mm²/sr.
    """

    name: str
    scene: Scene
    image: Array
    stderr: Array

    @property
    def noise(self) -> float:
        """Relative L2 of the truth's own error."""
        return float(np.linalg.norm(self.stderr) / np.linalg.norm(self.image))

    def excess(self, image: Array) -> float:
        """Relative L2 error of an image, net of the truth's noise."""
        error = float(np.linalg.norm(image - self.image) / np.linalg.norm(self.image))
        return float(np.sqrt(max(0.0, error**2 - self.noise**2)))


def cases_of(folder: Path, names: tuple[str, ...] = ()) -> list[Case]:
    """Cases of a folder that holds NAME.toml (scene) and NAME.npz (arrays `total` and `stderr`).

    Parameters
    ----------
    folder
        Of the cases.
    names
        Which of them; all when empty.

    Raises
    ------
    ImageError
        When the folder holds no case, not the one asked for, or one whose arrays don't fit its scene.
    """
    found = sorted(path.stem for path in folder.glob("*.npz") if path.with_suffix(".toml").exists())
    _require(names, found, f"{folder}: holds no case NAME.toml with NAME.npz")
    return [_read(folder / f"{name}.npz") for name in names or found]


def _require(names: tuple[str, ...], found: list[str], otherwise: str) -> None:
    if not found:
        raise ImageError(f"{otherwise}; give a folder of reference cases")
    missing = [name for name in names if name not in found]
    if missing:
        raise ImageError(f"case {missing[0]} is unknown; there are {', '.join(found)}")


def _read(path: Path) -> Case:
    scene = load_scene(path.with_suffix(".toml"))
    try:
        with np.load(path) as data:
            image, stderr = data["total"].astype(np.float64), data["stderr"].astype(np.float64)
    except (OSError, KeyError, ValueError, BadZipFile) as error:
        wanted = "it needs arrays total and stderr"
        raise ImageError(f"{path}: cannot be read as a reference ({error}); {wanted}") from error
    if image.shape != scene.camera.shape or stderr.shape != image.shape or not image.any():
        raise ImageError(f"{path}: its arrays don't fit the camera of {path.stem}.toml, shape {scene.camera.shape}")
    return Case(path.stem, scene, image, stderr)


def own_cases(cache: Path, names: tuple[str, ...] = (), noise: float = OWN_NOISE) -> list[Case]:
    """The shipped cases, their truth from our own Monte Carlo, kept in `cache` from one benchmark to the next.

    Raises
    ------
    ImageError
        When a case is unknown.
    """
    _require(names, list(SHIPPED), "")
    return [_own_case(cache, name, noise) for name in names or tuple(SHIPPED)]


def _own_case(cache: Path, name: str, noise: float) -> Case:
    from tankrig.files import whole_file
    from tankrig.montecarlo import simulate_to

    (sigma_t, albedo, g), rows = SHIPPED[name]
    beams = tuple(Beam(y_mm, (58.0, 62.0)) for y_mm in rows)
    scene = Scene(
        Tank(),
        Medium(sigma_t * (1.0 - albedo), sigma_t * albedo, g),
        Projector("collimated", beams),
        Camera("orthographic", (80, 120), 2.0),
    )
    path = cache / f"reference-1-{name}-{noise:g}.npz"
    try:
        with np.load(path) as data:
            return Case(name, scene, data["total"], data["stderr"])
    except (OSError, KeyError, ValueError, BadZipFile):
        pass  # not there, or not whole: made again
    tally = simulate_to(scene, noise, seed=1)
    with whole_file(path) as unfinished:
        np.savez(unfinished, total=tally.image, stderr=tally.stderr)
    return Case(name, scene, tally.image, tally.stderr)
