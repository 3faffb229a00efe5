"""The first hour: its files and commands, typed one after the other, do what the page says they do."""

import json
import re
from pathlib import Path
from shlex import split

import pytest

import tankrig

from .bench_by_hand import typed
from .seen_pictures import report_shows
from .test_docs import BLOCKS

PAGE = [block for block in BLOCKS if block.page == "docs/first_hour.md"]


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_the_pages_commands_lead_to_a_fitted_experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    said = {}
    for block in PAGE:
        if block.language == "toml":
            name = re.match(r"# (\S+)\n", block.text)
            assert name, block
            (tmp_path / name[1]).write_text(block.text, encoding="utf-8")
        for line in block.text.splitlines() if block.language == "sh" else ():
            if not line.startswith("tankrig "):
                continue
            done = typed(split(line)[1:], tmp_path)
            assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
            said[line] = done.stdout + done.stderr
    predicted, _, by_single, dry_run, run = said.values()
    assert re.search(r"orders +1: 1[34]\.\d%", predicted), "single scattering is a seventh of the light"
    found = json.loads((tmp_path / "fitted" / "scene-fit.json").read_text(encoding="utf-8"))
    assert found["medium"]["sigma_s"] == pytest.approx(0.015, rel=0.02)
    assert "holds structure" in " ".join(by_single.split())
    assert "nothing has moved" in dry_run
    assert "simulated rig" in run
    stored = tankrig.open_run(tmp_path / "first")
    assert stored.end is not None
    assert stored.end["reason"] == "completed"
    report_shows((stored.path / "report.html").read_text(encoding="utf-8"), stored.path)
    names: dict[str, object] = {}
    monkeypatch.chdir(tmp_path)
    (python,) = [block.text for block in PAGE if block.language == "python"]
    exec(compile(python, "docs/first_hour.md", "exec"), names)
