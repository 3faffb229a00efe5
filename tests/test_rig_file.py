"""A rig file opens the devices it names, or says in one sentence why not, and leaves none of them open."""

import re
from pathlib import Path

import pytest

import drivers.rig
from drivers.rig import load_rig_file, open_rig
from tankrig import DeviceError, SceneError, StoreError

from .memory_rig import FileDoser, MemoryCamera, MemoryProjector

EXAMPLE = Path(drivers.rig.__file__).parent / "simulated" / "rig.toml"


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """Devices in memory behind any driver's name; the list of those that were opened."""
    devices = []

    def open_device(name: str, settings: dict):
        projector = next((device for device in devices if isinstance(device, MemoryProjector)), None)
        made = {
            "simulated-doser": lambda: FileDoser(tmp_path / "count"),
            "simulated-projector": lambda: MemoryProjector(shape=(480, 640)),
            "simulated-camera": lambda: MemoryCamera(projector, devices[0], shape=(80, 120)),
        }[name]()
        made.settings, made.closings = settings, 0
        close = made.close

        def counted():
            made.closings += 1
            close()

        made.close = counted
        devices.append(made)
        return made

    monkeypatch.setattr(drivers.rig, "open_device", open_device)
    return devices


def example(folder: Path, *changes: tuple[str, str]) -> Path:
    text = EXAMPLE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "rig.toml"
    file.write_text(text)
    return file


def test_the_example_opens_its_three_devices_and_keeps_a_second_program_off(tmp_path, opened):
    description = load_rig_file(example(tmp_path))
    rig = open_rig(description)
    assert rig.name == "simulated rig"
    assert (rig.limits.dose_ul, rig.pace.mixing_s, rig.bench.wall.shape) == (1000.0, 10.0, (480, 640))
    assert rig.ledger == tmp_path / "simulated" / "tank.ledger"
    doser = {"folder": str(tmp_path / "simulated" / "tank"), "steps_per_ul": 10.0}
    assert doser in [device.settings for device in opened]
    with pytest.raises(StoreError, match="rig simulated rig is in use by another program"):
        open_rig(description)
    rig.close()
    assert [device.closings for device in opened] == [1, 1, 1]
    open_rig(description).close()


def test_a_new_folder_is_a_simulated_tank_of_clear_water(tmp_path, opened):
    open_rig(drivers.rig.simulated_rig(tmp_path / "a")).close()
    assert opened[0].settings["folder"] == str(tmp_path / "a" / "simulated" / "tank")
    assert (tmp_path / "a" / "simulated" / "rig.lock").exists()


def test_a_device_that_does_not_open_leaves_none_open(tmp_path, opened, monkeypatch):
    description = load_rig_file(example(tmp_path))
    real = drivers.rig.open_device

    def failing(name, settings):
        if name == "simulated-camera":
            raise DeviceError("camera: not found; plug it in")
        return real(name, settings)

    monkeypatch.setattr(drivers.rig, "open_device", failing)
    with pytest.raises(DeviceError, match="plug it in"):
        open_rig(description)
    assert [device.closings for device in opened] == [1, 1]
    monkeypatch.setattr(drivers.rig, "open_device", real)
    open_rig(description).close()


def test_a_device_that_is_not_the_calibrated_one_is_refused(tmp_path, opened):
    description = load_rig_file(example(tmp_path, ("shape = [80, 120]", "shape = [60, 120]")))
    with pytest.raises(DeviceError, match=r"has \[80, 120\] pixels .* calibrated with \[60, 120\]; calibrate it anew"):
        open_rig(description)
    assert [device.closings for device in opened] == [1, 1, 1]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (('driver = "simulated-camera"', ""), 'key "camera.driver" is missing'),
        (("dose_ul = 1000.0", "dose_ul = -1.0"), "limits"),
        (("dose_ul = 1000.0", "dosis_ul = 1.0"), 'key "limits.dosis_ul" is unknown; did you mean "dose_ul"?'),
        (("pixel_mm = 2.0", "pixel = 2.0"), 'key "bench.camera.pixel" is unknown; did you mean "pixel_mm"?'),
        (('"collimated"', '"laser"'), 'bench.light = "laser" is unknown; use "collimated", "pinhole" or "calibrated"'),
        (("gamma = 1.0", "gamma = 0.0"), "gamma = 0.0 is not positive"),
        (("mixing_s = 10.0", "mixing = 10.0"), 'key "pace.mixing" is unknown; did you mean "mixing_s"?'),
        (('light = "collimated"', 'light = "pinhole"'), "light_position_mm is missing; a pinhole needs [x, y, z]"),
        (('name = "simulated rig"', ""), 'key "name" is missing'),
    ],
)
def test_what_is_wrong_in_a_rig_file_is_said_in_one_sentence(tmp_path, change, reason):
    file = example(tmp_path, change)
    with pytest.raises(SceneError, match=re.escape(reason)) as caught:
        load_rig_file(file)
    assert str(caught.value).startswith(str(file))


def test_a_face_that_reflects_as_much_as_nobody_says_is_refused(tmp_path):
    """It was black, and whoever had forgotten the key saw nothing of that."""
    file = example(tmp_path, ('surface = "matched"', 'surface = "matched"\nfaces = { floor = { kind = "diffuse" } }'))
    with pytest.raises(SceneError, match=r'key "bench.tank.faces.floor.reflectance" is missing; add it'):
        load_rig_file(file)
