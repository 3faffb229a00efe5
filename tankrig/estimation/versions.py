"""Versions of one forward model, which a fit goes through: cheap, accurate, differentiated, exact."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tankrig.estimation.coordinates import Range
from tankrig.estimation.differences import Forward, Slopes, family_slopes_of, liquid_slopes_of, slopes_of
from tankrig.estimation.followed import Followed, Image, Model, Solved
from tankrig.estimation.light_beside import WithBeside
from tankrig.estimation.phase_families import Family
from tankrig.estimation.with_prepared import Lifted, WithPrepared
from tankrig.prediction import Prediction
from tankrig.scene import Medium
from tankrig.scene.phase_table import PhaseFunction

Exact = Callable[[Medium, float], Prediction]
"""The same as accurately as can be, with so many times as many light paths."""


@dataclass(frozen=True)
class Models:
    """Versions of one forward model.

    Parameters
    ----------
    coarse
        Cheap.
    refine
        From a medium near the optimum to an accurate version and one to differentiate; None where the cheap one does
        for both.
    slopes
        Derivatives by σa, σs, g, (3, rows, columns), of the model itself; None to take differences.
    range
        Media that it answers for; None: all.
    exact
        The most accurate version, for one image at the optimum, and with so many times its paths; None where the
        accurate one is that.
    central
        Whether differences look at both sides.
    family
        Of the phase functions of its media; None: Henyey–Greenstein.
    look
        Pixels along the side of a block that the search takes for one, and the cheap version of such blocks' image;
        None where it looks at single pixels.
    low
        Orders 1 and 2 alone, where they are exact and cost little beside the others; None where they are not.
    along
        Derivatives by σa, σs and the shares of the ways to other phase functions, of a model that has them for less
        than images; None to take differences.
    different
        Gives versions for media of another family; None: these.
    slopes_noise
        Patterns of the noise of `slopes`, (n, 3, rows, columns); None where it is not known.
    prepares
        Whether accurate versions are prepared about a medium, so that they answer for its neighbourhood only.
    roughly
        As `refine`, by fewer light paths, for images that hold more than noise; None: that.
    """

    coarse: Model
    refine: Callable[[Medium], tuple[Model, Model]] | None
    slopes: Slopes | None = None
    range: Range | None = None
    exact: Exact | None = None
    central: bool = True
    family: Family | None = None
    look: tuple[int, Model] | None = None
    low: Model | None = None
    along: "Callable[[Medium, Sequence[PhaseFunction]], Image] | None" = None
    different: "Callable[[Family], Models] | None" = None
    slopes_noise: Slopes | None = None
    prepares: bool = False
    roughly: Callable[[Medium], tuple[Model, Model]] | None = None

    def of(self, family: Family | None) -> "Models":
        """Versions for media of a family's phase functions."""
        own = self if self.different is None or family is None else self.different(family)
        return replace(own, family=family)

    def slopes_of(self, model: Model, length_mm: float) -> Slopes:
        """Derivatives: the model's own, or by differences of one of its versions."""
        if self.family is not None and self.along is not None:
            return family_slopes_of(self.along, self.family)
        if isinstance(model, WithPrepared | Lifted) or (isinstance(model, Followed) and model.family is self.family):
            return model.slopes
        if self.family is not None:
            low = None if self.low is None else image_of(self.low)
            return liquid_slopes_of(image_of(model), length_mm, self.family, self.central, low=low)
        if isinstance(model, Followed):  # of a family: a first guess is Henyey–Greenstein's
            return replace(model, family=None).slopes
        if isinstance(model, Solved | WithBeside):
            return model.slopes
        return self.slopes or slopes_of(image_of(model), length_mm, self.central)

    def slopes_noise_of(self, model: Model) -> Slopes | None:
        """Patterns of these derivatives' noise, (n, 3, rows, columns); None where they are not known."""
        if isinstance(model, Followed):
            return model.slopes_noise if model.family is self.family else None
        if self.family is None and isinstance(model, Solved | WithBeside):
            return model.slopes_noise
        return self.slopes_noise if self.family is None else None

    def quick(self, model: Model) -> bool:
        """Whether a version's derivatives come with its images, for less than their own price, or save many of them."""
        if isinstance(model, WithPrepared):
            return True
        beams = model.main if isinstance(model, WithBeside) else model
        return self.slopes is not None or (self.family is None and isinstance(beams, Followed))

    def refined(self, medium: Medium, roughly: bool = False) -> tuple[Model, Model]:
        """See `refine` and `roughly`."""
        refine = self.roughly if roughly and self.roughly is not None else self.refine
        return refine(medium) if refine is not None else (self.coarse, self.coarse)


def is_noisy(models: Models, model: Model) -> bool:
    """Whether a version's images and derivatives have the noise of light paths, so that steps that fail by it end.

    With a family's many coordinates ever shorter steps still lead on: an emulsion's p(90°) was 8 % off without them,
    and what is left to correct took twice as long.
    """
    return models.family is None and isinstance(model, Followed | Solved | WithBeside)


def image_of(model: Model) -> Forward:
    """Its image alone."""
    return lambda medium: model(medium).image


def corrected(model: Model, centre: Medium, exact: Prediction) -> Model:
    """A model with the error that it shows at one medium taken off, which stays what it is nearby."""
    error = model(centre).image - exact.image
    return lambda medium: replace(exact, image=model(medium).image - error)
