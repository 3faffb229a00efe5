"""`tankrig run` and `tankrig recover` on the simulated rig: one line each way, and nothing dosed on bad input."""

import json
import os
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from rich.progress import Progress

import tankrig
from drivers.emulation.truth import read_truth
from drivers.rig import SIMULATED, load_rig_file
from tankrig.run.rig import RigLock
from ui.cli import main

SHORT = """
name = "short"
exposure_ms = 5
[[steps]]
do = "series"
total_ul = [20, 40]
steps = [ { do = "capture", pattern = "dark" }, { do = "capture", pattern = "full", frames = 2 } ]
"""
WIDE = """
name = "wide"
[patterns.sheet]
kind = "sheet"
y_mm = {y_mm}
z_mm = {z_mm}
[[steps]]
do = "repeat"
times = 2
steps = [ {{ do = "capture", pattern = "sheet" }} ]
"""
LONG_DOSE = 'name = "long"\n[[steps]]\ndo = "dose"\ntotal_ul = 900\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder to work in, with the sequences in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    (tmp_path / "short.toml").write_text(SHORT)
    (tmp_path / "long.toml").write_text(LONG_DOSE)
    return tmp_path


def names_in(folder: Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def true_ul(run: Path) -> float:
    """What the simulated doser of a run's own rig has really delivered, once it has stopped."""
    steps = -1
    while steps != (steps := read_truth(Path(f"{run}.rig") / "simulated" / "tank" / "state").steps):
        time.sleep(0.3)
    return steps / 10.0


def test_one_command_runs_a_sequence_on_the_simulated_rig_and_says_so(folder, capsys):
    assert main(["run", "short.toml", "--out", "run", "--json", "--no-fit"]) == 0
    said = capsys.readouterr()
    assert "no rig is configured, so this is the simulated rig" in said.err
    assert json.loads(said.out) == {"run": "run", "reason": "completed", "frames": 6, "delivered_ul": 40.0}
    frames = tankrig.open_run("run").frames
    assert frames.pattern.values.tolist() == ["dark", "full", "full"] * 2
    means = frames.values.mean(axis=(1, 2))
    assert means[[1, 2, 4, 5]].min() > means[[0, 3]].max() + 10
    assert true_ul(folder / "run") == 40.0
    assert main(["recover", "run"]) == 0
    assert "6 frames are as they were recorded" in capsys.readouterr().out
    assert main(["run", "--resume", "run"]) == 2
    assert "has come to its end; there is nothing to resume" in capsys.readouterr().err
    assert main(["run", "short.toml", "--out", "run"]) == 2
    assert "exists already" in capsys.readouterr().err


SMALL = """
[camera.truth]
tolerance = 0.02
mixing_s = 0.1
[camera.truth.bench]
light = "collimated"
tank = { size_mm = [240.0, 160.0, 120.0] }
wall = { shape = [480, 640], y_mm = [-80.0, 80.0], z_mm = [0.0, 120.0] }
camera = { kind = "orthographic", shape = [20, 30], pixel_mm = 8.0 }
"""


def test_a_run_is_fitted_while_it_goes_on_and_ends_with_a_report(folder, capsys, monkeypatch):
    """What a person who starts a run gets: coefficients in the journal, beside the truth in JSON, and a page."""
    rig = SIMULATED.read_text().replace("shape = [80, 120]\npixel_mm = 2.0", "shape = [20, 30]\npixel_mm = 8.0")
    (folder / "rig.toml").write_text(rig + SMALL)
    mix = '{ do = "mix", tolerance = 0.05, every_s = 0.02, at_least_s = 0.4 },'
    (folder / "one.toml").write_text(SHORT.replace("[20, 40]", "[400]").replace("steps = [", f"steps = [ {mix}"))
    monkeypatch.setattr("tankrig.report.write_report", lambda path, *_: path / "report.html")  # has tests of its own
    assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    (dose,) = found["doses"]
    assert (dose["dose_ml"], dose["truth"]["g"]) == (0.4, pytest.approx(0.71, abs=0.01))
    assert dose["fitted"]["sigma_s"] == pytest.approx(dose["truth"]["sigma_s"], rel=0.2)
    run = tankrig.open_run("run")
    assert run.fits[-1]["frames"] == 2
    assert run.end is not None
    assert run.end["reason"] == "completed"
    assert Path(found["report"]) == Path("run", "report.html")


def test_a_dry_run_tells_time_ink_and_disk_and_leaves_nothing(folder, capsys):
    assert main(["run", "short.toml", "--dry-run", "--json"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert (plan["ink_ul"], plan["frames"], plan["disk_bytes"]) == (40.0, 6, 6 * 80 * 120 * 2)
    assert 0.2 < plan["seconds"] < 5.0
    assert main(["run", "short.toml", "--dry-run"]) == 0
    told = capsys.readouterr()
    assert re.search(r"in all: \d s, 40 µl of ink, 6 frames, 0\.1 MB", told.out)
    assert "this is the simulated rig" in told.err
    assert names_in(folder) == ["long.toml", "short.toml"]


def test_light_that_misses_the_tank_is_told_before_anything_moves(folder, capsys):
    """A sheet wider than the tank was cut at its wall without a word, so that nobody knew what had been lit."""
    (folder / "wide.toml").write_text(WIDE.format(y_mm=[-95.0, 60.0], z_mm=[58.0, 62.0]))
    note = 'pattern "sheet": y = -95 … 60 mm reaches beyond the tank\'s wall, -80 … 80 mm; what is beyond is cut off'
    assert main(["run", "wide.toml", "--dry-run", "--json"]) == 0
    told = capsys.readouterr()
    assert json.loads(told.out)["notes"] == [note]
    assert f"note: {note}\n" in told.err
    assert main(["scene", "--pattern", "sheet", "--sequence", "wide.toml", "--out", "scene.toml"]) == 0
    assert f"note: {note}\n" in capsys.readouterr().err
    assert main(["run", "short.toml", "--dry-run"]) == 0
    assert "note" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["run"], "give a sequence file, or --resume"),
        (["run", "short.toml", "--resume", "x"], "give a sequence file, or --resume"),
        (["run", "short.toml", "--resume"], "Option '--resume' requires an argument; see tankrig run --help"),
        (["run", "none.toml"], "none.toml: cannot be read"),
        (["run", "over.toml"], "over.toml: dose to 1200 µl: one dose may have 1000 µl at most"),
        (["run", "odd.toml"], 'steps[0].do = "dance" is unknown'),
        (["run", "high.toml"], "high.toml: patterns.sheet (time 1 of 2, capture sheet): z_mm = [130, 140] lights no"),
        (["run", "fine.toml"], "fine.toml: separate 2 of 5, capture wave-0.1mm-z58-62-0of4: period_mm = 0.1 is finer"),
        (["run", "short.toml", "--rig", "none.toml"], "none.toml: cannot be read"),
        (["run", "short.toml", "--out", "short.toml/run"], "short.toml is not a folder"),
        (["run", "--resume", "empty"], "empty: is not a run"),
        (["run", "--resume", "nowhere"], "nowhere: does not exist"),
        (["run", "--resume", "newer"], "update tankrig"),
        (["recover", "empty"], "empty: is not a run"),
    ],
)
def test_bad_input_is_one_sentence_exit_2_and_nothing_is_made(folder, capsys, words, reason):
    (folder / "over.toml").write_text('name = "over"\n[[steps]]\ndo = "dose"\ntotal_ul = 1200\n')
    (folder / "odd.toml").write_text('name = "odd"\n[[steps]]\ndo = "dance"\n')
    (folder / "high.toml").write_text(WIDE.format(y_mm=[-60.0, 60.0], z_mm=[130.0, 140.0]))
    (folder / "fine.toml").write_text(
        'name = "a fine name"\n[[steps]]\ndo = "separate"\nz_mm = [58.0, 62.0]\nperiods_mm = [0.1]\n'
    )
    (folder / "empty").mkdir()
    (folder / "newer").mkdir()
    newer = {"attributes": {"tankrig": {"format": 9, "version": "9.0", "settings": {}}}}
    (folder / "newer" / "zarr.json").write_text(json.dumps(newer))
    before = names_in(folder)
    assert main(words) == 2
    said = capsys.readouterr()
    assert reason in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
    assert names_in(folder) == before


def test_a_second_program_on_the_same_rig_is_refused(folder, capsys):
    (folder / "rig.toml").write_text(SIMULATED.read_text())
    lock = RigLock(load_rig_file("rig.toml").lock, "simulated rig")
    assert main(["run", "short.toml", "--rig", "rig.toml", "--out", "run"]) == 2
    assert "rig simulated rig is in use by another program" in capsys.readouterr().err
    assert not (folder / "run").exists()
    lock.close()


def once_in_a_dose(journal: Path, then: Callable[[], object]) -> None:
    """Do something in the middle of a run's dose."""

    def wait_and_do():
        while not journal.exists() or b"dose_intent" not in journal.read_bytes():
            time.sleep(0.01)
        time.sleep(0.3)
        then()

    threading.Thread(target=wait_and_do, daemon=True).start()


def test_ctrl_c_stops_the_dose_and_the_resumed_run_doses_the_rest(folder, capsys):
    once_in_a_dose(folder / "run" / "journal.jsonl", lambda: os.kill(os.getpid(), signal.SIGINT))
    assert main(["run", "long.toml", "--out", "run", "--no-fit"]) == 1
    said = capsys.readouterr()
    assert "aborted: run" in said.out
    assert "resume with: tankrig run --resume run" in said.out
    assert 0.0 < true_ul(folder / "run") < 900.0
    assert main(["run", "--resume", "run", "--no-fit"]) == 0
    assert true_ul(folder / "run") == 900.0


RUN = "import sys; from ui.cli import main; sys.exit(main())"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_request_to_end_stops_the_dose_and_the_run_has_an_end(folder, capsys, number):
    """A terminal that is closed in a dose must not leave ink flowing, or a dose that a person has to settle."""
    once_in_a_dose(folder / "run" / "journal.jsonl", lambda: os.kill(os.getpid(), number))
    assert main(["run", "long.toml", "--out", "run", "--no-fit"]) == 1
    assert "aborted: run" in capsys.readouterr().out
    run = tankrig.open_run("run")
    assert run.end["reason"] == "aborted"
    (done,) = run.events("dose_done")
    assert done["delivered_ul"] == pytest.approx(true_ul(folder / "run"), abs=0.1)
    assert done["delivered_ul"] < 900.0


def test_a_program_that_is_asked_to_end_in_a_dose_says_so_with_its_exit_status(folder):
    """What a shell, or a terminal that is closed, sees of it; and it begins without what only fits need."""
    telling = "import sys; from ui.cli import main; status = main(); print(*sys.modules); sys.exit(status)"
    command = [sys.executable, "-c", telling, "run", "long.toml", "--out", "run", "--no-fit"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        once_in_a_dose(folder / "run" / "journal.jsonl", lambda: program.send_signal(signal.SIGHUP))
        out, err = program.communicate(timeout=60)
    assert program.returncode == 1, err
    assert "aborted: run" in out
    assert {"numba", "scipy"}.isdisjoint(out.split())
    assert true_ul(folder / "run") < 900.0


@pytest.mark.parametrize("error", [RuntimeError("a bug"), KeyboardInterrupt()])
def test_an_error_in_the_display_ends_the_run_and_is_told(folder, capsys, monkeypatch, error):
    """Whatever goes wrong on the screen: nobody sees the run any more, so it must not go on dosing."""
    real, calls = Progress.update, []

    def update(self, *given, **named):
        calls.append(1)
        if "dose" in named.get("description", "") and len(calls) > 5:
            raise error
        return real(self, *given, **named)

    monkeypatch.setattr(Progress, "update", update)
    assert main(["run", "long.toml", "--out", "run", "--no-fit"]) == 1
    err = capsys.readouterr().err
    assert "the display failed, so the run was ended; resume with: tankrig run --resume run" in err
    assert "Traceback" not in err
    run = tankrig.open_run("run")
    assert run.end["reason"] == "aborted"
    assert run.events("dose_done")[-1]["delivered_ul"] == pytest.approx(true_ul(folder / "run"), abs=0.1)
    assert true_ul(folder / "run") < 900.0


LABELS = ["cable moved to [/dev/ttyACM0]", "[/]", "[bold", "[red]stirred[/blue]", "\\[", "{task.description}", "a\nb"]


def test_peoples_words_are_drawn_as_they_stand(folder, capsys, monkeypatch):
    """A note with brackets in it used to end the display in the middle of a run. Exposures outlast its redrawing."""
    words = [json.dumps(label) for label in LABELS]
    names = [word for word, label in zip(words, LABELS, strict=True) if label.isprintable()]  # others name no pattern
    patterns = "".join(f'[patterns.{name}]\nkind = "full"\n' for name in names)
    steps = "".join(f'[[steps]]\ndo = "note"\ntext = {word}\n' for word in words)
    steps += "".join(f'[[steps]]\ndo = "capture"\npattern = {name}\n' for name in names)
    (folder / "notes.toml").write_text(f"name = {words[0]}\nexposure_ms = 500\n{patterns}{steps}")
    assert main(["run", "notes.toml", "--dry-run", "--out", "run"]) == 0
    assert LABELS[0] in capsys.readouterr().out
    terminal, end = os.openpty()
    termios.tcsetwinsize(end, (40, 160))
    drawn: list[bytes] = []

    def watch() -> None:
        with suppress(OSError):  # the other end is closed
            while seen := os.read(terminal, 65536):
                drawn.append(seen)

    (watcher := threading.Thread(target=watch)).start()
    monkeypatch.setenv("TERM", "xterm")
    with open(end, "w", closefd=False) as screen, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", screen)
        status = main(["run", "notes.toml", "--out", "run", "--no-fit"])
    os.close(end)
    watcher.join(10)
    os.close(terminal)
    seen = b"".join(drawn).decode(errors="replace")
    assert status == 0, seen
    assert LABELS[0] in seen
    assert "[red]stirred[/blue]" in seen
    assert [note["text"] for note in tankrig.open_run("run").events("note") if note["text"] in LABELS] == LABELS


@pytest.mark.usefixtures("folder")
def test_a_fit_that_cannot_begin_ends_the_run_and_its_journal_says_why(capsys, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tankrig.live.attached.LiveFit", full)
    assert main(["run", "short.toml", "--out", "run"]) == 1
    assert "No space left" in capsys.readouterr().err
    assert "No space left" in tankrig.open_run("run").end["message"]
    assert main(["run", "--resume", "run", "--no-fit"]) == 0


@pytest.mark.usefixtures("folder")
def test_a_run_that_lights_nothing_starts_no_process_for_fits(monkeypatch):
    def begun(*_: object) -> None:
        raise AssertionError("nothing could be fitted")

    monkeypatch.setattr("tankrig.live.attached.LiveFit", begun)
    Path("dark.toml").write_text('name = "dark"\nexposure_ms = 1\n[[steps]]\ndo = "capture"\npattern = "dark"\n')
    assert main(["run", "dark.toml", "--out", "run"]) == 0
    assert tankrig.open_run("run").end["reason"] == "completed"


@pytest.mark.usefixtures("folder")
def test_a_camera_that_clamps_is_told_to_the_person(capsys, monkeypatch):
    from drivers.simulated.camera import SimulatedCamera
    from tankrig.devices import CameraSettings

    real = SimulatedCamera.configure
    monkeypatch.setattr(SimulatedCamera, "configure", lambda self, asked: real(self, CameraSettings(2.0, asked.gain)))
    assert main(["run", "short.toml", "--out", "run", "--no-fit"]) == 0
    said = capsys.readouterr().err
    assert said.count("was asked for 5 ms at gain 1 and has set 2 ms at gain 1") == 1
    assert set(tankrig.open_run("run").frames.exposure_ms.values.tolist()) == {2.0}


def interrupt_once_it_says(journal: Path, words: bytes) -> None:
    """Ctrl-C, as soon as the journal has these words."""

    def interrupt():
        while not journal.exists() or words not in journal.read_bytes():
            time.sleep(0.01)
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()


def test_a_run_whose_tank_is_not_what_its_journal_knows_needs_a_persons_word(folder, capsys):
    """Without its ledger it would dose 40 µl on top of the 20 that are there, and call that 40."""
    (folder / "two.toml").write_text(
        'name = "two"\n[[steps]]\ndo = "dose"\ntotal_ul = 20\n[[steps]]\ndo = "wait"\nseconds = 3\n'
        '[[steps]]\ndo = "dose"\ntotal_ul = 40\n'
    )
    interrupt_once_it_says(folder / "run" / "journal.jsonl", b"dose_done")
    assert main(["run", "two.toml", "--out", "run", "--no-fit"]) == 1
    (ledger,) = folder.rglob("tank.ledger")
    ledger.unlink()
    capsys.readouterr()
    assert main(["run", "--resume", "run", "--no-fit"]) == 3
    said = capsys.readouterr().err
    assert "the run's journal says that the tank holds 20 µl" in said
    assert "the tank holds between 0 and 20 µl: say how much it is in all (--delivered-ul)" in said
    assert main(["run", "--resume", "run", "--no-fit", "--delivered-ul", "25"]) == 3
    assert "the tank cannot hold 25 µl; it is between 0 and 20 µl" in capsys.readouterr().err
    assert true_ul(folder / "run") == 20.0, "nothing moved before the answer"
    assert main(["run", "--resume", "run", "--no-fit", "--delivered-ul", "20"]) == 0
    assert true_ul(folder / "run") == 40.0


def test_a_killed_dose_needs_a_persons_word(folder, capsys):
    program = subprocess.Popen(
        [
            sys.executable,
            "-c",
            RUN,
            "run",
            "long.toml",
            "--out",
            "run",
            "--no-fit",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    journal = folder / "run" / "journal.jsonl"
    while not journal.exists() or b"dose_intent" not in journal.read_bytes():
        assert program.poll() is None
        time.sleep(0.01)
    time.sleep(0.4)
    program.kill()
    program.wait()
    delivered_ul = true_ul(folder / "run")
    assert 0.0 < delivered_ul < 900.0
    assert main(["recover", "run"]) == 0
    assert "a dose to 900 µl was begun and not seen to end" in capsys.readouterr().out
    assert main(["run", "--resume", "run"]) == 3
    said = capsys.readouterr()
    assert "say how much it is in all (--delivered-ul)" in said.err
    assert said.err.count("\n") == 1
    assert main(["run", "--resume", "run", "--delivered-ul", f"{delivered_ul:g}", "--no-fit"]) == 0
    assert true_ul(folder / "run") == 900.0
