"""Drivers that others install: found, used, unable to take the rest with them; and the page on how to write one."""

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import drivers.rig
from drivers.health import find_devices
from drivers.registry import driver_names, open_device
from tankrig.errors import DeviceError
from tankrig.run.reading import open_run
from ui.cli import main

PAGE = Path(__file__).parent.parent / "docs" / "write_a_driver.md"
PACKAGES = ("drawn_camera", "drawn_camera_health", "broken")


def files_of_the_page() -> dict[str, str]:
    """The files that docs/write_a_driver.md has one make: fenced blocks whose first line is a comment with the name."""
    return dict(re.findall(r"```(?:toml|python)\n# (\S+)\n(.*?)```", PAGE.read_text(), re.DOTALL))


@pytest.fixture
def site(tmp_path, monkeypatch) -> Path:
    """A folder of installed packages."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    yield folder
    for name in PACKAGES:
        sys.modules.pop(name, None)


def install(site: Path, name: str, drivers: dict[str, str], health: dict[str, str], modules: dict[str, str]) -> None:
    """What pip leaves of a package."""
    info = site / f"{name.replace('-', '_')}-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1\n")
    groups = {"tankrig.drivers": drivers, "tankrig.health": health}
    (info / "entry_points.txt").write_text(
        "".join(f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in them.items()) for group, them in groups.items())
    )
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)
    importlib.invalidate_caches()


def install_the_pages(site: Path) -> None:
    import tomllib

    files = files_of_the_page()
    points = tomllib.loads(files["pyproject.toml"])["project"]["entry-points"]
    modules = {path.removesuffix(".py"): text for path, text in files.items() if path.startswith("drawn_")}
    install(site, "drawn-camera", points["tankrig.drivers"], points["tankrig.health"], modules)


BROKEN = {
    "its module is missing": ("nowhere", None, "ModuleNotFoundError: No module named 'nowhere'"),
    "its module ends the program": (
        "broken",
        "import sys\nsys.exit('no licence found')",
        "SystemExit: no licence found",
    ),
    "its module is no Python": ("broken", "def", "SyntaxError"),
    "its module divides by zero": ("broken", "1 / 0", "ZeroDivisionError"),
    "its entry point is no name": ("broken module!", "", "cannot be loaded from broken module!"),
    "it has no such function": ("broken:missing.part", "", "AttributeError"),
    "it looks and falls": ("broken", "def find():\n    yield from ()\n    raise KeyError('id')", "KeyError: 'id'"),
    "it cannot be looked with": ("broken", "x = 1", "AttributeError"),
    "it ends the program while looking": ("broken", "def find():\n    raise SystemExit(4)", "SystemExit: 4"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_plug_in_is_one_row_with_its_reason_and_all_others_are_asked(site, case, capsys, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":999")
    value, text, reason = BROKEN[case]
    install(site, "labs-own", {}, {"aaa-first": value}, {"broken": text} if text is not None else {})
    install_the_pages(site)
    assert main(["devices"]) == 0
    told = capsys.readouterr().out
    rows = [line for line in told.splitlines() if "aaa-first" in line]
    assert len(rows) == 1
    assert reason in rows[0]
    assert "camera that draws its pictures" in told, "a driver after the broken one was not asked"
    assert 'driver = "drawn-camera"' in told


@pytest.mark.parametrize("case", [case for case in BROKEN if "look" not in case])
def test_a_broken_driver_is_named_where_devices_are_listed_and_where_it_is_opened(site, case, capsys, tmp_path):
    value, text, reason = BROKEN[case]
    install(site, "labs-own", {"labs-camera": value}, {}, {"broken": text} if text is not None else {})
    rows = [str(item) for item in find_devices() if "labs-camera" in str(item)]
    assert len(rows) == 1
    assert reason in rows[0]
    assert "of labs-own" in rows[0]
    rig = rig_file(tmp_path, 'driver = "labs-camera"')
    assert main(["doctor", str(rig), "--no-light"]) == 1
    told = capsys.readouterr().out
    assert re.search(rf"✗ camera opens: .*{re.escape(reason)}", told)
    assert "✓ projector opens" in told


def test_checks_that_fall_are_a_failed_check_and_the_rest_goes_on(site, tmp_path, capsys):
    text = files_of_the_page()["drawn_camera.py"]
    install(
        site, "labs-own", {"labs-camera": "drawn_camera:open_drawn_camera"}, {"labs-camera": "broken"},
        {"drawn_camera": text, "broken": "def checks(settings, device):\n    raise OSError('no such bus')"},
    )  # fmt: skip
    assert main(["doctor", str(rig_file(tmp_path, 'driver = "labs-camera"')), "--no-light"]) == 1
    told = capsys.readouterr().out
    assert "✗ labs-camera checks its own device:" in told
    assert "OSError: no such bus" in told
    assert "✓ camera has the calibrated pixels" in told


def test_a_driver_that_falls_while_opening_says_whose_it_is(site):
    install(site, "labs-own", {"labs-camera": "broken:open"}, {}, {"broken": "def open(s):\n    raise SystemExit(1)"})
    with pytest.raises(DeviceError, match=r'driver "labs-camera": could not open its device \(SystemExit: 1\)'):
        open_device("labs-camera", {})


def test_a_name_that_two_packages_have_is_refused_rather_than_guessed(site):
    install(site, "labs-own", {"v4l2-camera": "broken:open"}, {}, {"broken": "open = print"})
    with pytest.raises(DeviceError, match=r'driver "v4l2-camera": is installed by labs-own and tankrig'):
        open_device("v4l2-camera", {})


def rig_file(folder: Path, camera: str) -> Path:
    """The simulated rig with another camera."""
    text = drivers.rig.SIMULATED.read_text()
    text = re.sub(r'driver = "simulated-camera"\nfolder = [^\n]*', camera, text)
    (folder / "rig.toml").write_text(text)
    return folder / "rig.toml"


def test_the_pages_camera_is_listed_checked_and_used_in_a_run(site, tmp_path, capsys):
    install_the_pages(site)
    assert "drawn-camera" in driver_names()
    rig = rig_file(tmp_path, 'driver = "drawn-camera"\nshape = [80, 120]\nlevel = 700')
    assert main(["doctor", str(rig), "--no-light"]) == 0
    assert "✓ drawn camera is not saturated: level 700" in capsys.readouterr().out
    sequence = tmp_path / "sequence.toml"
    sequence.write_text('name = "two"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 2\n')
    assert main(["run", str(sequence), "--rig", str(rig), "--out", str(tmp_path / "run"), "--no-fit", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == 2
    assert float(open_run(tmp_path / "run").frames.mean()) == pytest.approx(700.0, abs=2.0)
    main(["devices", "--json"])
    listed = json.loads(capsys.readouterr().out)
    assert any("draws its pictures" in item.get("what", "") for item in listed["found"])
    assert "drawn-camera" in listed["drivers"]


def suite_of_the_page(folder: Path, camera: str | None = None) -> subprocess.CompletedProcess:
    """What the page's test says of its camera, or of `camera`."""
    files = files_of_the_page()
    for name, text in (files | ({"drawn_camera.py": camera} if camera else {})).items():
        (folder / name).write_text(text)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(folder), str(folder)]
    environment = {**os.environ, "PYTHONPATH": str(PAGE.parent.parent)}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120.0)


def test_the_pages_camera_passes_the_installed_contract(tmp_path):
    done = suite_of_the_page(tmp_path)
    assert done.returncode == 0, done.stdout
    assert re.search(r"1[5-9] passed", done.stdout), done.stdout


def test_a_camera_with_old_frames_fails_the_installed_contract_and_the_numbers_are_shown(tmp_path):
    good = files_of_the_page()["drawn_camera.py"]
    stale = good.replace("max(time.monotonic_ns(), after_ns + 1)", "time.monotonic_ns() - 1")
    assert stale != good
    done = suite_of_the_page(tmp_path, stale)
    assert done.returncode == 1, done.stdout
    assert "test_a_time_to_come_is_waited_for" in done.stdout
    assert re.search(r"assert \d+ > \d+", done.stdout), "its assertions were not rewritten"
