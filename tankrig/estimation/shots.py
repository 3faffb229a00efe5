"""Images with their models, the problems that they make, and where a fit of them ended."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.differences import Forward, Slopes
from tankrig.estimation.followed import Model
from tankrig.estimation.observation import Observation
from tankrig.estimation.parameters import Block
from tankrig.estimation.problem import Evaluation, Problem, View
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.stated_errors import COARSE, counted_error
from tankrig.estimation.uncertainty import PATTERN, SmoothError
from tankrig.estimation.versions import Exact, Models, image_of, is_noisy
from tankrig.prediction import Prediction
from tankrig.scene import Scene

Image = NDArray[np.floating]


@dataclass(frozen=True)
class Shot:
    """An image, what it shows, the versions of its model, and the number of its dose."""

    observation: Observation
    scene: Scene
    models: Models
    dose: int = 0

    @property
    def length_mm(self) -> float:
        """Longest side of the tank."""
        return max(self.scene.tank.size_mm)

    @property
    def binned_by(self) -> int:
        """Pixels along the side of a block that the search takes for one."""
        return 1 if self.models.look is None else self.models.look[0]

    def looked_at(self) -> "Shot":
        """It as a search looks at it: differences to one side do."""
        if self.models.look is None:
            return replace(self, models=replace(self.models, central=False))
        by, model = self.models.look
        scene = replace(self.scene, camera=self.scene.camera.binned(by))
        return replace(
            self, observation=self.observation.binned(by), scene=scene, models=replace(self.models, coarse=model)
        )

    def slopes_of(self, model: Model) -> Slopes:
        """Derivatives: the model's own, or by differences of one of its versions."""
        return self.models.slopes_of(model, self.length_mm)

    def slopes_noise_of(self, model: Model) -> Slopes | None:
        """Patterns of their noise; None where they are not known."""
        return self.models.slopes_noise_of(model)

    def view(self, forward: Forward, slopes: Slopes, error: Image) -> View:
        """It as a problem has it, with a model whose error has a standard deviation, (rows, columns)."""
        return View(self.observation, forward, slopes, self.error(error), self.dose)

    def error(self, sd: Image, counted: float = PATTERN) -> SmoothError:
        """A model's error of a standard deviation, (rows, columns); see `SmoothError`."""
        return SmoothError.of(self.scene, sd, counted)


@dataclass(frozen=True)
class Fit:
    """Where a fit ended: the problem there, and each view's model as it was used.

    Parameters
    ----------
    optimum
        The problem there.
    models
        Of the views.
    apart
        What images of each view's model have that another's, which states less error, have not, W/mm²/sr: noise of
        paths for the most part. None where there is no such model.
    moved
        (k,) by how much the first values were still corrected in the end, where the fit has not settled, or differ in
        another mode that is as likely; else None.
    exact
        Gives exact images near the optimum for less than others; None where there are none.
    early
        Whether it ended where it sufficed, see `Suffices`, before it had settled.
    """

    optimum: Evaluation
    models: tuple[Model, ...]
    apart: tuple[Image | None, ...] = ()
    moved: NDArray[np.float64] | None = None
    exact: Exact | None = None
    early: bool = False

    def unsettled(self, spread: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance of the values with that counted."""
        if self.moved is None:
            return spread
        moved = np.pad(self.moved, (0, len(spread) - self.moved.size))
        return np.asarray(spread + np.outer(moved, moved))

    @property
    def calm(self) -> Evaluation:
        """The same place with noise of paths in what was observed, and not in the models.

        What looks like a fault is made of the fitted image, and less what gain and offset make of that: with noise in
        it, which the residual has too, it would meet itself (a veil of −96 % by 40 standard deviations).
        """
        best = self.optimum
        if all(one is None for one in self.apart):
            return best
        gain, _ = best.scale
        views = []
        for view, noise in zip(best.problem.views, self.apart, strict=True):
            if noise is not None:
                seen = replace(view.observation, image=view.observation.image - gain * noise)
                view = replace(view, observation=seen, forward=_less(view.forward, noise))
            views.append(view)
        return replace(best.problem, views=tuple(views)).at(best.coordinates)

    @property
    def predictions(self) -> list[Prediction]:
        """The models' images there, without what may be misaligned."""
        return [model(liquid) for model, liquid in zip(self.models, self.optimum.media, strict=True)]


def _less(forward: Forward, noise: Image) -> Forward:
    return lambda medium: np.asarray(forward(medium) - noise)


Suffices = Callable[[Fit], bool]
"""Whether a place that a fit is led to, by models that were made right near it, suffices for what is done next."""


def rough_problem(shots: Sequence[Shot], blocks: tuple[Block, ...], scaling: Scaling, share: float = COARSE) -> Problem:
    """The problem of the cheap models, with errors of a share of the light, about."""
    views = []
    for number, shot in enumerate(shots):
        seen, coarse = shot.observation, shot.models.coarse
        ambient = float(np.percentile(seen.image[seen.used], 5)) if scaling.offset is None else scaling.offset
        error = share * np.maximum(seen.image - ambient, 0.0)
        views.append(replace(shot.view(image_of(coarse), shot.slopes_of(coarse), error), number=number))
    quick = all(shot.models.quick(shot.models.coarse) for shot in shots)
    slow = any(shot.models.prepares for shot in shots)
    noisy = any(is_noisy(shot.models, shot.models.coarse) for shot in shots)
    return Problem(tuple(views), blocks, scaling, quick=quick, slow=slow, noisy=noisy)


def weighed_problem(
    problem: Problem, shots: Sequence[Shot], forwards: Sequence[Forward], slopes: Sequence[Slopes],
    seen: Sequence[Prediction], added: Sequence[Image | float],
) -> Problem:  # fmt: skip
    """The problem with other models, weighed by the errors that their images state and the noise that these leave.

    To these images blocks have added what `Evaluation.added` holds.
    """
    images = [one.image + more for one, more in zip(seen, added, strict=True)]
    gain, offsets = problem.scale(problem.whitened(images))
    views = []
    for shot, view, forward, slope, one, image, offset in zip(
        shots, problem.views, forwards, slopes, seen, images, offsets, strict=True
    ):
        left = view.observation.image - gain * image - offset
        observation = view.observation.with_noise_of(left, by_level=True)
        error = shot.error(counted_error(one, gain))
        changed = replace(view, forward=forward, slopes=slope, slopes_noise=None)
        views.append(replace(changed, error=error, observation=observation))
    return replace(problem, views=tuple(views))
