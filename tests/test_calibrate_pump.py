"""Weighed doses become a correction with an honest uncertainty; nonsense becomes one sentence and no file."""

import io
import json
import os
import pty
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from drivers.rig import load_rig_file
from tankrig.calibration.pump import (
    CalibrationError,
    PumpCalibration,
    calibrate_pump,
    load_pump_calibration,
    microlitres_per_mg,
    save_pump_calibration,
)
from tankrig.dosing import DoseLimits, GuardedDoser, TankLedger
from tankrig.errors import DeviceError, StoreError
from ui.cli import calibrate_pump as command
from ui.cli import main

from .doser_bench import AnyBench, Bench, CavroBench, NewEraBench
from .test_rig_doser_contract import Nowhere
from .virtual_time import KilledError, World

NOMINAL = np.repeat([50.0, 250.0, 500.0], 10)
BASIS = {"doser": "rig-doser TD000001", "basis": {"steps_per_ul": 10.0}, "nominal_increment_ul": 0.1}


def weighed(correction: float, scatter_ul: float, seed: int, temperature_c: float = 20.0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, scatter_ul, NOMINAL.size)
    return (correction * NOMINAL + noise) / microlitres_per_mg(temperature_c)


def test_the_correction_is_found_and_its_error_bars_hold() -> None:
    """95 % intervals contain the truth in about 95 of 100 sets of weights, of three doses as of thirty."""
    for few in (np.arange(30), np.array([0, 12, 24])):
        held = []
        for seed in range(400):
            found = calibrate_pump(NOMINAL[few], weighed(1.034, 1.5, seed)[few], **BASIS)
            held.append(abs(found.correction - 1.034) <= 2.0 * found.correction_sd)
            assert found.increment_ul == pytest.approx(0.1 * found.correction)
            assert found.increment_sd_ul == pytest.approx(0.1 * found.correction_sd)
        assert 0.92 < np.mean(held) < 0.98


def test_temperature_density_and_evaporation_count() -> None:
    mass = weighed(1.0, 0.0, 0, temperature_c=30.0)
    assert calibrate_pump(NOMINAL, mass, temperature_c=30.0, **BASIS).correction == pytest.approx(1.0)
    assert calibrate_pump(NOMINAL, mass, temperature_c=20.0, **BASIS).correction == pytest.approx(0.9974, abs=1e-4)
    assert calibrate_pump(
        NOMINAL, 1.1 * mass, temperature_c=30.0, density_g_per_ml=1.1 * 0.99565, **BASIS
    ).correction == (pytest.approx(1.0, abs=2e-4))
    evaporated = calibrate_pump(NOMINAL, mass - 2.0, temperature_c=30.0, evaporation_mg=2.0, **BASIS)
    assert evaporated.correction == pytest.approx(1.0)
    assert abs(evaporated.offset_ul) < 1e-9


@pytest.mark.parametrize(
    ("nominal", "mass", "more", "reason"),
    [
        ([100.0, 100.0], [100.0, 100.0], {}, "2 weights are too few"),
        ([100.0] * 3, [100.0] * 4, {}, "3 volumes and 4 weights"),
        ([100.0] * 3, [100.0, -1.0, 100.0], {}, "weight 2 = -1 mg is not positive"),
        ([100.0, 0.0, 100.0], [100.0] * 3, {}, "volume 2 = 0 µl is not positive"),
        ([100.0] * 3, [100.0, float("nan"), 100.0], {}, "weight 2 = nan mg"),
        ([100.0] * 4, [80.0, 120.0, 95.0, 100.0], {}, "scatter by"),
        ([100.0] * 3, [0.1, 0.1, 0.1], {}, "check the syringe's settings and that weights are in mg"),
        ([100.0] * 3, [100.0] * 3, {"temperature_c": 90.0}, "temperature = 90"),
        ([100.0] * 3, [100.0] * 3, {"density_g_per_ml": 1000.0}, "density = 1000"),
        ([100.0] * 3, [100.0] * 3, {"evaporation_mg": -1.0}, "evaporation = -1"),
    ],
)
def test_nonsense_is_refused(nominal: list[float], mass: list[float], more: dict[str, float], reason: str) -> None:
    with pytest.raises(CalibrationError, match=re.escape(reason)):
        calibrate_pump(nominal, mass, **BASIS, **more)


def made(**changes: object) -> PumpCalibration:
    return calibrate_pump(NOMINAL, weighed(1.02, 0.1, 1), **{**BASIS, **changes})


def test_a_file_is_read_back_as_it_was_and_never_overwritten(tmp_path: Path) -> None:
    path, calibration = tmp_path / "pump.toml", made()
    save_pump_calibration(calibration, path)
    assert load_pump_calibration(path) == calibration
    before = path.read_bytes()
    with pytest.raises(StoreError, match="not overwritten"):
        save_pump_calibration(made(), path)
    assert path.read_bytes() == before
    path.write_text(path.read_text().replace("correction = 1.0", "correction = 10"))
    with pytest.raises(StoreError, match="is no calibration of a pump"):
        load_pump_calibration(path)
    path.write_bytes(before.replace(b"mass_mg", b"9" * 5000))
    with pytest.raises(StoreError, match=r'key "9{60}" is unknown') as refusal:
        load_pump_calibration(path)
    assert len(str(refusal.value)) < 600


@pytest.mark.parametrize(
    ("kind", "basis"),
    [(Bench, {"steps_per_ul": 10.0}), (NewEraBench, {"diameter_mm": 12.0}), (CavroBench, {"syringe_ul": 1000.0})],
)
def test_every_pump_doses_by_its_calibration(tmp_path: Path, kind: type[AnyBench], basis: dict[str, float]) -> None:
    """What the syringe really delivers is 2 % more than nominal: the driver has to push 2 % less."""
    file, other = tmp_path / "pump.toml", tmp_path / "other.toml"
    save_pump_calibration(calibration := made(basis=basis), file)
    save_pump_calibration(made(basis={"diameter_mm": 1.0, "syringe_ul": 1.0, "steps_per_ul": 1.0}), other)
    with kind(tmp_path) as bench:
        plain = bench.open()
        plain_identity = plain.identity
        plain.dose_to(100.0)
        tank = TankLedger(tmp_path / "tank.jsonl")
        GuardedDoser(plain, DoseLimits(500.0, 500.0, 500.0), tank, Nowhere(), "run").close()
        with pytest.raises(DeviceError, match="calibrate anew"):
            bench.open(calibration=other)
        doser = bench.open(calibration=file)
        assert doser.identity != plain_identity
        assert doser.delivered().volume_ul == pytest.approx(100.0 * calibration.correction, abs=1.2)
        ledger = TankLedger(tank.path)
        guard = GuardedDoser(doser, DoseLimits(500.0, 500.0, 500.0), ledger, Nowhere(), "run")
        assert guard.undecided is None, "another scale of volumes was taken for ink"
        ledger.close()
        before_ul, nominal_ul = doser.delivered().volume_ul, bench.true_ul
        after = doser.dose_to(before_ul + 200.0)
        assert (bench.true_ul - nominal_ul) * calibration.correction == pytest.approx(
            after.volume_ul - before_ul, abs=0.3
        )
        guard = GuardedDoser(doser, DoseLimits(500.0, 500.0, 500.0), TankLedger(tank.path), Nowhere(), "run")
        assert guard.undecided, "200 µl that nobody had written down were lost with the change of scale"
        held = guard.delivered()
        assert (held.low_ul, held.high_ul) == (0.0, pytest.approx(200.0, abs=1.0))
        guard.close()


def weights_file(folder: Path, text: str) -> Path:
    path = folder / "weights.csv"
    path.write_text(text)
    return path


def test_weights_from_a_file_make_a_dated_calibration(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    rows = "".join(f"{v},{m}\n" for v, m in zip(NOMINAL, weighed(1.01, 0.2, 5), strict=True))
    weights = weights_file(tmp_path, "volume_ul,mass_mg\n" + rows)
    assert main(["calibrate", "pump", "--weights", str(weights), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["correction"] == pytest.approx(1.01, abs=0.002)
    assert re.fullmatch(r"pump-\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d\.toml", Path(told["path"]).name)
    assert load_pump_calibration(tmp_path / told["path"]).basis == {"steps_per_ul": 10.0}
    out = tmp_path / "pump.toml"
    assert main(["calibrate", "pump", "--weights", str(weights), "--out", str(out)]) == 0
    assert f'calibration = "./{out.name}"' in capsys.readouterr().out
    before = out.read_bytes()
    assert main(["calibrate", "pump", "--weights", str(weights), "--out", str(out)]) == 2
    assert "not overwritten" in capsys.readouterr().err
    assert out.read_bytes() == before


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("volume_ul,mass_mg\n100,100\n100,101\n", "2 weights are too few"),
        ("volume_ul,mass_mg\n100,100\n100,-1\n100,101\n", "weight 2 = -1 mg"),
        ("volume_ul,mass_mg\n100,100\n100,heavy\n100,101\n", "is not a CSV file with a header and numbers"),
        ("100,100\n100,101\n100,102\n", "in the columns volume_ul and mass_mg"),
        (None, "cannot be read"),
    ],
)
def test_bad_weights_are_told_and_write_nothing(
    tmp_path: Path, monkeypatch, capsys, text: str | None, reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    file = weights_file(tmp_path, text) if text else tmp_path / "missing.csv"
    assert main(["calibrate", "pump", "--weights", str(file), "--out", "pump.toml"]) == 2
    error = capsys.readouterr().err
    assert reason in error
    assert error.count("\n") == 1
    assert not (tmp_path / "pump.toml").exists()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a person without a rig file calls the command."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    return tmp_path


def test_without_a_terminal_and_weights_nothing_is_dosed(folder: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["calibrate", "pump"]) == 2
    assert "give --weights FILE" in capsys.readouterr().err
    assert not (folder / "simulated").exists()


@pytest.mark.usefixtures("folder")
def test_a_volume_beyond_the_rigs_limit_is_refused_before_anything_moves(monkeypatch, capsys) -> None:
    monkeypatch.setattr(command, "somebody", lambda: True)
    monkeypatch.setattr(command, "confirm", lambda _: None)
    assert main(["calibrate", "pump", "--volumes", "20,5000"]) == 2
    assert "5000 µl is not between 0.1 and the rig file's dose_ul = 1000" in capsys.readouterr().err


def test_guided_at_a_terminal(tmp_path: Path) -> None:
    """Four doses on a balance that shows 2 % more than the simulated doser says."""
    weights = [20.35, 81.5, 20.3, 81.4]
    answers = "y\n" + "".join(f"\n{weight}\n" for weight in weights)
    told, status = on_terminal(tmp_path, answers, "--volumes", "20,80", "--repeats", "2", "--out", "pump.toml")
    assert status == 0, told
    found = load_pump_calibration(tmp_path / "pump.toml")
    assert found.nominal_ul == pytest.approx((20.0, 80.0, 20.0, 80.0))
    assert found.mass_mg == tuple(weights)
    assert found.correction == pytest.approx(1.0216, abs=0.003)
    assert "4 doses" in told
    (ledger,) = tmp_path.rglob("tank.ledger")
    entries = [json.loads(line) for line in ledger.read_text().splitlines()]
    assert [entry["most_ul"] for entry in entries if entry["kind"] == "aside"] == [20.0, 80.0, 20.0, 80.0]
    assert entries[-1]["kind"] == "joint", "each is booked as over"
    assert entries[-1]["tank"] == [0.0, 0.0, 0.0], "what was weighed is not in the tank"
    assert entries[-1]["count"][0] == pytest.approx(200.0)


def on_terminal(folder: Path, answers: str, *options: str) -> tuple[str, int]:
    """What a program of its own says at a terminal, and its exit status."""
    environment = {key: value for key, value in os.environ.items() if key != "TANKRIG_RIG"} | {"COLUMNS": "200"}
    words = [sys.executable, "-c", "import sys; from ui.cli import main; sys.exit(main())", "calibrate", "pump"]
    master, slave = pty.openpty()
    process = subprocess.Popen([*words, *options], stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=environment)
    os.close(slave)
    os.write(master, answers.encode())
    told = b""
    try:
        while chunk := os.read(master, 4096):
            told += chunk
    except OSError:  # the other side is gone
        pass
    os.close(master)
    return told.decode(), process.wait(60)


@pytest.mark.parametrize("kind", [NewEraBench, CavroBench])
def test_the_tube_is_asked_for_only_while_the_pump_rests(
    tmp_path: Path, kind: type[AnyBench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pump whose program was killed in a dose pushes on, and what it pushes counts as in the tank."""
    from drivers.simulated import __file__ as simulated

    rig = tmp_path / "rig.toml"
    rig.write_text(Path(simulated).with_name("rig.toml").read_text(encoding="utf-8"), encoding="utf-8")
    description, world = load_rig_file(rig), World()
    asked: list[bool] = []

    def no_vessel_yet(_question: str) -> None:
        asked.append(bench.moving)
        raise DeviceError("it does not hang there")

    with kind(tmp_path, world=world) as bench:
        doser = bench.open()
        ledger = TankLedger(description.ledger)
        guard = GuardedDoser(doser, description.limits, ledger, Nowhere(), "run")
        world.after(0.7, bench.clock.kill)
        with suppress(KilledError):
            guard.dose_to(900.0)
        ledger.close()
        bench.bury(doser)
        assert bench.moving
        monkeypatch.setattr("drivers.registry.open_device", lambda _driver, _settings: bench.open())
        monkeypatch.setattr(command, "confirm", no_vessel_yet)
        monkeypatch.setattr(command, "somebody", lambda: True)
        with pytest.raises(DeviceError, match="does not hang"):
            command.pump.main(["--rig", str(rig), "--volumes", "20"], standalone_mode=False)
        assert asked == [False]
        ledger = TankLedger(description.ledger)
        guard = GuardedDoser(bench.open(), description.limits, ledger, Nowhere(), "run")
        low_ul, high_ul = guard.delivered()[1:]
        assert low_ul <= bench.true_ul <= high_ul
        guard.close()
        ledger.close()


def test_a_pump_is_initialised_only_with_its_tube_in_a_waste_vessel(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It pushes out what the syringe holds, so a person has to say so first."""
    from drivers.simulated import __file__ as simulated

    with CavroBench(folder) as bench:
        bench.do("reset")
        rig = Path(simulated).with_name("rig.toml").read_text(encoding="utf-8")
        doser = rig[rig.index("[doser]") : rig.index("[limits]")]
        settings = "port = './doser'\ncount_file = './count'\nsyringe_ul = 1000.0\nspeed_ul_per_s = 500.0\n\n"
        (folder / "rig.toml").write_text(rig.replace(doser, f'[doser]\ndriver = "cavro"\n{settings}'), encoding="utf-8")
        monkeypatch.setattr(command, "somebody", lambda: True)
        for answer, status, times in (("n", 1, 0), ("y", 0, 1)):
            monkeypatch.setattr("sys.stdin", io.StringIO(f"{answer}\n"))
            assert main(["calibrate", "pump", "--rig", "rig.toml", "--initialise"]) == status, capsys.readouterr()
            assert bench.board.core.initialised_times == times
        assert bench.true_ul == 0.0
