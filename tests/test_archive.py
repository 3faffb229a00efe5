"""An archive as a table, as files, as a page and as one dataset."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.simulated.archive import FRAMES, make_archive, media
from tankrig.archive.dataset import open_archive
from tankrig.archive.page import calibration_changes
from tankrig.archive.results import Results, made_now
from tankrig.archive.table import Filter, compared, disagreement, table_of
from tankrig.errors import StoreError
from tankrig.live.results import DoseFit, to_fields
from tankrig.run.folder import create_run
from tankrig.run.reading import open_run
from tankrig.run.writer import RunWriter
from tankrig.scene import Medium
from ui.cli import main

SD = (1e-6, 2e-5, 1e-3)


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """Runs with the fits that somebody made of them once: what is true, and in one run something else."""
    folder = tmp_path / "archive"
    for twin in make_archive(folder, 2, 3, tolerance=0.05):
        found = twin.truth if twin.name != "twin-01-002" else replace(twin.truth, g=twin.truth.g + 0.01)
        known = dict.fromkeys(("sigma_a", "sigma_s", "g"), True)
        with RunWriter(folder / twin.name) as writer:
            writer.put("fit", **to_fields(DoseFit(1.0, found, SD, known, gain=2.0, frames=FRAMES, patterns=("rays",))))
    return folder


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A refit that found what is true, but for a run that could not be read."""
    out = Results(tmp_path / "results")
    for number, truth in enumerate(media(2)):
        for seed in range(3):
            name = f"twin-{number:02d}-{seed:03d}"
            with out.claimed(name):
                fit = to_fields(DoseFit(1.0, truth, SD, gain=2.0, frames=FRAMES))
                out.put(name, "key", {"format": 1, "run": name, "fits": [fit], "made": made_now()})
    return out.folder


def test_the_table_has_a_row_for_each_fit_and_filters_leave_what_was_asked_for(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def asked(*words: str) -> list[dict[str, Any]]:
        assert main(["archive", str(archive), "--json", *words]) == 0
        rows: list[dict[str, Any]] = json.loads(capsys.readouterr().out)
        return rows

    rows = asked()
    assert len(rows) == 6
    assert [one["utc"] for one in rows] == sorted(one["utc"] for one in rows)
    assert {one["run"] for one in asked("--material", "ink 00")} == {f"twin-00-00{seed}" for seed in range(3)}
    assert {one["rig"] for one in asked("--rig", "*B")} == {"bench B"}
    day = rows[3]["utc"][:10]
    assert {one["run"] for one in asked("--since", day)} == {one["run"] for one in rows if one["utc"][:10] >= day}
    assert {one["run"] for one in asked("--until", day)} == {one["run"] for one in rows if one["utc"][:10] <= day}
    wrong = next(one for one in rows if one["run"] == "twin-01-002")
    found = asked("--between", "g", str(wrong["g"] - 1e-9), str(wrong["g"] + 1e-9))
    assert [one["run"] for one in found] == ["twin-01-002"]
    assert len(asked("--verdict", "determined")) == 6
    assert main(["archive", str(archive), "--between", "colour", "0", "1"]) == 2
    assert "there is no column colour" in capsys.readouterr().err
    assert main(["archive", str(archive), "--between", "g", "nan", "1"]) == 2
    assert "the range nan … 1 of g has an end that is no number" in capsys.readouterr().err
    assert asked("--between", "g", "-inf", "inf") == [one for one in rows if one["fit"]]
    for option, date in (
        ("--since", "yesterday"),
        ("--since", "2026-13-77"),
        ("--until", "foo"),
        ("--until", "20260301"),
    ):
        assert main(["archive", str(archive), option, date]) == 2
        assert f"{date} is no date; give one such as" in capsys.readouterr().err
    assert len(asked("--since", day[:4])) == 6


def test_what_was_not_determined_is_marked(archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A number that a fit could not know stood in the table as if it were one."""
    fit = DoseFit(2.0, Medium(1e-4, 0.02, 0.6), SD, {"sigma_a": False, "sigma_s": True, "g": True}, gain=2.0)
    with RunWriter(archive / "twin-00-000") as writer:
        writer.put("fit", **to_fields(fit))
    assert main(["archive", str(archive)]) == 0
    told = capsys.readouterr().out
    assert "0.0001000±0.0000010?" in told
    assert told.count("?") == 2  # and what it means
    assert main(["archive", str(archive), "--by", "material"]) == 0
    assert "0.0001000±0.0000010?" in capsys.readouterr().out
    assert main(["archive", str(archive), "--out", str(tmp_path / "page.html")]) == 0
    assert "?</td>" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_run_of_whose_journal_nothing_is_left_is_a_row_that_says_so(
    archive: Path, results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It stood in the table as a run that merely had no fit."""
    with (archive / "twin-00-000" / "journal.jsonl").open("r+b") as journal:
        journal.truncate(200)
    (row,) = [one for one in table_of(archive) if one["failed"]]
    assert row["run"] == "twin-00-000"
    assert "twin-00-000: its journal has not one whole line" in row["failed"]
    assert not any(one["failed"] for one in table_of(archive, results)), "what was found of it before still counts"
    assert main(["archive", str(archive), "--failed"]) == 0
    told = capsys.readouterr().out
    assert "its journal has not one whole line" in told
    assert told.splitlines()[-1] == "1 run, 0 fits, 1 failed"


def test_a_column_that_says_nothing_takes_no_room(
    archive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "96")
    assert main(["archive", str(archive), "--rig", "*A"]) == 0
    heading, *lines, meaning, count = capsys.readouterr().out.splitlines()
    assert "standard deviation" in meaning
    assert heading.split() == ["run", "day", "rig", "material", "ml", "σs,", "1/mm", "g", "σa,", "1/mm"]
    assert all("ink 0" in line and "±" in line for line in lines)
    assert count == f"{len(lines)} runs, {len(lines)} fits"


def test_what_a_refit_finds_stands_beside_what_was_found_before(archive: Path, results: Path) -> None:
    rows = table_of(archive, results)
    (far,) = [one for one in rows if Filter(disagreeing=True)(one)]
    assert far["run"] == "twin-01-002"
    assert far["disagreement"] == pytest.approx(10.0)
    assert far["old_g"] - far["g"] == pytest.approx(0.01)
    assert {one["disagreement"] for one in rows if one is not far} == {0.0}


def test_results_that_keep_a_dose_twice_count_its_last_fit(archive: Path, tmp_path: Path) -> None:
    """As refits once kept them: without single scattering, and with it."""
    out = Results(tmp_path / "results")
    first = DoseFit(1.0, Medium(1e-4, 0.02, 0.6), SD, gain=2.0, frames=FRAMES)
    fits = [to_fields(one) for one in (first, replace(first, dose_ml=2.0), replace(first, gain=3.0))]
    with out.claimed("twin-00-000"):
        out.put("twin-00-000", "key", {"format": 1, "run": "twin-00-000", "fits": fits, "made": made_now()})
    rows = [one for one in table_of(archive, out.folder) if one["run"] == "twin-00-000"]
    assert sorted((one["dose_ml"], one["gain"]) for one in rows) == [(1.0, 3.0), (2.0, 2.0)]


def test_two_fits_are_as_far_apart_as_their_worst_coefficient() -> None:
    one = DoseFit(1.0, Medium(1e-4, 0.01, 0.7), (1e-6, 1e-5, 1e-3))
    other = DoseFit(1.0, Medium(1e-4, 0.01, 0.704), (1e-6, 1e-5, 2e-3))
    assert disagreement(one, other) == disagreement(other, one) == pytest.approx(2.0)
    assert disagreement(one, replace(other, sd=())) == pytest.approx(4.0)
    assert disagreement(replace(one, sd=()), replace(other, sd=())) is None


def test_groups_are_compared_by_mean_scatter_and_stated_error(archive: Path) -> None:
    rows = table_of(archive)
    groups = {one["material"]: one for one in compared(rows, "material")}
    for number, truth in enumerate(media(2)):
        group = groups[f"ink {number:02d}"]
        values = [one["g"] for one in rows if one["material"] == f"ink {number:02d}"]
        assert group["fits"] == 3
        assert group["sigma_s"] == pytest.approx(truth.sigma_s)
        assert group["g"] == pytest.approx(np.mean(values))
        assert group["scatter_g"] == pytest.approx(np.std(values, ddof=1), abs=1e-12)
        assert group["sd_g"] == SD[2]


def read_csv(file: Path) -> list[dict[str, Any]]:
    with file.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def read_parquet(file: Path) -> list[dict[str, Any]]:
    import pyarrow.parquet

    rows: list[dict[str, Any]] = pyarrow.parquet.read_table(file).to_pylist()
    return rows


@pytest.mark.parametrize(("name", "read"), [("table.csv", read_csv), ("table.parquet", read_parquet)])
def test_other_programs_read_the_table(
    name: str, read: Callable[[Path], list[dict[str, Any]]], archive: Path, tmp_path: Path
) -> None:
    assert main(["archive", str(archive), "--out", str(tmp_path / name)]) == 0
    written, rows = read(tmp_path / name), table_of(archive)
    assert [one["run"] for one in written] == [one["run"] for one in rows]
    assert [float(one["sigma_s"]) for one in written] == [one["sigma_s"] for one in rows]


def test_the_page_shows_what_disagrees_and_what_failed(archive: Path, results: Path, tmp_path: Path) -> None:
    (archive / "twin-00-000" / "zarr.json").write_text("{")
    page = tmp_path / "archive.html"
    assert main(["archive", str(archive), "--results", str(results), "--out", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    assert text.count("data:image/png") == 4
    assert "http" not in text.replace("http-equiv", ""), "a page that needs nothing but itself"
    after = text[text.index("New fits beside old ones") :]
    assert "twin-01-002" in after[: after.index("Materials")]
    assert "twin-00-000" in after[after.index("could not be read") :]


def test_a_calibration_that_came_into_force_is_told_once(archive: Path) -> None:
    rows = table_of(archive)
    of_rig = [one["run"] for one in rows if one["rig"] == "bench A"]
    for number, name in enumerate(of_rig):
        file = archive / name / "zarr.json"
        group = json.loads(file.read_text())
        group["attributes"]["tankrig"]["settings"]["calibrations"] = {"radiometry": "old" if number < 2 else "new"}
        file.write_text(json.dumps(group))
    (change,) = calibration_changes(archive, rows)
    assert change[1:] == ("bench A", "radiometry")
    assert change[0] == next(one["utc"] for one in rows if one["run"] == of_rig[2])


def test_all_frames_open_as_one_dataset_and_are_read_when_they_are_used(archive: Path) -> None:
    found = open_archive(archive)
    assert found.frames.shape == (6 * (FRAMES + 1), 40, 60)
    run = open_run(archive / "twin-01-001")
    mine = found.frames[(found.run == "twin-01-001").values]
    np.testing.assert_array_equal(mine.values, run.frames.values)
    np.testing.assert_array_equal(mine[2:4, 3:5, 7].values, run.frames.values[2:4, 3:5, 7])
    np.testing.assert_array_equal(mine[2, 3:5].values, run.frames.values[2, 3:5])
    for name in ("pattern", "delivered_ul", "exposure_ms", "utc"):
        np.testing.assert_array_equal(mine[name].values, run.frames[name].values)
    (archive / "twin-00-000" / "frames" / "c.1.0.0").unlink()
    lazily = open_archive(archive)
    with pytest.raises(StoreError, match="frame 1 is missing"):
        lazily.frames[(lazily.run == "twin-00-000").values].values.sum()
    create_run(archive / "zz-empty", (40, 60), "uint16", 1, {"name": "empty"})
    assert "zz-empty: has no frames" in open_archive(archive).attrs["left_out"]
    create_run(archive / "another-camera", (4, 6), "uint16", 1, {"name": "other"})
    assert open_archive(archive).sizes["frame"] == 30, "runs without frames have no say"
