"""The page for newcomers: its commands, typed one after the other, lead from a lens cap to the ink's coefficients."""

from pathlib import Path

import pytest

import tankrig

from .bench_by_hand import commands_of_the_page, found_by, make_small, typed
from .seen_pictures import report_shows

SET_ASIDE = 3


def test_the_page_begins_with_a_bench_whose_doctor_names_the_next_command_of_the_page(tmp_path: Path) -> None:
    """What follows takes minutes and is walked by CI; each of its commands has quick tests of its own."""
    made, asked, first = commands_of_the_page()[:3]
    assert typed(made, tmp_path).returncode == 0
    told = typed(asked, tmp_path)
    assert told.returncode == 0, told.stderr
    assert told.stdout.splitlines()[-1] == f"next: tankrig {' '.join(first)}"


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.timeout(1800)
def test_the_pages_commands_lead_from_lens_cap_to_report(seed: int, tmp_path: Path) -> None:
    commands = commands_of_the_page()
    assert commands[0][:3] == ["demo", "--bench", "--by-hand"]
    said = {}
    for words in commands:
        words = [*words, "--wide-lens"] if words[0] == "demo" and seed == 1 else words  # which takes half as long again
        here = [str(seed) if before == "--seed" else word for before, word in zip(["", *words], words, strict=False)]
        done = typed(here, tmp_path)
        busy = words[:2] == ["calibrate", "latency"] and done.returncode == SET_ASIDE  # of a bench in such a hurry
        assert done.returncode == 0 or busy, f"{' '.join(here)}\n{done.stdout}{done.stderr}"
        said[tuple(words[:2]), len(words)] = done.stdout
        if words[0] == "demo":
            make_small(tmp_path / "bench")
    first, last = [text.splitlines()[-1] for key, text in said.items() if key[0][0] == "doctor"]
    assert first == "next: tankrig calibrate radiometry --rig bench/rig.toml"
    assert last.startswith(("next: tankrig run bench/bench_dilution.toml", "next: tankrig calibrate latency"))
    run = tankrig.open_run(tmp_path / "bench" / "run")
    assert run.end is not None
    assert run.end["reason"] == "completed"
    report_shows((run.path / "report.html").read_text(encoding="utf-8"), run.path)
    found = found_by(run.path, tmp_path / "bench" / "rig.toml")
    assert [round(row["dose_ml"], 3) for row in found["doses"]] == [0.1, 0.25]
    ink, sd, truth = found["ink_per_ml"], found["ink_sd"], found["truth_per_ml"]
    assert abs(ink["sigma_s"] - truth["sigma_s"]) < max(0.05 * truth["sigma_s"], 3.5 * sd[1])
    assert abs(ink["g"] - truth["g"]) < max(0.05, 3.5 * sd[2])
