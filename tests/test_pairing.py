"""No frame is ever taken for another pattern's, whatever latency, stale and dropped frames do."""

import os

import pytest

import tankrig
from tankrig.errors import DeviceError
from tankrig.run.start import new_run
from tankrig.run.state import FinishReason
from tankrig.sequence import Capture, Sequence

from .memory_rig import memory_rig
from .test_v4l2 import CASES, run_preloaded


def passes(folder, monkeypatch, *options: str, timeout_s: float, **environment: str) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    done = run_preloaded(CASES / "pairing.py", folder, *options, timeout_s=timeout_s)
    print(done.stdout, done.stderr)
    assert done.returncode == 0, "see tests/preloaded/pairing.py"


def test_a_hundred_patterns(tmp_path, monkeypatch):
    """Of 29 that were photographed too early, more than five show the one before, as one of these tests has it."""
    passes(
        tmp_path,
        monkeypatch,
        "-k",
        "belongs or bound or latency",
        timeout_s=200.0,
        PATTERNS=os.environ.get("PATTERNS", "100"),
    )


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_ten_thousand_patterns(tmp_path, monkeypatch):
    passes(tmp_path, monkeypatch, "-s", "-k", "belongs", "--timeout=3500", timeout_s=3500.0, PATTERNS="10000")


@pytest.mark.long
def test_overhead_of_a_step(tmp_path, monkeypatch):
    passes(tmp_path, monkeypatch, "-s", "-k", "overhead", timeout_s=280.0, PATTERNS="300")


def test_a_frame_during_which_the_projector_went_away_is_not_stored(tmp_path):
    rig = memory_rig(tmp_path)
    confirmed = []

    def confirm() -> None:
        if len(confirmed) == 2:
            raise DeviceError("projector: its screen is gone; connect it")
        confirmed.append(True)

    rig.projector.confirm = confirm
    runner = new_run(Sequence("gone", (Capture("full", frames=5),), exposure_ms=1.0), rig, tmp_path / "run")
    outcome = runner.run()
    assert (outcome.reason, str(outcome.error)) == (FinishReason.FAILED, "projector: its screen is gone; connect it")
    assert len(tankrig.open_run(tmp_path / "run").events("frame")) == 2
