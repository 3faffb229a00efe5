"""The report: one file that needs nothing else, with the run's own numbers in it."""

import json
import re
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from drivers.rig import SIMULATED, load_rig_file
from tankrig.bench import Bench
from tankrig.devices import Frame
from tankrig.light.single import single_scattering
from tankrig.live.exposures import exposures_of
from tankrig.live.results import DoseFit, from_fields, to_fields
from tankrig.pattern.wall import Wall
from tankrig.report import write_report
from tankrig.report.pictures import observations, predicted
from tankrig.run.folder import create_run
from tankrig.run.reading import open_run
from tankrig.run.start import is_of
from tankrig.run.writer import RunWriter
from tankrig.scene.description import Camera, Medium, Tank
from tankrig.sequence.loading import sequence_from_table
from ui.cli import main
from ui.cli.fits import fits_of, tell_fits

from .seen_pictures import report_shows

BENCH = {
    "tank": {"size_mm": [240.0, 160.0, 120.0]},
    "wall": {"shape": [30, 40], "y_mm": [-80.0, 80.0], "z_mm": [0.0, 120.0]},
    "light": "collimated",
    "camera": {"kind": "orthographic", "shape": [20, 30], "pixel_mm": 8.0},
}
SEQUENCE = {
    "name": "two <doses>",
    "patterns": {"sheet": {"kind": "sheet", "y_mm": [-40.0, 40.0], "z_mm": [56.0, 64.0]}},
    "steps": [
        {"do": "series", "total_ul": [100.0, 200.0],
         "steps": [{"do": "capture", "pattern": "dark"}, {"do": "capture", "pattern": "sheet", "frames": 2}]},
    ],
}  # fmt: skip
INK = Medium(0.002, 0.08, 0.6)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two doses and their fits, as a run records them."""
    path = tmp_path_factory.mktemp("report") / "run"
    bench = Bench(
        Tank(), Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (20, 30), 8.0)
    )  # fmt: skip
    patterns = sequence_from_table(SEQUENCE, "test").drawn(bench.wall)
    full = {"tank": {"size_mm": [240.0, 160.0, 120.0], "surface": "matched", "refractive_index": 1.33},
            "wall": {**BENCH["wall"], "irradiance": 1.0, "gamma": 1.0}, "light": "collimated",
            "camera": {**BENCH["camera"], "position_mm": None}, "light_position_mm": None}  # fmt: skip
    settings = {"name": SEQUENCE["name"], "rig": "test rig", "bench": full, "sequence": SEQUENCE}
    create_run(path, (20, 30), "uint16", 6, settings, list(patterns.values()))
    rng = np.random.default_rng(0)
    fits = []
    with RunWriter(path) as writer:
        writer.put("session", program="tankrig", devices={"camera": "c"}, delivered_ul=0.0, delivered_low_ul=0.0,
                   delivered_high_ul=0.0)  # fmt: skip
        step = 0
        for dose_ml in (0.1, 0.2):
            medium = Medium(INK.sigma_a * dose_ml, INK.sigma_s * dose_ml, INK.g)
            light = 5e5 * single_scattering(bench.scene(patterns["sheet"], medium))
            writer.put("step", step=step, state="begun", label=f"dose to {1000 * dose_ml:g} µl")
            writer.put("dose_done", delivered_ul=1000 * dose_ml, delivered_low_ul=1000 * dose_ml,
                       delivered_high_ul=1000 * dose_ml, complete=True)  # fmt: skip
            writer.put("step", step=step, state="done")
            step += 1
            for name, count in (("dark", 1), ("sheet", 2)):
                for _ in range(count):
                    pixels = rng.poisson(100.0 + (light * (name == "sheet"))).astype(np.uint16)
                    writer.put_frame(Frame(pixels, step, step, step, step), step, patterns[name].hash)
                step += 1
            values = {"sigma_a": medium.sigma_a, "sigma_s": medium.sigma_s, "g": medium.g}
            fits.append({"fit": "dose", "dose_ml": dose_ml, **values, "sd": [1e-5, 1e-4, 0.01],
                         "identifiable": dict.fromkeys(values, True), "gain": 2.5e4, "rmse": 1.0, "frames": 2,
                         "single": {"sigma_t": 0.5 * medium.sigma_t + 5e-5, "rmse": 3.0},
                         "seconds": 2.0, **({"astray": {"floor": [0.3, 0.01]}} if dose_ml == 0.1 else {})})  # fmt: skip
        fits.append({"fit": "series", "doses_ml": [0.1, 0.2], "ink": {"sigma_a": 0.002, "sigma_s": 0.08, "g": 0.6},
                     "water_sigma_a": 1e-4, "sd": [1e-5, 1e-4, 0.01, 1e-5], "linearity": None, "rmse": [1.0, 2.0],
                     "verdict": "All is determined.", "seconds": 5.0})  # fmt: skip
        for fit in fits:
            writer.put("fit", **fit)
        writer.put("gap", step=2, missing=3, after=7)
        writer.finish(reason="completed", message="")
    return path


@pytest.fixture(scope="module")
def page(run: Path) -> str:
    return write_report(run, run / "elsewhere").read_text(encoding="utf-8")


def test_the_page_holds_all_it_shows(page: str) -> None:
    """A report that loads anything from elsewhere is empty on another machine, or in ten years."""
    assert re.findall(r"(?:src|href)=\"(?!data:)", page) == []
    assert "url(" not in page
    assert page.count("data:image/png;base64,") == 3
    assert page.count("data:image/svg+xml;base64,") == 2
    assert "two &lt;doses&gt;" in page


def test_the_page_says_what_the_run_found(page: str) -> None:
    """The numbers are those of the run's own fits, single scattering's error beside them."""
    assert "<b>0.08000</b><i>± 0.00010</i>" in page
    assert "All is determined." in page
    assert page.count("-50 %") == 2
    assert "3.0 ×" in page
    assert "3 frames were lost by the camera" in page
    assert "dose to 200 µl" in page
    assert "test rig" in page


def test_a_dose_is_rebuilt_with_what_was_fitted_along(run: Path, page: str) -> None:
    """A floor of 3 % was left out of the pictures: all of the water looked brighter than the model, and nothing was."""
    photograph = exposures_of(open_run(run)).photographs()[0]
    dark = DoseFit(0.1, Medium(2e-4, 0.008, 0.6))
    light = from_fields(to_fields(replace(dark, astray={"floor": (0.3, 0.01)})))
    assert isinstance(light, DoseFit)
    assert light.astray == {"floor": (0.3, 0.01)}
    assert "astray" not in to_fields(dark)
    brighter = predicted(photograph, light).image / predicted(photograph, dark).image
    assert np.quantile(brighter, 0.05) > 1.02
    assert "0.1 ml: floor 0.300 ± 0.010." in page


def test_the_page_shows_the_photographs(page: str, run: Path) -> None:
    """Each dose's, beside the numbers that were found by it."""
    report_shows(page, run)


def test_each_photograph_says_which_colours_it_is_shown_in(run: Path, page: str) -> None:
    """Columns were titled "sheet sheet", and nothing said which was grey."""
    shown = observations(exposures_of(open_run(run)).photographs())
    assert [axes.get_title() for axes in shown.axes[:2]] == ["sheet, grey", "sheet, false colour"]
    assert "at the left in grey, at its right in false colour" in page


def test_what_is_no_run_or_shows_nothing_is_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence and exit status 2, never half a page."""
    assert main(["report", str(tmp_path)]) == 2
    assert "is not a run" in capsys.readouterr().err
    table = {**SEQUENCE, "steps": [{"do": "note", "text": "nothing"}]}
    settings = {"name": "empty", "bench": BENCH, "sequence": table}
    create_run(tmp_path / "empty", (20, 30), "uint16", 1, settings)
    assert main(["report", str(tmp_path / "empty"), "--json"]) == 2
    assert "no photograph" in capsys.readouterr().err
    assert list(tmp_path.rglob("*.html")) == []


def test_the_table_of_fits_says_of_single_scattering_what_the_report_does(
    run: Path, page: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was compared with the truth where that was known, so run, refit and report told three numbers."""
    monkeypatch.setenv("COLUMNS", "60")
    for description in (load_rig_file(SIMULATED), None):
        tell_fits(fits_of(run, description))
        told = capsys.readouterr().out
        assert told.count("-50 %") == page.count("-50 %") == 2
        assert "…" not in told
        assert "had single scattering alone explained the photographs" in told


def test_a_table_of_fits_has_the_unit_of_all_else_and_the_truth_beneath(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Coefficients stood there in 1/m, between sentences and beside a report that have them in 1/mm."""
    monkeypatch.setenv("COLUMNS", "80")
    found = fits_of(run, load_rig_file(SIMULATED))
    tell_fits(found)
    heading, *lines = capsys.readouterr().out.splitlines()[1:]
    assert heading.split() == ["ink", "σs,", "1/mm", "g", "σa,", "1/mm", "scatt.", "σt"]
    for row in found["doses"]:
        at = next(number for number, line in enumerate(lines) if line.startswith(f"{row['dose_ml']:.3g} ml"))
        assert float(lines[at].split()[2].partition("±")[0]) == pytest.approx(row["fitted"]["sigma_s"], rel=1e-3)
        assert lines[at + 1].split()[:2] == ["truth", f"{row['truth']['sigma_s']:.4g}"]


def test_the_command_says_where_the_report_is(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A script reads the path from the command's one line of JSON."""
    monkeypatch.setattr("tankrig.report.report.report_page", lambda *_: "<p>drawn elsewhere</p>")
    assert main(["report", str(run), "--json", "--out", str(run / "r.html")]) == 0
    assert json.loads(capsys.readouterr().out)["report"] == str(run / "r.html")
    assert (run / "r.html").read_text(encoding="utf-8") == "<p>drawn elsewhere</p>"


def test_a_run_is_compared_with_a_reference_liquid(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its own σs per ml, 0.08/mm, is five times that of Intralipid in 4.6 l: nobody must read that it passed."""
    command = ["validate", str(run), "--material", "intralipid-20", "--wavelength", "633", "--quick", "--json"]
    assert main([*command, "--polarisation", "0", "--out", str(tmp_path)]) == 0
    found = json.loads(capsys.readouterr().out)
    row = found["rows"]["σs per ml"]
    assert (row["found"], row["found_sd"]) == pytest.approx((0.08, 1e-4))
    assert row["reference"] == pytest.approx(74.66 / 4608.0, rel=1e-3)
    assert row["says"] == "disagrees"
    assert found["passed"] is False
    page = (tmp_path / "validation.html").read_text(encoding="utf-8")
    assert "<h2>Not passed</h2>" in page
    assert re.search(r"0\.0800+ ± 0\.0001", page)
    assert "Michels, Foschum and Kienle 2008" in page
    assert page.count("data:image") == 2
    assert not re.search(r'(src|href)="http', page)
    # With the stock diluted as much as that, the same run agrees; but two doses test no proportion.
    other = [*command, "--tank-ml", str(74.66 / 0.08), "--polarisation", "0", "--out", str(tmp_path)]
    assert main(other) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rows"]["σs per ml"]["says"] == "agrees"
    assert found["passed"] is False
    assert "three doses" in found["verdict"]


def test_validate_takes_from_the_run_what_it_says_of_its_light(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whoever leaves out the wavelength or the polarisation gets the run's own, or is told that nobody said it."""
    command = ["--material", "intralipid-20", "--quick", "--out", str(tmp_path)]
    assert main(["validate", str(run), *command]) == 2
    assert "give --wavelength" in capsys.readouterr().err
    settings = {"name": "lit", "bench": BENCH, "sequence": {**SEQUENCE, "wavelength_nm": 633.0}}
    create_run(tmp_path / "lit", (20, 30), "uint16", 1, settings)
    assert main(["validate", str(tmp_path / "lit"), *command]) == 2
    assert "its series is not fitted" in capsys.readouterr().err
    assert main(["validate", str(run), *command, "--wavelength", "633"]) == 0
    told = capsys.readouterr()
    assert "nobody said how polarised the light is" in told.err
    assert re.search(r"σs per ml .*0\.0800\d* ± 0\.0001\d* ", told.out)
    assert main(["validate", str(run), *command, "--wavelength", "633", "--polarisation", "0"]) == 0
    assert capsys.readouterr().err == ""


def test_simulated_light_is_said_to_be_unpolarised() -> None:
    """A demo of beads passed by itself, and failed once tankrig validate was asked about its run."""
    for file in (SIMULATED, SIMULATED.with_name("bench.toml")):
        assert load_rig_file(file).bench.polarisation == 0.0


def test_a_run_goes_on_though_polarisation_was_measured_meanwhile() -> None:
    """Runs of earlier versions have none in their settings, and would be of another bench."""
    bench = load_rig_file(SIMULATED).bench
    stored = {**asdict(bench), "polarisation": None}
    assert is_of(bench, json.loads(json.dumps(stored)))
    assert not is_of(replace(bench, light="pinhole", light_position_mm=(-400.0, 0.0, 60.0)), stored)


def test_a_runs_liquid_is_exported_by_dose(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The wrong dose's coefficients would be twice or half as large."""
    file = tmp_path / "liquid.json"
    assert main(["export-medium", str(run), "--to", "mcx", "--dose-ml", "0.1", "--out", str(file)]) == 0
    assert json.loads(file.read_text())["Domain"]["Media"][1]["mus"] == pytest.approx(0.008)
    assert main(["export-medium", str(run), "--to", "mcx", "--out", str(file)]) == 0
    assert json.loads(file.read_text())["Domain"]["Media"][1]["mus"] == pytest.approx(0.016)
    capsys.readouterr()
    assert main(["export-medium", str(run), "--to", "mcx", "--dose-ml", "3", "--out", str(file)]) == 2
    assert "there is 0.1, 0.2" in capsys.readouterr().err
