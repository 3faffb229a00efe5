"""Whole benches, by commands alone, beside their truth."""

from pathlib import Path

import pytest

from .bench_trials import MOST_SD, Trial, summary, walk_all

SEEDS = [201, 202, 203]


@pytest.mark.long
@pytest.mark.timeout(4 * 3600)
def test_benches_come_out_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three unseen ones; `python tests/bench_trials.py --seeds … --out …` walks more, and goes on where it stopped."""
    trials: list[Trial] = []
    for trial in walk_all(SEEDS, tmp_path / "trials", 1):
        trials.append(trial)
        with capsys.disabled():
            print(f"\n{trial}", flush=True)
    with capsys.disabled():
        print(f"\n{summary(trials)}", flush=True)
    assert [trial.error for trial in trials] == ["", "", ""]
    assert max(abs(z) for trial in trials for z in trial.sds) < MOST_SD
    assert sum(all(trial.close) for trial in trials) >= 2
