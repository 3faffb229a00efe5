"""`demo --bench`: its folder, and what becomes of it when it is stopped."""

import json
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from drivers.rig import load_rig_file, true_bench, true_liquids
from tankrig.sequence import load_sequence
from ui.cli import main
from ui.cli.demo_bench import left_of, measured_beside_true, way_of

from .bench_by_hand import TREE

CTRL_C_HEARD = (
    "import signal, sys\nfrom ui.cli import main\n"
    "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # who runs tests in the background ignores it
    "sys.exit(main())"
)


def bench(folder: Path, seed: int, *optics: str) -> Path:
    words = ["demo", "--bench", "--by-hand", "--seed", str(seed), "--doses", "2", "--out", str(folder), *optics]
    assert main(words) == 0
    return folder


def test_a_seed_is_a_bench_and_its_ink_and_the_folder_says_what_to_type(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two people who talk about bench 3 must have the same one, and its truth must be what the demo shows."""
    folders = [bench(tmp_path / name, seed) for name, seed in (("a", 3), ("b", 3), ("c", 4))]
    said = capsys.readouterr().out.splitlines()
    assert said[1] == f"tankrig calibrate radiometry --rig {folders[0] / 'rig.toml'}"
    assert f"tankrig run {folders[0] / 'bench_dilution.toml'} --rig {folders[0] / 'rig.toml'} --dry-run" in said
    rigs = [load_rig_file(folder / "rig.toml") for folder in folders]
    levels = [truth.level_mm for rig in rigs if (truth := true_bench(rig))]
    inks = [liquids[1] for rig in rigs if (liquids := true_liquids(rig))]
    assert levels[0] == levels[1] != levels[2]
    assert inks[0] == inks[1] != inks[2]
    assert all(0.5 <= ink.g <= 0.85 and 0.018 <= ink.sigma_s <= 0.022 for ink in inks)
    assert load_sequence(folders[0] / "bench_dilution.toml").ink_ul == 250.0
    assert measured_beside_true(rigs[0]) == [], "nothing is measured yet"
    assert next(left_of(folders[0])) == next(way_of(folders[0]))


def test_a_bench_of_glass_says_its_walls_and_hides_the_rest(tmp_path: Path) -> None:
    """Who owns a tank knows that it is of glass; what lenses and the floor do is to be measured, or fitted along."""
    files = [bench(tmp_path / name, 3, *more) / "rig.toml" for name, more in (("plain", ()), ("glass", ("--walls",)))]
    walls = [rig.bench.tank.faces for rig in map(load_rig_file, files) if rig.bench is not None]
    assert walls[0].dark
    assert [face.kind for face in walls[1].all] == ["glass"] * 4 + ["black"]
    plain, glass = (tomllib.loads(file.read_text(encoding="utf-8"))["camera"]["truth"] for file in files)
    assert glass["stray"]["glass"] == ["entry", "far", "left", "right"]
    assert 0.0 < glass["stray"]["floor"] < 0.05
    assert glass["stray"]["projector_halo"] > 0.0
    assert glass["ink"] == plain["ink"], "the same bench else"
    assert glass["stray"].items() > plain["stray"].items()


def test_a_bench_with_an_emulsion_hides_its_phase_function(tmp_path: Path) -> None:
    """No liquid of a lab is Henyey–Greenstein; who walks the demo finds what a lab would."""
    files = [bench(tmp_path / name, 3, *more) / "rig.toml" for name, more in (("ink", ()), ("oil", ("--emulsion",)))]
    for file in files:
        assert load_sequence(file.with_name("bench_dilution.toml")).phase is None
    ink, oil = (liquids[1] for file in files if (liquids := true_liquids(load_rig_file(file))))
    assert ink.phase is None
    assert oil.phase is not None
    assert oil.phase.kind == "mie"
    assert 0.6 < oil.g < 0.87
    assert (oil.sigma_a, oil.sigma_s) == (ink.sigma_a, ink.sigma_s), "the same bench else"


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "keep").write_text("this")
    assert main(["demo", "--bench", "--out", str(tmp_path / "mine")]) == 2
    assert "exists and holds no bench" in capsys.readouterr().err
    assert [file.name for file in (tmp_path / "mine").iterdir()] == ["keep"]
    there = bench(tmp_path / "bench", 1)
    assert main(["demo", "--bench", "--seed", "2", "--out", str(there)]) == 2
    assert "holds a bench already" in capsys.readouterr().err
    assert main(["demo", "--seed", "2"]) == 2


def test_what_fails_says_where_and_how_to_go_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = bench(tmp_path / "bench", 1)
    rig = folder / "rig.toml"
    rig.write_text(rig.read_text().replace('driver = "simulated-camera"', 'driver = "no-such-camera"'))
    assert main(["demo", "--bench", "--out", str(folder), "--json"]) != 0
    said = capsys.readouterr()
    assert said.err.splitlines()[-1] == (
        f"stopped at: tankrig calibrate radiometry --rig {rig}; to go on where it stopped: "
        f"tankrig demo --bench --out {folder}"
    )
    assert '"parts"' not in said.out


def test_ctrl_c_ends_it_in_a_sentence_and_leaves_nothing_half_done(tmp_path: Path) -> None:
    folder = tmp_path / "bench"
    words = ["demo", "--bench", "--seed", "1", "--out", str(folder), "--json"]
    process = subprocess.Popen(
        [sys.executable, "-c", CTRL_C_HEARD, *words],
        env=os.environ | {"PYTHONPATH": str(TREE)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if "takes about" in line:
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60.0)
    assert process.returncode == 1, err
    assert out == ""
    assert err.splitlines()[-1].endswith(f"to go on where it stopped: tankrig demo --bench --out {folder}")
    assert "Traceback" not in err
    assert not list(folder.rglob("radiometry-*")), "half a calibration is none"
    assert json.dumps(next(left_of(folder))) == json.dumps(next(way_of(folder)))
