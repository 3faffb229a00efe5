"""Fits of recorded runs: what is missing is said and made, recorded one by one, and a report waits for none of it."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.bench import Bench
from tankrig.devices import Frame
from tankrig.light.tank import tank_image
from tankrig.live import refit as refitting
from tankrig.live.preparing import Preparation
from tankrig.live.refit import Unfitted, refit, unfitted
from tankrig.live.results import DoseFit, SeriesFit, SingleScattering, diluted, fits_in, to_fields
from tankrig.pattern.wall import Wall
from tankrig.report import write_report
from tankrig.report.timing import spans_of
from tankrig.run.folder import create_run
from tankrig.run.reading import open_run
from tankrig.run.writer import RunWriter
from tankrig.scene.description import Camera, Medium, Tank
from tankrig.sequence.loading import sequence_from_table, sequence_table
from ui.cli import main
from ui.window import jobs
from ui.window.run_summary import summaries

INK = Medium(0.002, 0.08, 0.6)
BENCH = Bench(Tank(), Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (20, 30), 8.0))
SEQUENCE = {
    "name": "two doses",
    "ink": asdict(INK),
    "patterns": {"sheet": {"kind": "sheet", "y_mm": [-40.0, 40.0], "z_mm": [56.0, 64.0]}},
    "steps": [
        {"do": "series", "total_ul": [100.0, 200.0],
         "steps": [{"do": "capture", "pattern": "dark"}, {"do": "capture", "pattern": "sheet", "frames": 3}]},
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """To its end, and not fitted at all."""
    path, sequence = tmp_path_factory.mktemp("recorded") / "run", sequence_from_table(SEQUENCE, "test")
    patterns = sequence.drawn(BENCH.wall)
    settings = {"name": "two doses", "rig": "a rig", "bench": asdict(BENCH), "sequence": sequence_table(sequence)}
    create_run(path, (20, 30), "uint16", 8, settings, list(patterns.values()))
    rng, step = np.random.default_rng(0), 0
    with RunWriter(path) as writer:
        held = dict.fromkeys(("delivered_ul", "delivered_low_ul", "delivered_high_ul"), 0.0)
        writer.put("session", program="tankrig", devices={"camera": "c"}, **held)
        for dose_ul in (100.0, 200.0):
            scene = BENCH.scene(patterns["sheet"], diluted(INK, 1.0, dose_ul / 1000.0))
            light = 2e6 * sum(tank_image(scene, seed=5, batches=4).orders.values())
            writer.put("dose_done", complete=True, **dict.fromkeys(held, dose_ul))
            step += 1
            for name, count in (("dark", 1), ("sheet", 3)):
                for _ in range(count):
                    pixels = rng.poisson(100.0 + light * (name == "sheet")).astype(np.uint16)
                    writer.put_frame(Frame(pixels, step, step, step, step), step, patterns[name].hash)
                step += 1
        writer.finish(reason="completed", message="")
    return path


@pytest.fixture
def run(recorded: Path, tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it."""
    monkeypatch.setenv("TANKRIG_CACHE", str(cache))
    shutil.copytree(recorded, tmp_path / "run")
    return tmp_path / "run"


def test_a_run_that_ended_too_early_for_its_fits_gets_them_by_one_command(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Doses whose fits came too late were lost, and the report took 26 minutes to make them again."""
    assert unfitted(open_run(run)) == Unfitted((0.1, 0.2), True)
    assert main(["report", str(run), "--quick"]) == 2
    assert "0.1 ml, 0.2 ml and the series are not fitted: tankrig refit" in capsys.readouterr().err
    assert main(["refit", str(run), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["fits"], found["unfitted"], found["failed"]) == (3, "", [])
    for dose in found["doses"]:
        assert dose["fitted"]["sigma_s"] == pytest.approx(0.08 * dose["dose_ml"], rel=0.03)
    again = open_run(run)
    assert not unfitted(again)
    assert again.end is not None, "fits that come after the end do not reopen a run"
    assert [one.ending for one in summaries(run.parent)] == ["completed"]
    assert not [span for span in spans_of(again) if span.kind == "fit"]  # they are no part of the run's time
    lines = len(again.journal)
    assert main(["refit", str(run)]) == 0
    assert "everything is fitted" in capsys.readouterr().out
    assert len(open_run(run).journal) == lines
    page = write_report(run).read_text(encoding="utf-8")
    assert "not fitted" not in page


def without_end(run: Path) -> None:
    """Take away its last line, so that what is recorded next counts as from while it went on."""
    journal = run / "journal.jsonl"
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    assert json.loads(lines[-1])["kind"] == "end"
    journal.write_text("".join(lines[:-1]), encoding="utf-8")


def test_a_rough_fit_from_while_a_run_went_on_is_none_yet(run: Path) -> None:
    """A run that was too busy to its end would keep it; `refit` said that everything is fitted."""
    without_end(run)
    whole = DoseFit(0.1, Medium(0.001, 0.008, 0.5), frames=1000, single=SingleScattering(0.009, 1.0))
    for fit, missing in ((replace(whole, single=None, astray={"floor": (0.02, 0.01)}), (0.1, 0.2)), (whole, (0.2,))):
        with RunWriter(run) as writer:
            writer.put("fit", **to_fields(fit))
        assert unfitted(open_run(run)).doses_ml == missing


def test_a_series_that_shows_another_phase_function_is_gone_on_with(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever has said nothing about phase functions gets his ink's all the same, by the command that is told him."""
    refit(run)
    _, series = fits_in([event.fields for event in open_run(run).fits])
    assert series is not None
    assert not series.doubted
    with RunWriter(run) as writer:
        writer.put("fit", **to_fields(replace(series, doubted=True)))
    missing = unfitted(open_run(run))
    assert missing == Unfitted(phase=True)
    assert missing.sentence(run).startswith("the ink's own phase function is not fitted: tankrig refit")
    asked: list[object] = []

    def fitted(_: object, start: object, **how: object) -> SeriesFit:
        asked.append((start, how["phase"]))
        return series

    monkeypatch.setattr(refitting, "fit_all", fitted)
    assert main(["report", str(run)]) == 0  # which waits for no search of half an hour, and says what is missing
    assert jobs.report(run) == run / "report.html"
    assert refit(run, further=False) == []
    assert asked == []
    assert "own phase function is not fitted" in (run / "report.html").read_text(encoding="utf-8")
    capsys.readouterr()
    assert main(["refit", str(run)]) == 0
    assert asked == [(replace(series, doubted=True), "any")]
    assert not unfitted(open_run(run))


def test_where_all_doses_show_another_phase_function_the_series_is_fitted_with_others_at_once(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An emulsion on a bench of glass had whole models made, and its series fitted by Henyey–Greenstein's phase
    function, for 370 to 640 CPU s before another one was tried."""
    without_end(run)
    single = SingleScattering(0.009, 1.0)
    whole = DoseFit(0.1, Medium(0.001, 0.008, 0.5), (1e-4, 1e-4, 0.01), frames=1000, single=single)
    rough = [replace(whole, dose_ml=dose_ml, first=True, structure=0.015) for dose_ml in (0.1, 0.2)]
    with RunWriter(run) as writer:
        writer.put("fit", **to_fields(rough[0]))
        assert unfitted(open_run(run)).doses_ml == (0.1, 0.2)  # of the other dose nothing is known
        writer.put("fit", **to_fields(rough[1]))
    assert unfitted(open_run(run)) == Unfitted(series=True)
    asked: list[object] = []

    def fitted(_: object, start: object, **how: object) -> SeriesFit:
        asked.append((start, how["phase"]))
        return SeriesFit((0.1, 0.2), Medium(0.01, 0.04, 0.5), Medium(0.0, 0.0, 0.0), sd=(0.001, 0.001, 0.01, 0.0001))

    monkeypatch.setattr(refitting, "fit_all", fitted)
    assert main(["refit", str(run)]) == 0
    assert asked == [(diluted(whole.medium, 0.2, 1.0), "any")]
    assert not unfitted(open_run(run))
    capsys.readouterr()


def test_doses_that_show_another_phase_function_by_first_models_wait_for_no_whole_ones(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the series was fitted with other phase functions, models that nobody wanted any more went on being made."""
    rough = DoseFit(
        0.1, Medium(0.001, 0.008, 0.5), (1e-4, 1e-4, 0.01), frames=3, patterns=("sheet",), structure=0.03, first=True
    )
    ended: list[str] = []

    def made(*_: object) -> Iterator[DoseFit | SeriesFit]:
        try:
            for dose_ml in (0.2, 0.1):
                yield replace(rough, dose_ml=dose_ml)
            ended.append("series")
            yield SeriesFit((0.1, 0.2), rough.medium, rough.medium)
        finally:
            ended.append("models")

    def fitted(*_: object, phase: str, **__: object) -> SeriesFit:
        ended.append(phase)
        return SeriesFit((0.1, 0.2), rough.medium, rough.medium)

    monkeypatch.setattr(refitting, "fit_all_there_is", made)
    monkeypatch.setattr(refitting, "fit_all", fitted)
    refit(run)
    assert ended == ["models", "any"]
    assert refit(run) == []


def test_what_was_fitted_before_an_interruption_is_kept_and_the_next_call_goes_on(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Fits that take eleven minutes must survive a person who has no time now."""

    def interrupted(words: str, _: Preparation) -> None:
        if open_run(run).fits:
            raise KeyboardInterrupt(words)

    with pytest.raises(KeyboardInterrupt):
        refit(run, progress=interrupted)
    (kept,) = open_run(run).fits
    missing = unfitted(open_run(run))
    assert kept["dose_ml"] not in missing.doses_ml
    assert len(missing.doses_ml) == 1
    page = write_report(run).read_text(encoding="utf-8")
    assert missing.sentence(run) in page
    made = refit(run)
    assert [type(one) for one in made] == [DoseFit, SeriesFit]
    assert not unfitted(open_run(run))

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(refitting, "exposures_of", ended)
    assert main(["refit", str(run), "--all"]) == 1
    assert "stopped on request" in capsys.readouterr().err


def test_the_tank_model_can_be_asked_for_and_a_run_that_is_being_recorded_is_left_alone(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words: list[str] = []
    made = refit(run, model="tank", progress=lambda said, _: words.append(said))
    assert [one.model for one in made if isinstance(one, DoseFit)] == ["tank", "tank"]
    assert any("0.2 ml" in one for one in words)
    with RunWriter(run):
        assert main(["refit", str(run), "--all"]) == 2
    assert "another program is recording into it" in capsys.readouterr().err
