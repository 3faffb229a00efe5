"""Which models a run's doses are to have, and in which order they are prepared."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from tankrig.light.prepared.about import box_for, holds
from tankrig.light.prepared.box import Box
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.live.preparing import LOOK, Preparing, foreseen
from tankrig.live.results import DoseFit, diluted
from tankrig.scene.description import Medium, Scene


@dataclass(frozen=True)
class _Asked:
    """Models that a dose is to have: of scenes, for a box. Those of a first look are no dose's."""

    dose_ml: float | None
    scenes: tuple[Scene, ...]
    box: Box


class AskedModels:
    """Asks for the models of a run's doses, for what is foreseen of each.

    Each look at ink that mixes, and each dose, foresees the following doses a little better: what is asked for a dose
    takes the place of what was asked for it before, which is wanted no more.

    Parameters
    ----------
    preparing
        Whom to ask.
    plan
        Of the run; None where nothing is to be asked for but what fits wait for.
    """

    def __init__(self, preparing: Preparing, plan: PhotographPlan | None) -> None:
        self.preparing, self._plan = preparing, plan
        self._asked: list[_Asked] = []
        self._fitted_in: dict[float, Box] = {}

    def box_of(self, dose_ml: float, liquid: Medium) -> Box:
        """The box that a dose was fitted in, as long as that holds its liquid; else one that holds it well inside.

        Liquids that Henyey–Greenstein does not describe end near boxes' edges: to have them well inside an emulsion's
        bench wanted more than ten models; another one without wants six.
        """
        own = self._fitted_in.get(dose_ml)
        return own if own is not None and own.holds(liquid) else self.preparing.box(liquid)

    def fitted_in(self, dose_ml: float) -> Box:
        """The box that a dose was fitted in last."""
        return self._fitted_in[dose_ml]

    def keep_box(self, dose_ml: float, box: Box) -> None:
        """Remember that a dose was fitted in a box."""
        self._fitted_in[dose_ml] = box

    def begin(self) -> None:
        """Ask for what can be prepared before there is anything to fit: for the ink expected, and for a first look."""
        if self._plan is None:
            return
        ink, asked = self._plan.ink, []
        doses_ml = sorted(one for one in self._plan.doses_ml if one > 0.0)
        liquids = {} if ink is None else {one: diluted(ink, 1.0, one) for one in doses_ml}
        for scenes, box in foreseen(list(self._plan.scenes.values()), doses_ml, ink):
            # A liquid beyond all edges is in no box, but one was made for it.
            of = next((one for one, liquid in liquids.items() if holds(box, liquid) or box == box_for(liquid)), None)
            asked.append(_Asked(None if box == LOOK else of, tuple(scenes), box))
        self._ask(asked)

    def foresee(self, fit: DoseFit, at_once: bool = True) -> None:
        """Ask for models of a dose as it was found, and of all that are to follow; next, or after all others."""
        if self._plan is None:
            return
        scenes = tuple(self._plan.scenes.values())
        following = sorted({one for one in self._plan.doses_ml if one > 1.001 * fit.dose_ml})
        boxes = {one: self.preparing.box(diluted(fit.medium, fit.dose_ml, one)) for one in following}
        boxes = {fit.dose_ml: self.box_of(fit.dose_ml, fit.medium)} | boxes
        self._ask([_Asked(dose_ml, scenes, box) for dose_ml, box in boxes.items()], at_once)

    def await_models(self, dose_ml: float, scenes: Iterable[Scene], box: Box) -> None:
        """Ask for models that a dose's fit waits for: next, where they have not been asked for."""
        others = () if self._plan is None or box == LOOK else self._plan.scenes.values()
        wanted = _Asked(None if box == LOOK else dose_ml, tuple(dict.fromkeys((*scenes, *others))), box)
        known = next((one for one in self._asked if (one.dose_ml, one.box) == (wanted.dose_ml, wanted.box)), None)
        if known is None or not set(wanted.scenes) <= set(known.scenes):
            self._ask([wanted])

    def _ask(self, asked: Sequence[_Asked], at_once: bool = True) -> None:
        """Have models prepared next, or after all others; the most wanted first."""
        doses = [one.dose_ml for one in asked]
        others = [one for one in self._asked if one.dose_ml not in doses]
        self._asked = [*asked, *others] if at_once else [*others, *asked]
        self.preparing.want([(one.scenes, one.box) for one in self._asked])
