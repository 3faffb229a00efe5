"""The camera says whether the light follows the patterns: before a run, and in `doctor`."""

import json
import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

import drivers.rig
from drivers.rig import load_rig_file, open_light
from tankrig.calibration.witness import BANDS, witness
from tankrig.devices import CameraSettings, Flip, Frame
from tankrig.run.reading import open_run
from tankrig.sequence import ExposureRule
from ui.cli import main

PROJECTED, SEEN = (24, 64), (40, 48)


class Bench:
    """A projector and a camera above murky water: columns of the picture are rows of the frame, blurred."""

    name, shape, saturation = "bench", SEEN, 4095

    def __init__(self, blur_px: float = 0.5, noise: float = 3.0, late: int = 0, gain: float = 3000.0) -> None:
        self.blur_px, self.noise, self.late, self.gain = blur_px, noise, late, gain
        self.shown = [np.zeros(PROJECTED)] * (late + 1)
        self.random = np.random.default_rng(0)
        self.cover = slice(0, 0), 0.0
        self.glass = False
        self.projector = self
        self.count = 0

    def show(self, pattern):
        pixels = pattern.pixels / 255.0
        pixels[:, self.cover[0]] = self.cover[1]
        self.shown.append(pixels)
        now = time.monotonic_ns()
        return Flip(now, now, pattern.hash)

    def configure(self, settings):
        return CameraSettings(settings.exposure_ms)

    def capture(self, after_ns, timeout_s):  # noqa: ARG002
        lit = self.shown[-1 - self.late].mean(axis=0)
        rows = np.interp(np.linspace(0, 1, SEEN[0]), np.linspace(0, 1, lit.size), lit)
        light = gaussian_filter(rows[:, None] * np.exp(-np.arange(SEEN[1]) / 30.0), (self.blur_px, 0.0))
        if self.glass:
            light = self.spread(lit)
        counts = 100.0 + self.gain * light + self.noise * self.random.standard_normal(SEEN)
        self.count += 1
        return Frame(np.clip(counts, 0, 4095).astype(np.uint16), after_ns + 1, after_ns + 1, after_ns + 2, self.count)

    def spread(self, lit):
        """A pinhole's light, ± 1.05 wide at first, between glass walls at ± 1, which send back what comes to them."""
        y, wider = np.linspace(-1.0, 1.0, SEEN[0])[:, None], 1.0 + 0.8 * np.arange(SEEN[1]) / SEEN[1]
        came = [y / wider, (2.0 - y) / wider, (-2.0 - y) / wider]
        return sum(np.interp(place, np.linspace(-1.05, 1.05, lit.size), lit) * (np.abs(place) < 1.0) for place in came)


class Projecting:
    """The projector of a bench, which has another shape than its camera."""

    name, shape = "bench", PROJECTED

    def __init__(self, bench: Bench) -> None:
        self.show = bench.show


def said_by(bench: Bench):
    return witness(Projecting(bench), bench, ExposureRule())


@settings(deadline=None, max_examples=40)
@given(st.floats(0.1, 2.5), st.floats(0.0, 30.0))
def test_light_that_follows_is_seen_to_whatever_blur_and_noise(blur_px, noise):
    assert said_by(Bench(blur_px, noise)).follows is True


@settings(deadline=None, max_examples=40)
@given(st.integers(0, BANDS - 1), st.integers(0, 40), st.floats(0.0, 1.0))
def test_whatever_covers_a_whole_band_is_noticed(band, beyond, level):
    bench = Bench()
    start = band * PROJECTED[1] // BANDS
    bench.cover = slice(start, start + PROJECTED[1] // BANDS + beyond), level
    said = said_by(bench)
    assert said.follows is not True, said


def test_bands_are_told_apart_between_walls_that_mirror_the_outer_ones():
    """In clear water over a bright floor, between walls of glass, half of the lit places see two bands. It was taken
    for a projector that shows something else, and no run began."""
    bench = Bench()
    bench.glass = True
    assert said_by(bench).follows is True


@pytest.mark.parametrize("late", [1, 2, 3])
def test_light_that_follows_late_is_noticed(late):
    assert said_by(Bench(late=late)).follows is not True


def test_water_that_is_too_clear_tells_nothing():
    said = said_by(Bench(gain=20.0))
    assert (said.follows, "too little" in said.finding) == (None, True)


def murky_rig(folder: Path, more: str = "") -> Path:
    """The simulated rig with ink in its water."""
    camera = 'driver = "simulated-camera"\n'
    truth = "truth = { water = { sigma_a = 2e-4, sigma_s = 0.0198, g = 0.5 }, tolerance = 0.05, coarsen = 8 }\n"
    text = drivers.rig.SIMULATED.read_text().replace(camera, camera + truth)
    (folder / "rig.toml").write_text(re.sub(r"^folder = \"simulated\"", more + r"\g<0>", text, flags=re.MULTILINE))
    return folder / "rig.toml"


def test_the_twins_camera_sees_its_projector_follow(tmp_path):
    with open_light(load_rig_file(murky_rig(tmp_path))) as (projector, camera):
        said = witness(projector, camera, ExposureRule())
    assert said.follows is True, said


def test_a_run_begins_with_the_flash_where_the_rig_file_says_so_and_records_nothing_of_it(tmp_path, capsys):
    rig = murky_rig(tmp_path, "flash_before_run = true\n")
    (tmp_path / "one.toml").write_text('name = "one"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 3\n')
    command = ["run", str(tmp_path / "one.toml"), "--rig", str(rig), "--no-fit", "--json", "--out"]
    assert main([*command, str(tmp_path / "run")]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 3
    assert set(open_run(tmp_path / "run").frames.pattern.values.tolist()) == {"full"}
    rig.write_text(rig.read_text().replace("sigma_s = 0.0198", "sigma_s = 1e-9"))
    assert main([*command, str(tmp_path / "dark")]) == 1
    assert re.search(r"asked before the run, it does not see what simulated projector .* shows: .*too little of its "
                     r"light.*; look at both, or leave flash_before_run out", capsys.readouterr().err)  # fmt: skip
    assert not (tmp_path / "dark").exists()
