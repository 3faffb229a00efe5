"""Random scenes over all that the models are said to hold for, and how well predictions keep what they promise there.

Truth is noisy too. With two independent truths t₁ and t₂ of a scene, the error of a prediction p is

    ‖p − truth‖² = E⟨p − t₁, p − t₂⟩

without the noise of either; with one truth and its standard error, it is ‖p − t‖² − Σ stderr².

A folder's truths may tell more: images by order class, and what the program took that made them. Its time goes with
1/error², which tells what it would have taken for the error that a prediction has.
"""

import json
import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from tankrig.benchmark.truth import Case, cases_of
from tankrig.prediction import Prediction
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

Array = NDArray[np.float64]

EXTINCTION_PER_MM = (0.003, 0.11)
ABSORBED = (0.0005, 0.5)
"""1 − ϖ."""
ASYMMETRY = (-0.4, 0.96)
KINDS = ("parallel", "parallel", "pinholes")
"""In turn: a third of the scenes has two pinholes, every other of those with light bent at wall and surface."""


BLOCK_PIXELS = 8
"""Sides of the blocks in which errors are compared with what is stated."""
TOLD_APART = 0.3
"""Blocks count whose neighbours' stated error is at least this share of the truths' noise there."""
MOST_NOISY = 1e9
"""Squared noise over squared stated error, from which it does not matter how much more it is."""
CLASSES: Mapping[int | str, str] = {1: "order1", 2: "order2", 3: "order3", "4-20": "order4_20", ">20": "order_gt20"}
"""Arrays of a folder's truths by order class; those of the second truth end with _2."""
LUCKY = 0.5
"""Share of the stated error below which an error counts as luck, where times to an equal error are compared."""


@dataclass(frozen=True)
class WideScene:
    """A random scene.

    Parameters
    ----------
    name
        Its number and kind.
    kind
        "parallel", "pinholes" or "bent".
    scene
        The scene itself.
    """

    name: str
    kind: str
    scene: Scene


def wide_scene(number: int, seed: int = 0) -> WideScene:
    """One of the random scenes.

    Parameters
    ----------
    number
        Which; the kind goes with it.
    seed
        Of the whole set.

    Examples
    --------
    >>> wide_scene(0) == wide_scene(0), wide_scene(2).kind, wide_scene(5).kind
    (True, 'pinholes', 'bent')
    """
    numbers = np.random.default_rng((seed, number))
    sigma_t = float(np.exp(numbers.uniform(*np.log(EXTINCTION_PER_MM))))
    absorbed = float(np.exp(numbers.uniform(*np.log(ABSORBED))))
    medium = Medium(sigma_t * absorbed, sigma_t * (1.0 - absorbed), float(numbers.uniform(*ASYMMETRY)))
    kind = KINDS[number % len(KINDS)]
    if kind == "pinholes" and number % (2 * len(KINDS)) >= len(KINDS):
        kind = "bent"
    beams = _beams(numbers)
    if kind == "parallel":
        surface = "fresnel" if numbers.random() < 0.3 else "matched"
        light = Projector("collimated", beams)
        scene = Scene(Tank(surface=surface), medium, light, Camera("orthographic", (80, 120), 2.0))  # type: ignore[arg-type]
    else:
        y, above = float(numbers.choice([0.0, numbers.uniform(-30.0, 30.0)])), float(numbers.uniform(350.0, 650.0))
        light = Projector("pinhole", beams, (float(numbers.uniform(-500.0, -250.0)), y, float(numbers.uniform(40, 80))))
        camera = Camera("pinhole", (80, 120), 2.0, (float(numbers.uniform(90.0, 150.0)), y, 120.0 + above))
        tank = Tank(surface="fresnel", entry="glass", wall_mm=8.0) if kind == "bent" else Tank()
        scene = Scene(tank, medium, light, camera)
    return WideScene(f"{number:03d}-{kind}", kind, scene)


def _beams(numbers: np.random.Generator) -> tuple[Beam, ...]:
    """One to seven beams side by side, at one height or at two, or one broad sheet."""
    if numbers.random() < 0.15:
        half, low = numbers.uniform(30.0, 60.0), numbers.uniform(40.0, 80.0)
        return (Beam((-half, half), (low, low + 4.0)),)
    count = int(numbers.integers(1, 8))
    pitch = 140.0 / count
    wide, offset = numbers.uniform(3.0, min(10.0, 0.6 * pitch)), numbers.choice([0.0, numbers.uniform(-4.0, 4.0)])
    heights = [float(numbers.uniform(35.0, 85.0)) for _ in range(2 if numbers.random() < 0.25 else 1)]
    thick = float(numbers.uniform(2.0, 8.0))
    middles = [offset + pitch * (index - 0.5 * (count - 1)) for index in range(count)]
    return tuple(
        Beam((float(middle - 0.5 * wide), float(middle + 0.5 * wide)), (height, height + thick))
        for middle, height in zip(middles, heights * count, strict=False)
    )


@dataclass(frozen=True)
class Truths:
    """What a scene's image is known to be.

    Parameters
    ----------
    scene
        With its name and kind.
    first, second
        (rows, columns) images; independent of each other, or the same one with a standard error.
    variance
        (rows, columns) of their common noise: 0 where they are independent.
    classes
        Two independent images of each order class that is known.
    cpu_seconds_to_1
        What the program took that made them, times its relative noise squared: its time for an error of 1; NaN where
        that isn't known.
    """

    scene: WideScene
    first: Array
    second: Array
    variance: Array
    classes: Mapping[int | str, tuple[Array, Array]] = field(default_factory=dict)
    cpu_seconds_to_1: float = math.nan

    def squares(self, image: Array) -> Array:
        """(rows, columns) whose sums over many pixels are those of the squared error, without the truths' noise."""
        product: Array = (image - self.first) * (image - self.second) - self.variance
        return product

    @property
    def size(self) -> float:
        """L2 norm of the image."""
        return float(np.sqrt(max(float((self.first * self.second - self.variance).sum()), 0.0)))

    @property
    def noise(self) -> Array:
        """(rows, columns) standard error of `squares`' truths."""
        return np.asarray(np.sqrt(0.5 * np.square(self.first - self.second) + self.variance))


def own_truths(count: int, noise: float, cache: Path, seed: int = 0) -> Iterator[Truths]:
    """Random scenes with two truths each by our own Monte Carlo, which are kept in `cache`.

    Parameters
    ----------
    count
        How many scenes.
    noise
        Relative L2 of each truth's noise.
    cache
        Folder; what isn't there is made.
    seed
        Of the set of scenes.
    """
    from tankrig.files import whole_file
    from tankrig.montecarlo import simulate_to

    for number in range(count):
        wide = wide_scene(number, seed)
        path = cache / f"wide-1-{seed}-{wide.name}-{noise:g}.npz"
        try:
            with np.load(path) as data:
                first, second = data["first"], data["second"]
        except (OSError, KeyError, ValueError, BadZipFile):
            first, second = (simulate_to(wide.scene, noise, seed=each).image for each in (1, 2))
            cache.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as unfinished:
                np.savez(unfinished, first=first, second=second)
        yield Truths(wide, first, second, np.zeros_like(first))


def truths_of(folder: Path, count: int) -> list[Truths]:
    """The first cases of a folder with NAME.toml and NAME.npz: arrays `total`, and `stderr` or a second `total_2`."""
    found = []
    for case in cases_of(folder)[:count]:
        with np.load(folder / f"{case.name}.npz") as data:
            second = data["total_2"].astype(np.float64) if "total_2" in data.files else None
            classes = {
                key: (data[name].astype(np.float64), data[f"{name}_2"].astype(np.float64))
                for key, name in CLASSES.items()
                if name in data.files and f"{name}_2" in data.files
            }
            spent = _spent(str(data["metadata"])) if "metadata" in data.files else math.nan
        wide = WideScene(case.name, _kind(case), case.scene)
        none = np.zeros_like(case.image)
        found.append(
            Truths(wide, case.image, case.image, np.square(case.stderr), classes, spent)
            if second is None
            else Truths(wide, case.image, second, none, classes, spent)
        )
    return found


def _spent(metadata: str) -> float:
    """CPU seconds times noise squared, from what a program wrote beside its image.

    Examples
    --------
    >>> _spent('{"cpu_seconds": 2.0, "l2_noise": 0.1}'), _spent("{}")
    (0.020000000000000004, nan)
    """
    try:
        told = json.loads(metadata)
        return float(told["cpu_seconds"]) * float(told["l2_noise"]) ** 2
    except (ValueError, KeyError, TypeError):
        return math.nan


def _kind(case: Case) -> str:
    scene = case.scene
    if scene.projector.kind == "collimated" and scene.camera.kind == "orthographic":
        return "parallel"
    return "bent" if scene.tank.entry == "glass" or scene.tank.surface == "fresnel" else "pinholes"


@dataclass(frozen=True)
class Kept:
    """One prediction against its truth.

    Parameters
    ----------
    name, kind
        Of the scene.
    tolerance
        That was asked for.
    error, stated
        Relative L2: found, net of the truths' noise, and stated.
    said
        Whether the prediction says that it misses the tolerance.
    block_squares
        Mean over blocks of squared error over squared stated error; NaN where the truths are too noisy to tell.
    blocks
        How many blocks that is.
    cpu_seconds
        Of the prediction.
    classes
        Largest error of an order class, relative L2 of the whole image; NaN where classes aren't known.
    slower
        CPU seconds that the truths' program takes to the same error, over the prediction's; NaN where not known.
    """

    name: str
    kind: str
    tolerance: float
    error: float
    stated: float
    said: bool
    block_squares: float
    blocks: int
    cpu_seconds: float
    classes: float
    slower: float


def measured(
    truths: Iterable[Truths], tolerances: Iterable[float], budget_s: float, tell: Callable[[Kept], object]
) -> list[Kept]:
    """Predict every scene to every tolerance.

    Parameters
    ----------
    truths
        Scenes and what their images are.
    tolerances
        Relative L2.
    budget_s
        Of each prediction.
    tell
        Told each result.
    """
    found, tolerances, warm = [], list(tolerances), set()
    for truth in truths:
        if truth.scene.kind not in warm:
            warm.add(truth.scene.kind)
            _predicted(truth.scene.scene, 0.3, budget_s)  # compiles, or reads compiled code
        for tolerance in tolerances:
            found.append(_kept(truth, tolerance, budget_s))
            tell(found[-1])
    return found


def _predicted(scene: Scene, tolerance: float, budget_s: float) -> tuple[Prediction, float]:
    from tankrig.image.predict import predict

    began = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # `missed` says it
        prediction = predict(scene, tolerance=tolerance, budget_s=budget_s)
    return prediction, time.process_time() - began


def _kept(truth: Truths, tolerance: float, budget_s: float) -> Kept:
    prediction, cpu_seconds = _predicted(truth.scene.scene, tolerance, budget_s)
    image = np.asarray(prediction.image, np.float64)
    squares = truth.squares(image)
    error = float(np.sqrt(max(float(squares.sum()), 0.0))) / (truth.size or 1.0)
    return Kept(
        truth.scene.name, truth.scene.kind, tolerance, error, prediction.error, bool(prediction.missed),
        *_block_squares(truth, prediction, squares), cpu_seconds, _class_error(truth, prediction),
        truth.cpu_seconds_to_1 / max(error, LUCKY * prediction.error, 1e-9) ** 2 / cpu_seconds,
    )  # fmt: skip


def _class_error(truth: Truths, prediction: Prediction) -> float:
    errors = [
        float(((np.asarray(prediction.orders[key]) - first) * (np.asarray(prediction.orders[key]) - second)).sum())
        for key, (first, second) in truth.classes.items()
    ]
    return math.sqrt(max(*errors, 0.0)) / (truth.size or 1.0) if errors else math.nan


def _block_squares(truth: Truths, prediction: Prediction, squares: Array) -> tuple[float, int]:
    image = np.asarray(prediction.image, np.float64)
    left_out = replace(prediction, stderr=None).error
    stated = np.square(prediction.stderr if prediction.stderr is not None else 0.0) + np.square(left_out * image)
    return squares_over_stated(squares, stated, np.square(truth.noise))


def squares_over_stated(squares: Array, stated: Array, noise: Array) -> tuple[float, int]:
    """Mean over the blocks that count of squared error over squared stated error, and how many count.

    Whether a block counts is told by its neighbours. Told by its own noise, blocks count in which two truths happen to
    be alike, and so are off alike: squared errors come out larger by up to the squared noise, and where that is ten
    times what is stated, errors of just the stated size had seemed to be 1.2 to 1.4 times as large.

    Parameters
    ----------
    squares, stated, noise
        (rows, columns) squares: of the error (`Truths.squares`), of what is stated of it, and of the truths' noise.
    """
    error_in, stated_in, noise_in = (_blocks(each) for each in (squares, stated, noise))
    noisy = np.minimum(noise_in / np.maximum(stated_in, 1e-300), MOST_NOISY)
    around = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
    nearby = convolve(noisy, around, mode="constant") / convolve(np.ones_like(noisy), around, mode="constant")
    counts = (nearby < TOLD_APART**-2) & (stated_in > 0.0)
    return (float(np.mean(error_in[counts] / stated_in[counts])) if counts.any() else math.nan), int(counts.sum())


def _blocks(image: Array) -> Array:
    """Sums over blocks; what is left at the edges is not counted."""
    rows, columns = (side // BLOCK_PIXELS for side in image.shape)
    whole = image[: rows * BLOCK_PIXELS, : columns * BLOCK_PIXELS]
    sums: Array = whole.reshape(rows, BLOCK_PIXELS, columns, BLOCK_PIXELS).sum(axis=(1, 3))
    return sums


@dataclass(frozen=True)
class Summary:
    """How well one tolerance is kept.

    Parameters
    ----------
    tolerance
        That was asked for.
    scenes
        How many.
    kept
        Share of them whose error is within it.
    worst_unsaid
        Largest error over the tolerance among those that don't say that they miss it.
    blocks
        Root of the mean of `Kept.block_squares` over all blocks.
    cpu_median, cpu_95, cpu_worst
        CPU seconds.
    classes
        Share of the scenes whose order classes are all within the tolerance, of the whole image; NaN where not known.
    slower
        Median by kind of scene, of how much more the truths' program takes to the same error.
    """

    tolerance: float
    scenes: int
    kept: float
    worst_unsaid: float
    blocks: float
    cpu_median: float
    cpu_95: float
    cpu_worst: float
    classes: float
    slower: Mapping[str, float]


def summary(found: list[Kept], tolerance: float) -> Summary:
    """Figures of one tolerance."""
    here = [one for one in found if one.tolerance == tolerance]
    seconds = np.array([one.cpu_seconds for one in here])
    blocks = sum(one.blocks for one in here)
    block_squares = sum(one.block_squares * one.blocks for one in here if one.blocks)
    classes = np.array([one.classes for one in here if math.isfinite(one.classes)])
    return Summary(
        tolerance,
        len(here),
        float(np.mean([one.error <= tolerance for one in here])),
        max((one.error / tolerance for one in here if not one.said), default=0.0),
        math.sqrt(max(block_squares / blocks, 0.0)) if blocks else math.nan,
        float(np.median(seconds)),
        float(np.quantile(seconds, 0.95)),
        float(seconds.max()),
        float(np.mean(classes <= tolerance)) if classes.size else math.nan,
        {
            kind: float(np.median([one.slower for one in here if one.kind == kind]))
            for kind in sorted({one.kind for one in here if math.isfinite(one.slower)})
        },
    )
