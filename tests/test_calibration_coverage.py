"""Stated uncertainties hold: on benches whose truth is hidden, 95 % intervals hold the truth 95 times of 100.

`pytest -m long -s tests/test_calibration_coverage.py` prints the tables of docs/calibration.md; TANKRIG_BENCHES says
how many benches (20 where left out), whose seeds begin at 100.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from drivers.simulated.sensor import fixed_pattern
from tankrig.calibration.camera import LENS
from tankrig.calibration.projector import FOUND as OF_PROJECTOR
from tankrig.calibration.radiometry_plan import RadiometryPlan
from tankrig.calibration.radiometry_procedure import measure_radiometry
from tankrig.calibration.radiometry_result import calibration_of, radiometry_of
from tankrig.calibration.tank import FOUND as OF_TANK

from .calibrated_bench import Calibrated, calibrated, light_errors, position_errors_mm, shortcut_errors_mm
from .calibration_truth import off, true_blurs, true_shading
from .radiometry_bench import random_bench as random_radiometry_bench

FIRST_SEED = 100
BENCHES = int(os.environ.get("TANKRIG_BENCHES", "20"))
CAMERA_LENS = tuple(f"camera.{name}" for name in LENS)


class Coverage:
    """Errors over stated standard deviations, by quantity, and Mahalanobis distances of groups."""

    def __init__(self) -> None:
        self.z: dict[str, list[float]] = {}
        self.groups: dict[str, list[tuple[float, int]]] = {}

    def add(self, name: str, errors: np.ndarray, sds: np.ndarray) -> None:
        """Of one quantity, once or for many pixels."""
        self.z.setdefault(name, []).extend(np.ravel(np.asarray(errors) / np.asarray(sds)).tolist())

    def add_group(self, name: str, names: tuple[str, ...], errors: np.ndarray, covariance: np.ndarray) -> None:
        """Quantities that are uncertain together."""
        sds = np.sqrt(np.diag(covariance))
        for each, error, sd in zip(names, errors, sds, strict=True):
            self.add(f"{name}: {each}", error, sd)
        scaled = errors / sds
        squared = float(scaled @ np.linalg.solve(covariance / np.outer(sds, sds), scaled))
        self.groups.setdefault(name, []).append((squared, len(errors)))

    def within(self, begins: str = "") -> float:
        """Share of all that lie within 1.96 standard deviations."""
        z = np.concatenate([np.array(values) for name, values in self.z.items() if name.startswith(begins)])
        return float((np.abs(z) < 1.96).mean())

    def rms(self, name: str) -> float:
        return float(np.sqrt(np.mean(np.square(self.z[name]))))

    def lines(self) -> list[str]:
        """A table for people."""
        rows = [f"{'quantity':34s} {'times':>6s} {'rms z':>6s} {'mean z':>6s} {'within 1.96':>11s}"]
        for name, values in self.z.items():
            inside = float((np.abs(values) < 1.96).mean())
            rows.append(f"{name:34s} {len(values):6d} {self.rms(name):6.2f} {np.mean(values):+6.2f} {inside:11.1%}")
        for name, distances in self.groups.items():
            squared, sizes = np.array(distances).T
            inside = float((squared < chi2.ppf(0.95, sizes)).mean())
            rows.append(
                f"{name}, together: Mahalanobis distance² {squared.mean():.1f} of {sizes[0]:.0f}, within its 95 %: "
                f"{inside:.0%}"
            )
        return rows


def stated(found: Calibrated, into: Coverage) -> None:
    """All of one bench."""
    bench = found.bench
    into.add_group("camera", LENS, *off(found.camera.known, bench, LENS, "camera."))
    into.add_group("tank", OF_TANK, *off(found.tank.known, bench, OF_TANK))
    into.add_group("projector", OF_PROJECTOR, *off(found.projector.known, bench, OF_PROJECTOR))
    errors, covariance = off(found.projector.known, bench, OF_PROJECTOR + CAMERA_LENS + OF_TANK)
    sds = np.sqrt(np.diag(covariance))
    squared = float((errors / sds) @ np.linalg.solve(covariance / np.outer(sds, sds), errors / sds))
    into.groups.setdefault("all of the geometry", []).append((squared, errors.size))
    assert found.projector.evenness is not None
    fall_off = np.array(found.projector.evenness.coefficients) - true_shading(bench, found.projector.corners_px)
    for number, (error, sd) in enumerate(zip(fall_off, found.projector.evenness.sd, strict=True)):
        into.add(f"projector: shading {number}", error, np.array(sd))
    true = true_blurs(bench)
    for name, blur in (("camera", found.camera.blur), ("projector", found.projector.blur)):
        assert blur is not None
        into.add(f"{name}: blur_px", np.array(blur.px - true[name]), np.array(blur.sd_px))


def test_positions_in_the_water_are_known_at_any_depth() -> None:
    """With a camera of 480 × 360 and a projector of 256 × 192 pixels; the one-plane shortcut errs by ten times more."""
    found = calibrated(3, views=(9, 2, 6))
    assert found.camera.rms_px < 0.1
    assert found.tank.rms_px < 0.1
    assert found.projector.rms_px < 0.1
    assert abs(found.tank.level_mm - found.bench.level_mm) < 3.0 * found.tank.sd["level_mm"]
    errors = position_errors_mm(found)
    assert all(np.quantile(one, 0.95) < 0.8 for one in errors.values()), errors
    assert np.quantile(shortcut_errors_mm(found.bench, 50.0), 0.95) > 5.0
    assert found.camera.doubts + found.tank.doubts + found.projector.doubts == ()
    assert np.sqrt(np.mean(light_errors(found) ** 2)) < 0.005  # of light that falls off by a third


def test_one_bench_is_where_its_intervals_say() -> None:
    """The camera used to be 0.6 mm off at a stated 0.004: a fit that trusts it says determined and is wrong."""
    coverage = Coverage()
    found = calibrated(3, views=(9, 2, 6))
    stated(found, coverage)
    assert all(abs(values[0]) < 4.0 for values in coverage.z.values()), coverage.lines()
    for name, ((squared, size),) in coverage.groups.items():
        assert chi2.ppf(1e-4, size) < squared < chi2.ppf(1.0 - 1e-5, size), name
    assert 0.1 < found.tank.sd["camera_position_mm"][2] < 3.0
    # Focal length and distance are known far better together than each alone.
    focal_and_height = found.tank.known.only(("camera.fx", "camera.z_mm")).covariance
    assert focal_and_height[0, 1] / np.sqrt(focal_and_height[0, 0] * focal_and_height[1, 1]) > 0.9


@pytest.mark.long
def test_intervals_of_the_geometry_hold_the_truth(capsys: pytest.CaptureFixture[str]) -> None:
    """With small pictures, 480 × 360 and 256 × 192: the numbers of corners, not of pixels, decide."""
    coverage = Coverage()
    for seed in range(FIRST_SEED, FIRST_SEED + BENCHES):
        stated(calibrated(seed), coverage)
        with capsys.disabled():
            print(f"bench {seed}", flush=True)
    with capsys.disabled():
        print(*coverage.lines(), sep="\n", flush=True)
        print(f"all, {BENCHES} benches: {coverage.within():.1%} within 1.96 standard deviations")
    assert 0.93 <= coverage.within() <= 0.97
    spread = 4.0 / np.sqrt(2.0 * BENCHES)  # four standard deviations of an rms of so many
    assert all(coverage.rms(name) < 1.0 + spread for name in coverage.z), "an interval is too narrow"


@pytest.mark.long
def test_intervals_of_the_radiometry_hold_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coverage = Coverage()
    for seed in range(FIRST_SEED, FIRST_SEED + BENCHES):
        bench = random_radiometry_bench(tmp_path / str(seed), seed)
        try:
            measured = measure_radiometry(
                bench.projector, bench.camera, RadiometryPlan(gains=(1.0, 4.0)), bench.camera.put
            )
        finally:
            bench.close()
        found, sd = radiometry_of(measured), calibration_of(measured).sd
        for one, its in zip(found.amplified, sd["amplified"], strict=True):
            gain = f"gain {one.gain:g}"
            coverage.add(f"{gain}: dn_per_e", one.dn_per_e - bench.dn_per_e(one.gain), its["dn_per_e"])
            coverage.add(f"{gain}: read_noise_e", one.read_noise_e - bench.sensor.read_noise, its["read_noise_e"])
        true = np.array(bench.truth.bench.wall.response)
        levels = slice(8, 250, 6)
        coverage.add("response", (found.response.curve - true)[levels], np.asarray(found.response.curve_sd)[levels])
        flat = (found.flat * bench.sensor.response / fixed_pattern(bench.sensor, bench.camera.shape)[0])[~found.hot]
        coverage.add("flat", flat / flat.mean() - 1.0, np.array(sd["flat"]["response"]))
    with capsys.disabled():
        print(*coverage.lines(), sep="\n", flush=True)
    spread = 4.0 / np.sqrt(2.0 * BENCHES)
    assert all(coverage.rms(name) < 1.0 + spread for name in coverage.z), "an interval is too narrow"
