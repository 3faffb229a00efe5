"""Exact images next to a place where there is one by all light paths, for a share of its price."""

from dataclasses import dataclass, replace

import numpy as np

from tankrig.estimation.followed import Image, Model
from tankrig.prediction import Prediction
from tankrig.scene import Medium


@dataclass(frozen=True, eq=False)
class Nearby:
    """Exact images next to a place where there is one by all light paths.

    Noise of the same lattices is alike at places some standard deviations apart (correlated by .92 to .999), so that a
    share of them tells what changes from one to the other, for that share of the price.

    Parameters
    ----------
    part
        Images by a share of the paths, the same at every place.
    at
        The place.
    whole
        The image there.
    by_all
        Whether `part` follows all of the paths, so that it gives `whole` there.
    """

    part: Model
    at: Medium
    whole: Prediction
    by_all: bool = False

    def __call__(self, medium: Medium, _: float = 1.0) -> Prediction:
        """An exact image, with the patterns of its noise."""
        if medium == self.at:
            return self.whole
        here, there = self._here, self.part(medium)
        image = self.whole.image + there.image - here.image
        if self.whole.patterns is None:
            return replace(there, image=image)
        patterns = np.concatenate([self.whole.patterns, self.more_noise(medium)])
        return replace(there, image=image, stderr=np.sqrt(np.sum(np.square(patterns), axis=0)), patterns=patterns)

    @property
    def _here(self) -> Prediction:
        """The place's image by the part."""
        return self.whole if self.by_all else self.part(self.at)

    def more_noise(self, medium: Medium) -> Image:
        """(n, rows, columns) patterns of what its noise is more than at the place; none where they are not known."""
        here, there = self._here.patterns, self.part(medium).patterns
        if here is None or there is None or medium == self.at:
            return np.zeros((0, *self.whole.image.shape))
        return np.asarray(there - here)
