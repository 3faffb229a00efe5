"""A run of a reference liquid, fitted and compared by the commands that a person types."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.bench import Bench
from tankrig.devices import Frame
from tankrig.light.tank import tank_image
from tankrig.live.results import fits_in
from tankrig.materials.coefficients import optics
from tankrig.materials.dosing import tank_volume_ml
from tankrig.materials.library import material
from tankrig.pattern.wall import Wall
from tankrig.run.folder import create_run
from tankrig.run.reading import open_run
from tankrig.run.writer import RunWriter
from tankrig.scene.description import Camera, Medium, Tank
from tankrig.scene.mie import Mie
from tankrig.sequence.loading import sequence_from_table, sequence_table
from ui.cli import main

BENCH = Bench(
    Tank(), Wall((30, 40), (-80.0, 80.0), (0.0, 120.0)), "collimated", Camera("orthographic", (20, 30), 8.0),
    polarisation=0.0,
)  # fmt: skip
BEADS = optics(material("polystyrene-1.0"), 633.0)
TANK_ML = tank_volume_ml(BENCH.tank)
PER_ML = BEADS.sigma_s.value / TANK_ML
DOSES_UL = (300.0, 900.0, 2000.0)
SEQUENCE = {
    "name": "beads",
    "material": "polystyrene-1.0",
    "wavelength_nm": 633.0,
    "patterns": {"rays": {"kind": "stripes", "period_mm": 40.0, "duty": 0.4, "y_mm": [-60.0, 60.0],
                          "z_mm": [56.0, 64.0]}},
    "steps": [
        {"do": "series", "total_ul": list(DOSES_UL),
         "steps": [{"do": "capture", "pattern": "dark"}, {"do": "capture", "pattern": "rays", "frames": 3}]},
    ],
}  # fmt: skip


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Recorded to its end, of beads that are 1 % larger than their label says."""
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path / "cache"))
    path, sequence = tmp_path / "run", sequence_from_table(SEQUENCE, "test")
    patterns = sequence.drawn(BENCH.wall)
    settings = {"name": "beads", "rig": "a rig", "bench": asdict(BENCH), "sequence": sequence_table(sequence)}
    create_run(path, (20, 30), "uint16", 12, settings, list(patterns.values()))
    label = BEADS.medium.phase
    assert isinstance(label, Mie)
    beads = replace(label, diameter_um=1.01)
    rng, step = np.random.default_rng(0), 0
    with RunWriter(path) as writer:
        held = dict.fromkeys(("delivered_ul", "delivered_low_ul", "delivered_high_ul"), 0.0)
        writer.put("session", program="tankrig", devices={"camera": "c"}, **held)
        for dose_ul in DOSES_UL:
            liquid = Medium(2e-4, PER_ML * dose_ul / 1000.0, phase=beads)
            light = 3e8 * tank_image(BENCH.scene(patterns["rays"], liquid), seed=5, batches=48).image
            writer.put("dose_done", complete=True, **dict.fromkeys(held, dose_ul))
            step += 1
            for name, count in (("dark", 1), ("rays", 3)):
                for _ in range(count):
                    pixels = rng.poisson(100.0 + light * (name == "rays")).clip(0, 65000).astype(np.uint16)
                    writer.put_frame(Frame(pixels, step, step, step, step), step, patterns[name].hash)
                step += 1
        writer.finish(reason="completed", message="")
    return path


def fits(path: Path) -> list[dict[str, object]]:
    return [json.loads(line) for line in (path / "journal.jsonl").read_text().splitlines() if '"kind":"fit"' in line]


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_beads_are_fitted_by_their_label_and_pass(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was fitted with a family that no beads have is fitted anew; the page and the journal then agree."""
    assert main(["refit", str(run), "--phase", "reynolds-mccormick"]) == 0
    first = fits(run)
    assert {one["phase"]["kind"] for one in first} == {"reynolds-mccormick"}  # type: ignore[index]
    capsys.readouterr()
    command = ["validate", str(run), "--material", "polystyrene-1.0", "--wavelength", "633", "--json"]
    assert main(command) == 0
    told = json.loads(capsys.readouterr().out)
    doses, series = fits_in([event.fields for event in open_run(run).fits])
    assert series is not None
    assert series.scattering is not None
    diameter_um, sd = series.scattering.parameters["diameter_um"]
    assert abs(diameter_um - 1.01) < 4.0 * sd
    assert abs(series.ink.sigma_s - PER_ML) < max(0.02 * PER_ML, 4.0 * series.sd[1])
    assert all(one.scattering is not None and "mie" in one.scattering.families for one in doses)
    assert told["rows"]["σs per ml"]["says"] == "agrees"
    assert told["linearity"]["holds"]
    assert told["passed"], told["verdict"]
    assert "Passed" in (run / "validation.html").read_text()
    assert main(command) == 0  # nothing is fitted a third time
    assert len(fits(run)) == len(first) + 4


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_beads_of_which_nothing_is_known_are_fitted_rightly_dose_by_dose_and_as_a_series(run: Path) -> None:
    """The series began anew from no phase function, and ended 9 % beside what its doses had found."""
    assert main(["refit", str(run), "--phase", "any"]) == 0
    doses, series = fits_in([event.fields for event in open_run(run).fits])
    assert series is not None
    for strength, sd, of in [
        (series.ink.sigma_s, series.sd[1], 1.0),
        *((one.medium.sigma_s, one.sd[1], one.dose_ml) for one in doses if one.identifiable["sigma_s"]),
    ]:
        assert abs(strength - of * PER_ML) < max(0.03 * of * PER_ML, 2.5 * sd)
