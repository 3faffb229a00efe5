"""Calibration files that are damaged or not quite right: nothing rests on them in silence, nothing good is refused."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.calibration_health import calibration_checks
from drivers.rig import RigFile, calibrated_bench, load_rig_file, open_rig
from drivers.simulated import __file__ as simulated
from tankrig.bench import Bench
from tankrig.calibration.file import Calibration, in_force, passed_over, save, usable
from tankrig.calibration.radiometry import Amplified, Radiometry
from tankrig.calibration.response import LEVELS, Response, fit_response
from tankrig.checked_toml import checked
from tankrig.errors import DecisionError, ImageError, SequenceError, StoreError
from tankrig.geometry.pose import Pose
from tankrig.live.attached import require_fittable
from tankrig.pattern.wall import Wall, fractions_of_white
from tankrig.scene import Camera, Medium, Projector, Tank
from tankrig.sequence import Capture, Sequence
from ui.cli import main

KINDS = ("camera", "tank", "radiometry")
PLACE = Pose.looking((-300.0, 0.0, 15.0), (0.0, 0.0, 15.0), (0.0, 0.0, -1.0))
CALIBRATED = Bench(
    Tank((60.0, 40.0, 30.0)),
    Wall((12, 16), (-20.0, 20.0), (0.0, 30.0)),
    "calibrated",
    Camera("orthographic", (20, 30), 2.0),
    projector=Projector(
        "calibrated", position_mm=(-300.0, 0.0, 15.0), rotation=PLACE.rotation, shape=(12, 16),
        matrix=((120.0, 0.0, 8.0), (0.0, 120.0, 6.0), (0.0, 0.0, 1.0)),
    ),
)  # fmt: skip
"""With a projector whose picture is modelled pixel by pixel, which refuses shares beyond 1; small, to be quick."""


@pytest.fixture
def rig(tmp_path: Path) -> RigFile:
    file = tmp_path / "rig.toml"
    file.write_text(Path(simulated).with_name("rig.toml").read_text(encoding="utf-8"), encoding="utf-8")
    return load_rig_file(file)


def kept(folder: Path, kind: str, day: int, damaged: bool) -> Calibration:
    one = save(Calibration(kind, "device", (80, 120), {"day": day}, date=f"2026-01-{day:02d}T00:00:00+00:00"), folder)
    assert one.path is not None
    if damaged:
        one.path.write_text(one.path.read_text().replace(f"day = {day}", "day = 99"))
    return one


@given(
    st.lists(st.tuples(st.sampled_from(KINDS), st.booleans()), max_size=8),
    st.sets(st.sampled_from(KINDS)),
    st.sets(st.sampled_from(KINDS), min_size=1),
)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_newest_calibration_is_asked_about_unless_a_person_has_named_one(
    tmp_path_factory: pytest.TempPathFactory, files: list[tuple[str, bool]], named: set[str], needed: set[str]
) -> None:
    """An older calibration may be of another lens: who goes on with it, must have said so."""
    folder = tmp_path_factory.mktemp("calibration")
    history: dict[str, list[tuple[Calibration, bool]]] = {kind: [] for kind in KINDS}
    for day, (kind, damaged) in enumerate(files, 1):
        history[kind].append((kept(folder, kind, day, damaged), damaged))
    good = {kind: [one for one, damaged in those if not damaged] for kind, those in history.items()}
    words = {kind: good[kind][0].hash[:12] for kind in named if good[kind]}
    asked = {kind for kind, those in history.items() if those and those[-1][1] and kind not in words}
    over = passed_over(folder, words)
    assert {one.kind for one in over} == asked
    for one in over:
        assert str(history[one.kind][-1][0].path) in {str(other.path) for other in over if other.kind == one.kind}
        assert str(one.path) in str(one)
        if good[one.kind]:
            assert str(good[one.kind][-1].path) in str(one)
            assert good[one.kind][-1].hash[:12] in one.remedy
    found = {kind: one.hash for kind, one in usable(folder, words).items()}
    assert found == {
        kind: (those[0] if kind in words else those[-1]).hash for kind, those in good.items() if those
    }  # fmt: skip
    if asked & needed:
        with pytest.raises(DecisionError, match="a person has to decide"):
            in_force(folder, words, needed)
    else:
        assert {kind: one.hash for kind, one in in_force(folder, words, needed).items()} == found


@pytest.mark.parametrize("older", [True, False])
def test_no_run_begins_before_a_person_has_decided_and_nothing_is_made(
    rig: RigFile, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, older: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.toml").write_text('name = "one"\n[[steps]]\ndo = "capture"\npattern = "full"\n')
    folder = Path(rig.calibration_folder)
    before = kept(folder, "latency", 1, damaged=False) if older else None
    damaged = kept(folder, "latency", 2, damaged=True)
    there = sorted(tmp_path.rglob("*"))
    for words in (["--dry-run"], [], ["--no-fit"]):
        assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", *words]) == 3
        said = capsys.readouterr()
        assert said.err.count("\n") == 1
        assert str(damaged.path) in said.err
        assert before is None or str(before.path) in said.err
        assert said.out == ""
    assert sorted(tmp_path.rglob("*")) == there
    (check,) = (check for check in calibration_checks(rig, {}) if check.what.startswith("newest"))
    assert (check.passed, "runs are refused" in check.finding) == (False, True)
    open_rig(rig, looking=True).close()  # somebody who only looks is let in
    with pytest.raises(DecisionError):
        open_rig(rig)
    if before is not None:  # the person decides
        text = (tmp_path / "rig.toml").read_text()
        (tmp_path / "rig.toml").write_text(text + f'\n[calibration]\nlatency = "{before.hash[:12]}"\n')
        assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", "--no-fit"]) == 0


# -- responses ---------------------------------------------------------------------------------------------------------


def measured(seed: int, gamma: float, noise: float) -> list[float]:
    rng = np.random.default_rng(seed)
    light = (np.array(LEVELS) / 255.0) ** gamma * rng.uniform(0.1, 1e5) + rng.uniform(0.0, 1.0)
    return (light * (1.0 + noise * rng.standard_normal(light.size))).tolist()


def radiometry(response: Response) -> Calibration:
    zero, one = np.zeros((80, 120)), np.ones((80, 120))
    found = Radiometry((Amplified(1.0, 100.0, 0.0, 0.5, 3.0, 1e4, (0.0,)),), one, zero, zero, zero > 0, response)
    result, arrays = found.table()
    sd = {"projector": {"response": response.curve_sd}}
    return Calibration("radiometry", "simulated camera", (80, 120), result, sd, arrays=arrays)


SEQUENCE = Sequence("one", (Capture("full"),), exposure_ms=1.0)


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 3.5), st.sampled_from([0.0, 1e-6, 1e-4]))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_response_that_can_be_measured_is_stored_read_and_used(
    tmp_path_factory: pytest.TempPathFactory, seed: int, gamma: float, noise: float
) -> None:
    """Half an hour of calibrating must not end in a rig that cannot run, because a curve ends at 1.0000000000000004."""
    light = measured(seed, gamma, noise)
    try:
        response = fit_response(LEVELS, light, [1e-4 * light[-1]] * len(light))
    except ImageError:
        return  # a light that does not rise is refused when it is measured
    assert response.curve.min() >= 0.0
    assert response.curve.max() == 1.0
    folder = tmp_path_factory.mktemp("calibration")
    found = Radiometry.of(in_force_of(save(radiometry(response), folder)))
    np.testing.assert_array_equal(found.response.curve, response.curve)
    used(found.response.curve.tolist())


def in_force_of(one: Calibration) -> Calibration:
    assert one.path is not None
    return in_force(one.path.parent)[one.kind]


def used(curve: list[float]) -> None:
    """What run, fit and report do with it: draw, store as settings, read back, and model what is lit."""
    wall = replace(CALIBRATED.wall, response=tuple(curve))
    bench = replace(CALIBRATED, wall=wall)
    require_fittable(SEQUENCE, bench)
    stored = json.loads(json.dumps(asdict(bench)))
    again = checked(Bench, stored, "run", StoreError)
    assert again == bench
    full = SEQUENCE.drawn(again.wall)["full"]
    assert again.scene(full, Medium(0.001, 0.01, 0.5)).projector.beams


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 3.5))
@settings(max_examples=25, deadline=None)
def test_what_earlier_versions_have_stored_beyond_1_by_rounding_is_used(seed: int, gamma: float) -> None:
    rng = np.random.default_rng(seed)
    curve = np.maximum.accumulate((np.arange(256) / 255.0) ** gamma)
    off = curve * (1.0 + rng.uniform(-4e-16, 4e-16, 256))
    off[-1] = 1.0 + rng.choice([2.0**-52, 2.0**-51])
    used(off.tolist())
    np.testing.assert_allclose(fractions_of_white(off), curve, rtol=0.0, atol=1e-15)


@given(st.integers(0, 255), st.sampled_from([1.001, 1.0 + 1e-6, -1e-6, float("nan"), float("inf")]))
@settings(max_examples=100, deadline=None)
def test_a_response_that_is_truly_wrong_is_refused(level: int, value: float) -> None:
    curve = np.linspace(0.0, 1.0, 256)
    curve[level] = value
    with pytest.raises(SequenceError, match=f"at level {level}"):
        Wall((4, 6), (0.0, 1.0), (0.0, 1.0), response=tuple(curve.tolist()))


def test_a_wrong_response_is_refused_before_anything_is_made_or_moves(
    rig: RigFile, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.toml").write_text('name = "one"\n[[steps]]\ndo = "capture"\npattern = "full"\n')
    good = radiometry(Response(np.linspace(0.0, 1.0, 256), np.zeros(256), 0.0))
    projector = {**good.result["projector"], "response": np.linspace(0.0, 1.2, 256)}
    wrong = save(replace(good, result={**good.result, "projector": projector}), Path(rig.calibration_folder))
    there = sorted(tmp_path.rglob("*"))
    for words in (["--dry-run"], [], ["--no-fit"]):
        assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", *words]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert str(wrong.path) in said
        assert "give a fraction of the light" in said
    assert sorted(tmp_path.rglob("*")) == there
    with pytest.raises(StoreError, match="is no radiometric calibration"):
        calibrated_bench(rig)


def test_a_pattern_that_cannot_be_fitted_is_refused_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A sheet beside the tank used to leave an empty run; without a fit it may be photographed."""
    monkeypatch.chdir(tmp_path)
    text = Path(simulated).with_name("rig.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(
        text.replace("size_mm = [240.0, 160.0, 120.0]", "size_mm = [240.0, 80.0, 120.0]")
    )
    sheet = '[patterns.beside]\nkind = "sheet"\ny_mm = [60.0, 70.0]\nz_mm = [58.0, 62.0]\n'
    (tmp_path / "one.toml").write_text(f'name = "one"\n{sheet}[[steps]]\ndo = "capture"\npattern = "beside"\n')
    there = sorted(tmp_path.rglob("*"))
    for words in (["--dry-run"], []):
        assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", *words]) == 2
        assert 'pattern "beside" cannot be fitted' in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == there
    assert main(["run", "one.toml", "--rig", "rig.toml", "--out", "run", "--dry-run", "--no-fit"]) == 0
