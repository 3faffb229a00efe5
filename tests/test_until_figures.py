"""How much light early stopping saves on the demo's experiment: `pytest -m long -s tests/test_until_figures.py`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.live.attached import fitted_live
from tankrig.report.results import recorded
from tankrig.run.reading import open_run
from tankrig.run.state import FinishReason
from tankrig.sequence import Capture, Sequence, Series
from tankrig.sequence.until import Until
from ui.cli import demo
from ui.cli.run import open_runner

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]

FRAMES = 12
"""A person who doesn't know how many are needed takes enough."""
TRUTH = np.array([4.0e-4, 0.012, 0.71])
DOSES = 3


def sequence(until: Until | None) -> Sequence:
    """The demo's, with more frames of each pattern."""
    whole = demo.sequence_of(demo.DOSES_UL[:DOSES])
    (series,) = whole.steps
    assert isinstance(series, Series)
    steps = tuple(
        replace(step, frames=FRAMES, until=until, timeout_s=until and 300.0)
        if isinstance(step, Capture) and step.pattern != "dark"
        else step
        for step in series.steps
    )
    return replace(whole, steps=(replace(series, steps=steps),))


def test_stopping_when_enough_is_known_saves_frames_and_patterns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Light, time and disk spent on what is known already are wasted; the result must not be worse for it."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    found = {}
    for name, until in (("all", None), ("until", Until(sigma_s="0.2 %", g=0.002))):
        path = tmp_path / name
        runner = open_runner(sequence(until), path, demo.rig_beside(path, demo.TRUTH))
        with fitted_live(runner, patience_s=900.0):
            assert runner.run().reason is FinishReason.COMPLETED
        run = open_run(path)
        _, series = recorded(run)
        assert series is not None
        lit = [event for event in run.events("frame") if run.patterns[event["pattern_hash"]].pixels.any()]
        ink = series.ink
        off = np.array([ink.sigma_a, ink.sigma_s, ink.g]) / TRUTH - 1.0
        patterns = len({(event["step"], event["pattern_hash"]) for event in lit})
        found[name] = len(lit), patterns, off, np.array(series.sd[:3]) / TRUTH
        print(f"\n{name}: {len(lit)} frames of {patterns} projected patterns; per ml off by "
              + ", ".join(f"{one:+.2%} (± {sd:.2%})" for one, sd in zip(*found[name][2:], strict=True)))  # fmt: skip
    assert found["until"][0] < found["all"][0]
    assert np.abs(found["until"][2][1:]).max() < 0.01
