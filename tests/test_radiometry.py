"""Frames become proportional to radiance, with numbers that are true and doubts that are told."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.simulated.sensor import counts, fixed_pattern
from drivers.simulated.settings import Sensor
from tankrig.calibration.darks import fit_darks
from tankrig.calibration.exposed import Exposed, exposed
from tankrig.calibration.file import load, save
from tankrig.calibration.hdr import Merged, merge
from tankrig.calibration.linearity import fit_linearity
from tankrig.calibration.photon_transfer import photon_transfer
from tankrig.calibration.radiometry import Radiometry
from tankrig.calibration.radiometry_plan import RadiometryPlan
from tankrig.calibration.radiometry_procedure import CAP, RadiometryMeasured, measure_radiometry
from tankrig.calibration.radiometry_result import calibration_of, radiometry_of
from tankrig.calibration.response import LEVELS, fit_response
from tankrig.devices import CameraSettings
from tankrig.errors import DeviceError, ImageError, StoreError

from .radiometry_bench import RadiometryBench, random_bench

PLAN = RadiometryPlan(gains=(1.0, 4.0))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RadiometryBench]:
    made = random_bench(tmp_path_factory.mktemp("bench"), 0)
    yield made
    made.close()


@pytest.fixture(scope="module")
def measured(bench: RadiometryBench) -> RadiometryMeasured:
    return measure_radiometry(bench.projector, bench.camera, PLAN, bench.camera.put)


def errors(bench: RadiometryBench, measured: RadiometryMeasured) -> dict[str, float]:
    """Largest relative errors of what was measured, against what is true."""
    sensor, found = bench.sensor, radiometry_of(measured)
    of = {"linearity": 0.0, "dn per e": 0.0, "read noise": 0.0}
    for one in found.amplified:
        most = one.full_dn / bench.dn_per_e(one.gain)
        electrons = np.geomspace(most / 100.0, most, 200)
        corrected = one.curve.linear(bench.counts(electrons, one.gain)) / electrons
        of["linearity"] = max(of["linearity"], float(np.ptp(corrected) / corrected.mean() / 2.0))
        of["dn per e"] = max(of["dn per e"], abs(one.dn_per_e / bench.dn_per_e(one.gain) - 1.0))
        of["read noise"] = max(of["read noise"], abs(one.read_noise_e / sensor.read_noise - 1.0))
    true = np.array(bench.truth.bench.wall.response)
    of["response"] = float(np.abs(found.response.curve / np.maximum(true, 1e-9) - 1.0)[16:].max())
    of["response, of full"] = float(np.abs(found.response.curve - true).max())
    flat = (found.flat * sensor.response / fixed_pattern(sensor, bench.camera.shape)[0])[~found.hot]
    of["flat"] = float(flat.std() / flat.mean())
    return of


def test_the_whole_procedure_finds_what_is_true(bench: RadiometryBench, measured: RadiometryMeasured) -> None:
    """The figures of the issue: linearity .5 %, response 1 %, read noise and gain 3 %."""
    off = errors(bench, measured)
    assert off["linearity"] < 0.005
    assert max(off["dn per e"], off["read noise"]) < 0.03
    assert off["response"] < 0.01
    assert off["response, of full"] < 0.002
    assert off["flat"] < 0.003
    calibration = calibration_of(measured)
    assert not calibration.doubts
    assert bench.camera.before_lens == "nothing"
    hot = fixed_pattern(bench.sensor, bench.camera.shape)[1] > bench.sensor.dark_current
    assert np.array_equal(radiometry_of(measured).hot & hot, hot)


def test_corrected_frames_are_proportional_to_radiance_at_any_exposure_and_gain(
    bench: RadiometryBench, measured: RadiometryMeasured, tmp_path: Path
) -> None:
    """After the file: what a fit will see."""
    found = Radiometry.of(load(save(calibration_of(measured), tmp_path).path))
    rows, columns = bench.camera.shape
    radiance = np.geomspace(1e-6, 2e-5, columns) * np.ones((rows, 1))
    random = np.random.default_rng(1)
    scales = []
    for settings in (CameraSettings(200.0), CameraSettings(500.0), CameraSettings(100.0, 4.0)):
        frames = [counts(radiance, bench.sensor, settings, random) for _ in range(8)]
        corrected = np.mean([found.corrected(frame, settings) for frame in frames], axis=0)
        by_column = np.median(corrected / radiance, axis=0)
        assert by_column[columns // 4 :].std() / by_column.mean() < 0.006
        spread = np.std([found.corrected(frame, settings) for frame in frames], axis=0, ddof=1)
        expected = np.sqrt(found.variance(corrected, settings))
        assert np.median(spread[~found.hot] / expected[~found.hot]) == pytest.approx(0.95, abs=0.07)
        scales.append(np.median(by_column[columns // 2 :]))
    assert np.ptp(scales) / np.mean(scales) < 0.01
    with pytest.raises(StoreError, match=r"at gain 1, 4 and not at 2; .* with the gains 1, 4, 2"):
        found.at(2.0)
    with pytest.raises(ImageError, match="cannot be corrected"):
        found.corrected(np.zeros((4, 4), np.uint16), CameraSettings(1.0))


def brackets(bench: RadiometryBench, found: Radiometry) -> tuple[Merged, np.ndarray]:
    """Exposures of a scene that spans 4.3 decades, merged, and its radiance."""
    random, columns = np.random.default_rng(2), bench.camera.shape[1]
    brightest = 0.7 * bench.sensor.full_well / bench.sensor.response
    radiance = np.geomspace(brightest, brightest / 10**4.3, columns) * np.ones((bench.camera.shape[0], 1))
    times = (1.0, 10.0, 100.0, 1000.0, 3000.0)
    frames = [
        (counts(radiance, bench.sensor, CameraSettings(one), random), CameraSettings(one))
        for one in times
        for _ in "12"
    ]
    return merge(frames, found), radiance


def test_brackets_are_merged_over_four_decades_without_a_seam(
    bench: RadiometryBench, measured: RadiometryMeasured
) -> None:
    """A step where one exposure takes over from another would be taken for light by a fit."""
    found, rows = radiometry_of(measured), bench.camera.shape[0]
    merged, radiance = brackets(bench, found)
    ratio = np.median(merged.image / radiance, axis=0)
    noise = np.median(merged.sd / merged.image, axis=0) * 1.2533 / np.sqrt(rows)
    assert np.all(np.abs(ratio / np.median(ratio) - 1.0) < 0.003 + 5.0 * noise)
    assert merged.decades > 4.0
    for step, sd in zip(merged.steps, merged.steps_sd, strict=True):
        assert abs(step) < 0.003 + 3.0 * sd
    off = (merged.image / radiance / np.median(ratio) - 1.0)[~found.hot] / (merged.sd / merged.image)[~found.hot]
    assert np.median(np.abs(off)) == pytest.approx(0.6745, abs=0.12)
    with pytest.raises(ImageError, match="no frames"):
        merge([], found)


def test_a_seam_would_be_seen(bench: RadiometryBench, measured: RadiometryMeasured) -> None:
    """An exposure that is 5 % longer than the camera says makes a step, and the merge tells its size."""
    found, random = radiometry_of(measured), np.random.default_rng(3)
    radiance = np.full(bench.camera.shape, 0.3 * bench.sensor.full_well / bench.sensor.response / 20.0)
    frames = [
        (counts(radiance, bench.sensor, CameraSettings(true_ms), random), CameraSettings(said_ms))
        for said_ms, true_ms in ((20.0, 20.0), (40.0, 42.0))
    ]
    merged = merge(frames, found)
    assert merged.steps[0] == pytest.approx(-0.05, abs=0.01)


def test_a_cap_left_off_is_named(bench: RadiometryBench) -> None:
    def ask(what: str) -> None:
        bench.camera.put("diffuser" if what == CAP else what)

    lit = replace(PLAN, gains=(1.0,), dark_frames=2)
    bench.camera.put("nothing")
    with pytest.raises(ImageError, match="cap the lens"):
        measure_radiometry(_Lit(bench), bench.camera, lit, ask)
    bench.camera.put("nothing")


class _Lit:
    """A room with its light on: level 0 is bright."""

    def __init__(self, bench: RadiometryBench) -> None:
        self._projector = bench.projector
        self.shape, self.name = bench.projector.shape, bench.projector.name

    def show(self, pattern):
        from tankrig.pattern import Pattern

        return self._projector.show(Pattern("lit", np.full_like(pattern.pixels, 160)))


@pytest.mark.parametrize(("diffuser", "reason"), [(1e-8, "bring the light nearer"), (1e-1, "close the aperture")])
def test_light_that_is_too_dim_or_too_bright_is_named(tmp_path: Path, diffuser: float, reason: str) -> None:
    bench = random_bench(tmp_path, 1)
    object.__setattr__(bench.truth, "diffuser", diffuser)
    plan = replace(PLAN, gains=(1.0,), dark_frames=2)
    try:
        with pytest.raises(DeviceError, match=reason):
            measure_radiometry(bench.projector, bench.camera, plan, bench.camera.put)
    finally:
        bench.close()


def shot(sensor: Sensor, radiance: float, exposure_ms: float, frames: int = 4, seed: int = 0) -> Exposed:
    random = np.random.default_rng((seed, round(exposure_ms * 1000)))
    field = np.full((30, 40), radiance)
    taken = [counts(field, sensor, CameraSettings(exposure_ms), random) for _ in range(frames)]
    return exposed(taken, exposure_ms, sensor.saturation)


def test_procedures_refuse_what_they_cannot_use() -> None:
    sensor = Sensor()
    darks = [shot(sensor, 0.0, one) for one in (10.0, 1000.0)]
    dark = fit_darks(darks, sensor.saturation)
    lit = 0.5 * sensor.full_well / sensor.response / 100.0
    sweep = [shot(sensor, lit, one).above(dark.at(one)) for one in np.geomspace(2.0, 190.0, 12)]
    with pytest.raises(ImageError, match="single exposure"):
        fit_darks(darks[:1], sensor.saturation)
    with pytest.raises(ImageError, match="cap the lens"):
        fit_darks([darks[0], shot(sensor, lit, 100.0)], sensor.saturation)
    with pytest.raises(ImageError, match=r"3 of 3 exposures .* 8 are needed"):
        fit_linearity(sweep[:3], ~dark.hot)
    saturated = [shot(sensor, 100 * lit, one).above(dark.at(one)) for one in np.geomspace(2.0, 190.0, 12)]
    with pytest.raises(ImageError, match="of 12 exposures of the sweep are not saturated"):
        fit_linearity(saturated, ~dark.hot)
    with pytest.raises(ImageError, match="spans a factor of"):
        fit_linearity([shot(sensor, lit, one).above(dark.at(one)) for one in np.linspace(60, 120, 10)], ~dark.hot)
    quiet = [replace(one, variance=np.full((30, 40), dark.read_variance)) for one in sweep]
    with pytest.raises(ImageError, match="noise reduction"):
        photon_transfer(quiet, dark, fit_linearity(sweep, ~dark.hot))
    with pytest.raises(ImageError, match="give two alike"):
        exposed([np.zeros((2, 2), np.uint8)], 1.0, 255)
    light = [(level / 255.0) ** 2.2 for level in LEVELS]
    sd = [1e-4] * len(LEVELS)
    with pytest.raises(ImageError, match="0 and 255 too"):
        fit_response(LEVELS[1:], light[1:], sd[1:])
    with pytest.raises(ImageError, match="no more light at level 255"):
        fit_response(LEVELS, [0.01] * len(LEVELS), sd)
    light[-4] *= 0.7
    with pytest.raises(ImageError, match="does not rise with the level"):
        fit_response(LEVELS, light, sd)


def test_a_lamp_that_fades_raises_a_doubt(measured: RadiometryMeasured) -> None:
    faded = replace(measured, sweeps=(replace(measured.sweeps[0], drift=-0.03),), flat=replace(measured.flat, tilt=0.2))
    doubts = " ".join(calibration_of(faded).doubts)
    assert "let the lamp warm up" in doubts
    assert "from side to side" in doubts


def test_a_black_level_that_cuts_the_noise_off_raises_a_doubt(measured: RadiometryMeasured) -> None:
    """Read noise would come out too small, and faint light too bright."""
    first = measured.sweeps[0]
    sunk = replace(first, dark=replace(first.dark, level=first.dark.level * 0.0 + 2.0))
    assert any(
        "raise the camera's black level" in one for one in calibration_of(replace(measured, sweeps=(sunk,))).doubts
    )


@pytest.mark.long
def test_twenty_benches(tmp_path: Path) -> None:
    """Run with -s to see the figures."""
    worst: dict[str, float] = {}
    decades = []
    for seed in range(20):
        bench = random_bench(tmp_path / str(seed), seed)
        try:
            found = measure_radiometry(bench.projector, bench.camera, PLAN, bench.camera.put)
        finally:
            bench.close()
        merged, _ = brackets(bench, radiometry_of(found))
        decades.append(merged.decades)
        steps = {"step between exposures": float(np.abs(merged.steps).max())}
        steps["step, less 3 sd"] = float((np.abs(merged.steps) - 3.0 * np.array(merged.steps_sd)).max())
        for name, value in (errors(bench, found) | steps).items():
            worst[name] = max(worst.get(name, 0.0), value)
    print()
    for name, value in worst.items():
        print(f"{name:24s} worst of 20 benches {100.0 * value:.3f} %")
    print(f"decades of merged brackets, least {min(decades):.1f}")
    assert min(decades) > 4.0
    assert worst["step, less 3 sd"] < 0.003
    assert worst["linearity"] < 0.005
    assert worst["response"] < 0.01
    assert max(worst["dn per e"], worst["read noise"]) < 0.03
