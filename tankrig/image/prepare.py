"""`prepare`: a model of one geometry and pattern that answers at once."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, overload

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.scene import Medium, Scene
from tankrig.threads import THREADS

if TYPE_CHECKING:
    from tankrig.light.prepared.answer import Answer
    from tankrig.light.prepared.box import Box
    from tankrig.light.prepared.phases.answer import PhaseAnswer
    from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]


KEPT = 4
"""Media whose errors a model remembers."""


@dataclass(frozen=True)
class _Errors:
    """See `Prepared.errors_at` and `errors_of_slopes_at`; and the image's norm where they were computed."""

    patterns: Array
    of_slopes: Array
    tables: float
    size: float


@dataclass(frozen=True)
class Prepared:
    """A model of one tank, projector, pattern and camera, for any medium in its box.

    Parameters
    ----------
    scene
        What it was prepared for; the medium does not matter.
    box
        Ranges of σt, albedo and g that it answers for; g is the mean cosine.
    tolerance
        Relative L2 error that was asked for.
    error
        Estimated relative L2 error at media that it has not seen, root mean square over the box.
    largest_error
        The largest over the box.
    path
        The file that keeps it; None of a first model.
    answer
        What answers.
    phases
        "hg": media of Henyey–Greenstein's phase function; "any": of any.
    """

    scene: Scene
    box: "Box"
    tolerance: float
    error: float
    largest_error: float
    path: Path | None
    answer: "Answer | PhaseAnswer" = field(repr=False)
    phases: Literal["hg", "any"] = "hg"
    _known: "dict[Medium, _Errors]" = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def first(self) -> bool:
        """Whether it is a first model, by a share of the whole one's light paths."""
        return self.path is None

    @overload
    def predict(self, medium: Medium, derivatives: Literal[False] = False) -> Array: ...

    @overload
    def predict(self, medium: Medium, derivatives: Literal[True]) -> tuple[Array, Array]: ...

    def predict(self, medium: Medium, derivatives: bool = False) -> Array | tuple[Array, Array]:
        """Image of a medium in the tank.

        Parameters
        ----------
        medium
            Inside the box.
        derivatives
            Give those by σa, σs and g too, of a Henyey–Greenstein medium; see `slopes` for others.

        Returns
        -------
        (rows, columns) array in W/mm²/sr; with `derivatives` a pair of it and a (3, rows, columns) array.

        Raises
        ------
        SceneError
            When the medium is outside the box, or its phase function is none that the model, or the derivatives, know.
        """
        self.box.require(medium)
        if medium.phase is not None and (self.phases == "hg" or derivatives):
            raise SceneError(
                "derivatives by g are Henyey–Greenstein's only, and the medium has a phase of kind "
                f'"{medium.phase.kind}"; use slopes'
                if self.phases == "any"
                else "this prepared model knows Henyey–Greenstein only, and the medium has a phase of kind "
                f'"{medium.phase.kind}"; use predict, or prepare with phases = "any"'
            )
        return self.answer.image_and_derivatives(medium) if derivatives else self.answer.image(medium)

    def slopes(self, medium: Medium, others: "Sequence[PhaseFunction]") -> tuple[Array, Array]:
        """The image of a medium with any phase function, and its derivatives.

        Parameters
        ----------
        medium
            Inside the box.
        others
            Phase functions beside the medium's.

        Returns
        -------
        image
            (rows, columns) in W/mm²/sr.
        slopes
            (2 + others, rows, columns) by σa, by σs, and by the share of the way to each of the other phase functions:
            how the image changes, to first order, when one takes the place of the medium's.

        Raises
        ------
        SceneError
            When the medium is outside the box, or the model was prepared for Henyey–Greenstein.
        """
        from tankrig.light.prepared.answer import Answer

        self.box.require(medium)
        if isinstance(self.answer, Answer):
            raise SceneError('this prepared model knows Henyey–Greenstein only; prepare with phases = "any"')
        return self.answer.image_and_slopes(medium, others)

    def error_at(self, medium: Medium) -> float:
        """Estimated relative L2 error of one medium's image.

        Raises
        ------
        SceneError
            When the medium is outside the box.
        """
        self.box.require(medium)
        return self.answer.error_at(medium)

    def errors_at(self, medium: Medium) -> tuple[Array, float]:
        """The errors of one medium's image as they lie, of a model of Henyey–Greenstein media.

        Parameters
        ----------
        medium
            Inside the box.

        Returns
        -------
        patterns
            (n, rows, columns) in W/mm²/sr: their covariance is the sum of the patterns' products.
        tables
            What tables of order 2 err by besides, of which only the size is known; relative L2.

        Raises
        ------
        SceneError
            When the medium is outside the box, or the model is one of any phase function.
        """
        about, times = self._about(medium)
        return about.patterns * times, about.tables

    def errors_of_slopes_at(self, medium: Medium) -> Array:
        """What noise the derivatives by σa, σs and g have, (n, 3, rows, columns), as for `errors_at`.

        Raises
        ------
        SceneError
            Likewise.
        """
        about, times = self._about(medium)
        return about.of_slopes * times

    def _about(self, medium: Medium) -> "tuple[_Errors, float]":
        """The errors at a medium nearby, and how many times as bright this one is.

        They change slowly, and as the image does; a live run's fits ask for nearly the same again and again.
        """
        from tankrig.light.prepared.answer import Answer

        self.box.require(medium)
        answer = self.answer
        if not isinstance(answer, Answer):
            raise SceneError("of a model of any phase function only the size of its errors is known; use error_at")
        near = answer.coordinates.near(medium)
        if near not in self._known:
            misses, low = answer.misses_at(near)
            patterns = np.concatenate([self._seen(answer.errors_at(near)), misses.reshape(-1, *answer.shape)])
            size = float(np.linalg.norm(answer.image(near)))
            tables = answer.tables * low / size if size > 0.0 else 0.0
            while len(self._known) >= KEPT:
                self._known.pop(next(iter(list(self._known))), None)
            self._known[near] = _Errors(patterns, self._seen(answer.errors_of_slopes_at(near)), tables, size)
        known = self._known[near]
        return known, float(np.linalg.norm(answer.image(medium))) / known.size if known.size > 0.0 else 1.0

    def _seen(self, cells: Array) -> Array:
        """(…, rows, columns) images of light on the cells that paths were recorded in, (…, cells)."""
        from tankrig.light.prepared.sampling import PathImages

        sampling = PathImages(self.scene, ())
        images = sampling.noise_to_pixels(cells.reshape(-1, *sampling.shape[1:]))
        return images.reshape(*cells.shape[:-1], *self.scene.camera.shape)


def require_henyey_greenstein(scene: Scene) -> None:
    """Refuse a scene whose liquid has another phase function, which prepared models and series do not know yet.

    Raises
    ------
    SceneError
        When it has.
    """
    if scene.medium.phase is not None:
        raise SceneError(
            f'medium.phase of kind "{scene.medium.phase.kind}" is known to predictions and to fits of one image only; '
            'prepared models know Henyey–Greenstein unless they are prepared for any: say phases = "any", or leave it '
            "out, and take their σs and g for those of a Henyey–Greenstein liquid"
        )


def prepare(
    scene: Scene,
    tolerance: float = 0.01,
    progress: Callable[[float], object] | None = None,
    box: "Box | None" = None,
    threads: int = THREADS,
    phases: Literal["hg", "any"] = "hg",
    first: bool = False,
) -> Prepared:
    """Prepare a model that gives the tank's image of any medium, and its derivatives, in about a millisecond.

    It is kept on disk, in the folder that TANKRIG_CACHE names or else the user's cache folder: the next call returns
    at once, and what an interrupted call has done is not done again.

    Parameters
    ----------
    scene
        Tank, projector, pattern and camera; its medium does not matter.
    tolerance
        Relative L2 error to aim for, 0 < tolerance ≤ 1; the time to prepare goes with its inverse square.
    progress
        Called with the share of the work that is done, 0 … 1.
    box
        Ranges of σt, albedo and g; None: σt 0.0005 … 0.12 per mm, albedo 0.5 … 0.9999, g −0.4 … 0.95. A smaller one is
        prepared sooner.
    threads
        That it is prepared with.
    phases
        Which phase functions it answers for: "hg", Henyey–Greenstein's, or "any". For any, light and sight must run
        straight, and lenses and walls be ideal.
    first
        Whether a first model is enough, which is there much sooner where light or sight slant, and errs by up to twice
        as much as the whole one. It is not kept, but the whole one goes on from there. Of any phase functions, and
        where light and sight run straight, it is the whole one.

    Returns
    -------
    Prepared

    Raises
    ------
    SceneError
        When the tolerance is out of range, the scene is dark, the camera has too many pixels, or no model of any phase
        function can be prepared for it.
    CacheError
        When there is no room for the model.

    Warns
    -----
    UserWarning
        When the estimated error is above the tolerance somewhere in the box; it names the largest. When a bench was
        learned, but another one than the scene's, or for other heights or liquids; it names what differs.
    """
    from tankrig.light.prepared.box import Box
    from tankrig.light.prepared.preparation import prepared

    if phases not in ("hg", "any"):
        raise SceneError(f'phases = "{phases}" is unknown; use "hg" or "any"')
    if phases == "hg":
        require_henyey_greenstein(scene)
    if not 0.0 < tolerance <= 1.0:
        raise SceneError(f"tolerance = {tolerance} is outside 0 … 1; give a relative error such as 0.01")
    if not any(beam.irradiance > 0.0 for beam in scene.projector.beams):
        raise SceneError(f"{scene.source or 'the scene'}: no beam has any irradiance; give the light that is on")
    box = box or Box()
    tell = progress or (lambda _: None)
    if phases == "any":
        return _for_any_phase(scene, tolerance, tell, box, threads)
    answer, path = prepared(scene, box, tolerance, tell, threads, first)
    mean, largest, where = answer.error_over_box()
    if largest > tolerance:
        warnings.warn(
            f"the prepared model's error is {mean:.1%} on average and up to {largest:.1%}, more than the tolerance of "
            f"{tolerance:.1%}, near σt = {where.sigma_t:.3g}/mm, albedo {where.albedo:.4g}, g = {where.g:.2g}; "
            "ask for a smaller tolerance or a smaller box if your media are there",
            stacklevel=2,
        )
    return Prepared(scene, box, tolerance, mean, largest, path, answer)


def _for_any_phase(
    scene: Scene, tolerance: float, progress: Callable[[float], object], box: "Box", threads: int
) -> Prepared:
    """See `prepare`."""
    from tankrig.light.prepared.phases.preparation import prepared_for_phases

    answer, path = prepared_for_phases(scene, box, tolerance, progress, threads)
    mean, largest = answer.error_over_box()
    if largest > tolerance:
        warnings.warn(
            f"the prepared model's error is {mean:.1%} on average and up to {largest:.1%} for usual phase functions, "
            f"more than the tolerance of {tolerance:.1%}; ask for a smaller tolerance or a smaller box",
            stacklevel=3,
        )
    return Prepared(scene, box, tolerance, mean, largest, path, answer, "any")
