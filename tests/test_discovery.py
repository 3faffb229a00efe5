"""`tankrig devices` and `tankrig doctor` say what is there, what is wrong, and what to do about it."""

import json
from pathlib import Path

import pytest

import drivers.health
import drivers.rig
from drivers.calibration_health import KINDS
from drivers.check import Check
from drivers.health import Found, examine, find_devices
from drivers.rig import load_rig_file
from tankrig.errors import DeviceError
from ui.cli import main

from .memory_rig import FileDoser, MemoryCamera, MemoryProjector
from .xserver import PROJECTOR, XServer

EXAMPLE = Path(drivers.rig.__file__).parent / "simulated" / "rig.toml"


@pytest.fixture
def rig_file(tmp_path) -> Path:
    file = tmp_path / "rig.toml"
    file.write_text(EXAMPLE.read_text())
    return file


@pytest.fixture
def devices(tmp_path, monkeypatch):
    """Devices in memory behind any driver's name, which may be replaced by an error."""
    projector = MemoryProjector(shape=(480, 640))
    doser = FileDoser(tmp_path / "count")
    made = {
        "simulated-doser": doser,
        "simulated-projector": projector,
        "simulated-camera": MemoryCamera(projector, doser, shape=(80, 120)),
    }

    def open_device(name, _settings):
        if isinstance(made[name], DeviceError):
            raise made[name]
        return made[name]

    monkeypatch.setattr(drivers.health, "open_device", open_device)
    return made


def by_name(rig_file: Path) -> dict[str, Check]:
    return {check.what: check for check in examine(load_rig_file(rig_file), with_light=False)}


@pytest.mark.usefixtures("devices")
def test_a_fit_rig_passes_every_check(rig_file):
    checks = by_name(rig_file)
    assert len(checks) >= 7
    assert not any(check.passed is False for check in checks.values()), checks
    assert [name for name, check in checks.items() if check.passed is None] == [
        f"{kind} is calibrated" for kind in KINDS
    ]


def test_a_device_that_does_not_open_is_said_with_what_to_do_and_the_others_are_checked(rig_file, devices):
    devices["simulated-camera"] = DeviceError("/dev/video0: may not be opened by this user; run: sudo usermod")
    checks = by_name(rig_file)
    assert checks["camera opens"] == Check(
        "camera opens", False, "/dev/video0: may not be opened by this user", "run: sudo usermod"
    )
    assert checks["projector opens"].passed
    assert checks["projector has the calibrated pixels"].passed


def test_a_projector_with_other_pixels_than_the_bench_is_not_fit(rig_file, devices):
    devices["simulated-projector"].shape = (600, 800)
    check = by_name(rig_file)["projector has the calibrated pixels"]
    assert (check.passed, check.finding) == (False, "[600, 800] (rows, columns), calibrated [480, 640]")


def test_the_command_tells_each_check_and_ends_with_1_when_something_is_to_be_done(rig_file, devices, capsys):
    assert main(["doctor", str(rig_file), "--no-light"]) == 0
    assert "✓ doser opens" in capsys.readouterr().out
    devices["simulated-doser"] = DeviceError("/dev/ttyACM0: is not there; plug the doser in")
    assert main(["doctor", str(rig_file), "--no-light"]) == 1
    assert "✗ doser opens: /dev/ttyACM0: is not there\n    → plug the doser in\n" in capsys.readouterr().out
    assert main(["doctor", str(rig_file), "--no-light", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert not told["fit"]
    assert told["checks"][0]["remedy"] == "plug the doser in"


def test_a_rig_file_that_is_none_is_bad_input(tmp_path, capsys):
    assert main(["doctor", str(tmp_path / "none.toml")]) == 2
    assert "none.toml: cannot be read" in capsys.readouterr().err


def test_screens_are_listed_with_lines_that_a_rig_file_takes(tmp_path, monkeypatch):
    import tomllib

    from drivers.hdmi.settings import HdmiProjectorSettings

    server = XServer(tmp_path)
    try:
        server.identify("SN-0042", "PJ-1000")
        monkeypatch.setenv("DISPLAY", server.display)
        monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
        found = [item for item in find_devices() if isinstance(item, Found) and PROJECTOR in item.what]
    finally:
        server.close()
    assert len(found) == 1
    assert "PJ-1000 SN-0042, 320×240 at 60.00 Hz" in found[0].what
    table = tomllib.loads(found[0].lines)["projector"]
    assert table.pop("driver") == "hdmi-projector"
    assert HdmiProjectorSettings(**table).screen.serial == "SN-0042"


def test_the_command_lists_devices_even_without_a_desktop(monkeypatch, capsys):
    monkeypatch.setenv("DISPLAY", ":999")
    monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
    assert main(["devices"]) == 0
    told = capsys.readouterr().out
    assert "there is no desktop to ask for its screens" in told
    assert "v4l2-camera" in told
    assert main(["devices", "--json"]) == 0
    assert "hdmi-projector" in json.loads(capsys.readouterr().out)["drivers"]
