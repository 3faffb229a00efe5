"""No frame is ever taken for another pattern's, whatever latency, stale and dropped frames do."""

import os

import pytest

from .test_v4l2 import CASES, run_preloaded


def passes(folder, monkeypatch, *options: str, timeout_s: float, **environment: str) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    done = run_preloaded(CASES / "pairing.py", folder, *options, timeout_s=timeout_s)
    print(done.stdout, done.stderr)
    assert done.returncode == 0, "see tests/preloaded/pairing.py"


def test_hundreds_of_patterns(tmp_path, monkeypatch):
    passes(tmp_path, monkeypatch, "-k", "belongs or bound or latency", timeout_s=200.0, PATTERNS=os.environ.get("PATTERNS", "200"))


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_ten_thousand_patterns(tmp_path, monkeypatch):
    passes(tmp_path, monkeypatch, "-s", "-k", "belongs", "--timeout=3500", timeout_s=3500.0, PATTERNS="10000")


@pytest.mark.long
def test_overhead_of_a_step(tmp_path, monkeypatch):
    passes(tmp_path, monkeypatch, "-s", "-k", "overhead", timeout_s=280.0, PATTERNS="300")
