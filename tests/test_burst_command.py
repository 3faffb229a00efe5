"""`tankrig run` of a sequence with bursts, on the simulated rig with a LightCrafter and a triggered camera."""

import json

import cv2
import numpy as np
import pytest

import tankrig
from drivers.lightcrafter4500.flash import picture_of
from drivers.registry import driver_names
from drivers.rig import SIMULATED, load_rig_file, open_rig
from tankrig.sequence import load_sequence
from ui.cli import main

pytestmark = pytest.mark.skipif(
    "simulated-lightcrafter" not in driver_names(), reason="the environment was set up before that driver was there"
)

ACROSS_MM = (-60.0, -36.0, -12.0, 12.0, 36.0, 60.0)
NAMES = [f"ray{number}" for number in range(6)]
ORDER = [0, 1, 2, 1, 0, 2, 5, 4, 3, 3, 5, 4]
"""Patterns 0 to 2 are in the first picture of flash, 3 to 5 in the second."""
TIMES = 10
RIG = """
[camera.truth]
tolerance = 0.02
water = { sigma_a = 0.0005, sigma_s = 0.01, g = 0.5 }
[camera.truth.bench]
light = "collimated"
tank = { size_mm = [240.0, 160.0, 120.0] }
wall = { shape = [120, 160], y_mm = [-80.0, 80.0], z_mm = [0.0, 120.0] }
camera = { kind = "orthographic", shape = [20, 30], pixel_mm = 8.0 }
"""
SEQUENCE = f"""
name = "bursts"
exposure_ms = 8.6
steps = [
    {{ do = "capture", pattern = "ray5" }},
    {{ do = "burst", patterns = {json.dumps([NAMES[number] for number in ORDER])}, times = {TIMES} }},
    {{ do = "capture", pattern = "ray0" }},
]
""" + "".join(
    f'[patterns.{name}]\nkind = "sheet"\ny_mm = [{y_mm - 4.0}, {y_mm + 4.0}]\nz_mm = [40.0, 80.0]\n'
    for name, y_mm in zip(NAMES, ACROSS_MM, strict=True)
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A rig file, a sequence, and the pictures in the LightCrafter's flash."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("TANKRIG_RIG", raising=False)
    rig = SIMULATED.read_text()
    for old, new in (
        ('driver = "simulated-projector"', 'driver = "simulated-lightcrafter"\nflash = "./flash"\nshape = [120, 160]'),
        ('driver = "simulated-camera"', 'driver = "simulated-camera"\nmost_per_s = 150.0'),
        ("shape = [480, 640]              # rows", "shape = [120, 160]              # rows"),
        ("shape = [80, 120]\npixel_mm = 2.0", "shape = [20, 30]\npixel_mm = 8.0"),
    ):
        assert old in rig
        rig = rig.replace(old, new)
    (tmp_path / "rig.toml").write_text(rig + RIG)
    (tmp_path / "bursts.toml").write_text(SEQUENCE)
    drawn = load_sequence(tmp_path / "bursts.toml").drawn(load_rig_file(tmp_path / "rig.toml").bench.wall)
    (tmp_path / "flash").mkdir()
    for image in range(2):
        names = NAMES[3 * image : 3 * image + 3]
        cv2.imwrite(str(tmp_path / "flash" / f"{image}.png"), picture_of([drawn[name] for name in names]))
    return tmp_path


def brightest(frame) -> int:
    """Number of the ray that a frame shows: that whose row of pixels is brightest."""
    row = int(frame[:, :6].astype(float).sum(axis=1).argmax())
    return int(np.abs(np.array(ACROSS_MM) - (8.0 * row + 4.0 - 80.0)).argmin())


def test_a_sequence_takes_more_than_100_patterns_a_second_and_pairs_each_with_its_frame(capsys):
    assert main(["run", "bursts.toml", "--rig", "rig.toml", "--out", "run", "--json", "--no-fit"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["frames"] == 2 + len(ORDER) * TIMES
    run = tankrig.open_run("run")
    names = run.frames.pattern.values.tolist()
    assert names == ["ray5", *[NAMES[number] for number in ORDER] * TIMES, "ray0"]
    shown = [NAMES[brightest(frame)] for frame in run.frames.values]
    assert shown == names
    events = [event for event in run.events("frame") if event["step"] == 1]
    starts_ns = [event["exposure_start_ns"] for event in events]
    per_s = [
        (len(ORDER) - 1) * 1e9 / (starts_ns[at + len(ORDER) - 1] - starts_ns[at])
        for at in range(0, len(starts_ns), len(ORDER))
    ]
    print(
        f"{min(per_s):.1f} to {max(per_s):.1f} patterns/s, {sum(a != b for a, b in zip(shown, names, strict=True))}"
        f" of {len(names)} mispaired"
    )
    assert min(per_s) >= 100.0
    assert {event["exposure_ms"] for event in events} == {8.4}, "the light says for how long"


def test_a_burst_that_loses_frames_is_taken_again(folder):
    rig = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(
        rig.replace("most_per_s = 150.0", "most_per_s = 150.0\nfaults = { dropped = 0.02 }")
    )
    assert main(["run", "bursts.toml", "--rig", "rig.toml", "--out", "run", "--json", "--no-fit"]) == 0
    run = tankrig.open_run("run")
    assert [NAMES[brightest(frame)] for frame in run.frames.values] == run.frames.pattern.values.tolist()
    assert any("a burst is taken again" in event.get("text", "") for event in run.events("note"))


def test_what_is_not_in_flash_is_refused_before_anything_moves(folder, capsys):
    (folder / "bursts.toml").write_text(SEQUENCE.replace('"burst", patterns = ["ray0"', '"burst", patterns = ["full"'))
    assert main(["run", "bursts.toml", "--rig", "rig.toml", "--out", "run", "--no-fit"]) in (1, 2)
    assert 'pattern "full" is in none of its pictures' in capsys.readouterr().err
    assert not (folder / "run").exists()


def test_a_rig_without_triggers_refuses_bursts_in_a_sentence(capsys):
    assert main(["run", "bursts.toml", "--out", "run", "--no-fit"]) == 2
    assert "take no bursts, since one of them has no trigger; write capture steps" in capsys.readouterr().err


def test_doctor_and_devices_know_it(capsys):
    main(["doctor", "rig.toml", "--no-light"])
    assert "projector opens" in capsys.readouterr().out


def test_the_rig_opens_by_the_rig_file(folder):
    rig = open_rig(load_rig_file(folder / "rig.toml"))
    try:
        assert rig.projector.name.startswith("LightCrafter 4500")
    finally:
        rig.close()
