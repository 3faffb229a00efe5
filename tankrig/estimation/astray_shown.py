"""Which light astray a residual shows: a cause whose own pattern is seen in it, and that moves a coefficient."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.astray_causes import SIGNS, causes
from tankrig.estimation.found_optics import as_found
from tankrig.estimation.left_over import Left, stated_errors
from tankrig.estimation.light_beside import sizes_along
from tankrig.estimation.misfit import shown
from tankrig.estimation.problem import Evaluation
from tankrig.estimation.residual import ALIKE, COUNTED
from tankrig.estimation.verdict import TELLING_MOVE
from tankrig.scene import Scene

Array = NDArray[np.float64]
Image = NDArray[np.floating]

TOLD = 2.5
"""Standard deviations of its size from which on a cause is named where the residual is no more than noise. By chance
3 % of images show one of eight causes so; at 2 it would be 9 %, at 3 .7 %."""
WORTH_A_LOOK = 1.25
"""Standard deviations by a rough pattern from which on a cause is looked at by its own. Patterns alike by a cosine of
.88 differ by half a standard deviation of chance, so that 2 % of the causes that are just told stay unseen."""


@dataclass(frozen=True)
class Shown:
    """A cause that a residual shows, see `astray_shown`.

    Parameters
    ----------
    name
        Of the cause.
    deviations
        By how many standard deviations its size is seen.
    moved
        (values,) what it moves values by, or a cause that is nearly as likely and moves them more.
    explained
        (n,) what it explains of the residual, whitened.
    others
        Causes that are nearly as likely.
    """

    name: str
    deviations: float
    moved: Array
    explained: Array
    others: tuple[str, ...] = ()


def astray_shown(
    best: Evaluation, left: Left, scene: Scene, spread: Array, own: int = 3, name: str | None = None
) -> Shown | None:
    """The cause that a residual shows most, if it moves a coefficient by `TELLING_MOVE`; None where none does.

    Light astray may be no more than noise by its size, and yet move the coefficients by ten standard deviations. It is
    looked for by its own pattern.

    Parameters
    ----------
    best, left
        Of the fit.
    scene
        With the fitted liquid.
    spread
        Covariance of the values without it.
    own
        How many of the values are the liquid's.
    name
        Of the only cause that is asked for; None: all.
    """
    residual = _Residual(best, left, scene, name is None and left.prediction.model == "prepared")
    names = [one for one in residual.causes(left.smooth) if name in (None, one)]
    if name is None and not residual.quick:
        names = residual.worth_a_look(names)
    if not names:
        return None
    sizes, chances, moved, faults = residual.told(names, residual.own_pattern)
    moves = np.abs(moved / np.sqrt(np.maximum(np.diag(spread), 1e-300)))[:, :own].max(axis=1)
    low, high = np.array([SIGNS[one].sizes(scene) for one in names]).T
    believed = (sizes > low) & (sizes - TOLD * chances < high)
    deviations = sizes / chances
    seen = np.where((moves > TELLING_MOVE) & believed, np.abs(deviations), 0.0)
    most = int(np.argmax(seen))
    if seen[most] <= TOLD:
        return None
    explained = sizes[most] * faults[most] - moved[most] @ best.sensitivity.changes
    # A veil and a floor are told apart by chance: whichever is named, what the other may have done is counted.
    alike = np.flatnonzero((seen > TOLD) & (seen**2 > seen[most] ** 2 - ALIKE))
    others = tuple(names[one] for one in alike if one != most)
    counted = np.flatnonzero((seen > TOLD) & (seen**2 > seen[most] ** 2 - COUNTED))
    worst = counted[int(np.argmax(moves[counted]))]
    return Shown(names[most], float(deviations[most]), moved[worst], explained, others)


class _Told(NamedTuple):
    """What a residual says of causes.

    Parameters
    ----------
    sizes, chances
        (causes,) how large each is, and the standard deviation of that by chance.
    moved
        (causes, values) by how much it moves values.
    faults
        (causes, n) what a unit of it changes of the residual, whitened.
    """

    sizes: Array
    chances: Array
    moved: Array
    faults: Array


@dataclass(frozen=True)
class _Residual:
    """What one image's fit leaves, asked for causes; if `quick`, not for those that take longer than a prepared fit."""

    best: Evaluation
    left: Left
    scene: Scene
    quick: bool

    @property
    def gain(self) -> float:
        """Image units per W/mm²/sr, as fitted."""
        return self.best.scale[0]

    @cached_property
    def along(self) -> Mapping[str, float]:
        """Sizes of what was fitted along, which is no cause any more."""
        return sizes_along(self.best.problem.blocks, self.best.values)

    @cached_property
    def found(self) -> Scene:
        """The scene with that."""
        return as_found(self.scene, self.along)

    def causes(self, light: Image) -> dict[str, Callable[[], list[Array]]]:
        """Patterns of those that may be one, for fitted light."""
        found = causes(self.scene, light / self.gain, self.quick, self.found)
        return {name: pattern for name, pattern in found.items() if SIGNS[name].along not in self.along}

    def own_pattern(self, cause: str, light: Image) -> Array:
        """What fitted light gains by a unit of a cause."""
        return self.gain * self.causes(light)[cause]()[0]

    def rough_pattern(self, cause: str, light: Image) -> Array:
        """Nearly the same, for a cause that has such a pattern."""
        rough = SIGNS[cause].rough
        assert rough is not None
        return self.gain * rough(self.scene, light / self.gain)

    def worth_a_look(self, names: Sequence[str]) -> list[str]:
        """Those that a rough pattern does not show to be less than `WORTH_A_LOOK`."""
        roughly = [one for one in names if SIGNS[one].rough is not None]
        if not roughly:
            return list(names)
        looked = self.told(roughly, self.rough_pattern)
        hardly = {
            one
            for one, size, chance in zip(roughly, looked.sizes, looked.chances, strict=True)
            if abs(size) < WORTH_A_LOOK * chance
        }
        return [one for one in names if one not in hardly]

    def told(self, names: Sequence[str], pattern: Callable[[str, Image], Array]) -> _Told:
        """What the residual says of causes by patterns of them."""
        best, left = self.best, self.left
        patterns, (view,) = np.array([pattern(one, left.smooth) for one in names]), best.problem.views
        whole = view.whitened(patterns)
        faults = best.project_out(whole)[:, : best.left.size]

        def gained(light: Image, noise: Image) -> Array:
            found = np.zeros_like(patterns)
            for number, one in enumerate(names):
                if SIGNS[one].of_image:
                    found[number] = pattern(one, light + noise) - patterns[number]
            return found

        met = met_by_noise(best, left, whole, gained)
        errors = stated_errors(best, [left])
        return _Told(*shown(best.sensitivity, best.left, faults, [left.noise], errors, met), faults)


def met_by_noise(best: Evaluation, left: Left, changes: Array, gained: Callable[[Image, Image], Array]) -> Array:
    """Products of faults with a residual that noise of the model's image makes by being in both.

    Faults c are made of the fitted image m + e, which the residual y − m − e has as well: ⟨c · residual⟩ has −⟨Δc · e⟩
    where no fault is, Δc being what e changes of c. And e draws a free gain, see `Scaling.drawn`. In images that light
    paths' noise dominates, blur was named by three standard deviations that way.

    Parameters
    ----------
    best, left
        Of the fit of one image.
    changes
        (faults, n) whitened, with all that a gain could make of them.
    gained
        From the image and noise, in units of the fitted light, to what faults gain by that noise.

    Returns
    -------
    (faults,) array.
    """
    (view,), gain, scaling = best.problem.views, best.scale[0], best.problem.scaling
    found, squared, pixels = np.zeros(len(changes)), 0.0, best.left.size
    for noise in left.own:
        whole = view.whitened(noise)
        kept = best.project_out(whole[None])[0, :pixels]
        found -= view.whitened(gained(left.smooth, noise)) @ kept
        squared += float(whole @ whole)
    if squared > 0.0 and scaling.free_gain:
        models, ones = [gain * model for model in best.models], [view.one]
        values = np.array([best.sensitivity.step(one) for one in best.project_out(changes)[:, :pixels]])
        # What values have followed, the residual shows no more.
        found += scaling.drawn(changes, models, ones, squared)
        found -= values @ scaling.drawn(best.changes_at(gain), models, ones, squared)
    return found
