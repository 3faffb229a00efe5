"""What could be photographed next on a rig, beside what a run has photographed so far."""

from collections.abc import Sequence as Many
from pathlib import Path

from tankrig.advice.expected import Known, Shot
from tankrig.advice.ranking import Candidate
from tankrig.advice.starting import from_run
from tankrig.errors import ImageError
from tankrig.live.photograph_plan import PhotographPlan
from tankrig.run.reading import open_run
from tankrig.sequence import Capture, Dose, Mix, Pace, Sequence

GROWTH = (1.0, 1.5, 2.0, 4.0)
"""Doses that are compared where none are named, as multiples of what the tank holds."""
FIRST_DOSES_UL = (50.0, 100.0, 200.0, 400.0, 800.0)


def beginning_of(run_folder: Path) -> tuple[Known, list[Shot], PhotographPlan, float]:
    """What advice for a run starts from.

    Returns
    -------
    What it has found, what it has photographed, what it was planned to photograph, and its exposure in ms

    Raises
    ------
    ImageError
        When it has no photograph of ink, or no fit of one.
    """
    run = open_run(run_folder)
    known, taken, _ = from_run(run)
    return known, taken, PhotographPlan.of_run(run), float(run.require_sequence()["exposure_ms"])


def candidates_of(
    taken: Many[Shot],
    plan: PhotographPlan,
    exposure_ms: float,
    pace: Pace,
    most_ul: float,
    doses_ul: tuple[float, ...] = (),
    frames: int = 4,
) -> list[Candidate]:
    """Every lit pattern at every dose that the budgets allow.

    Parameters
    ----------
    taken, plan
        What has been photographed, and the patterns there are.
    exposure_ms, pace
        Of the frames, and how long steps take on the rig.
    most_ul
        That the tank may hold, µl.
    doses_ul
        To compare: what the tank holds in all, µl; where empty, some that suit what it holds.
    frames
        That are averaged.

    Raises
    ------
    ImageError
        When the tank may hold none of these doses.
    """
    held_ul = 1000.0 * max((shot.dose_ml for shot in taken), default=0.0)
    totals = doses_ul or (tuple(held_ul * by for by in GROWTH) if held_ul else FIRST_DOSES_UL)
    allowed = sorted({total for total in totals if held_ul <= total <= most_ul})
    if not allowed:
        raise ImageError(
            f"the tank holds {held_ul:g} µl and may hold {most_ul:g} µl, so that none of the doses compared is "
            "possible; give others with --dose-ul"
        )
    shares = [shot.dose_sd_ml / shot.dose_ml for shot in taken]
    sd = max(shares, default=0.0)
    steps = Sequence("next", (Mix(), Capture("full", frames)), exposure_ms=exposure_ms)
    found = []
    for total in allowed:
        dosed = total > held_ul
        seconds = sum(pace.seconds(one, steps, held_ul) for one in (Dose(total), Mix())) if dosed else 0.0
        seconds += pace.seconds(Capture("full", frames), steps, total)
        for key, scene in plan.scenes.items():
            shot = Shot(plan.patterns[key].name, scene, total / 1000.0, sd * total / 1000.0, frames, plan.counts[key])
            found.append(Candidate(shot, seconds / 60.0, total - held_ul))
    return found
