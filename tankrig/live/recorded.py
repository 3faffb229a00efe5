"""What of a recorded run counts: its fits, where they hold, and which of its frames are waves and no photographs."""

from tankrig.live.photograph_plan import PhotographPlan
from tankrig.run.conditions import clamped
from tankrig.run.journal import Event
from tankrig.run.reading import Run
from tankrig.sequence.loading import sequence_from_table


def wave_names(run: Run) -> frozenset[str]:
    """Names of the patterns of a run's `separate` steps, whose frames are not fitted."""
    if "sequence" not in run.settings:
        return frozenset()
    return frozenset(sequence_from_table(dict(run.settings["sequence"]), str(run.path)).waves)


def fits_that_hold(run: Run) -> tuple[Event, ...]:
    """The fits that a run recorded, but for those of a tankrig that took the exposure that was asked for.

    Where the camera had set another one, and the frames' lines do not say so, they are wrong and are made anew.
    """
    older = [event for event in run.events("frame") if event.get("exposure_ms") is None]
    asked = PhotographPlan.of_run(run).settings if older and run.fits else ()
    for event in older if asked else ():
        actual = run.conditions[event["index"]].camera
        if actual is not None and clamped(asked[event["step"]], actual):
            return ()
    return run.fits
