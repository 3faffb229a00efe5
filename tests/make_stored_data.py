"""Makes what an experiment leaves on disk, as the code of its day writes it: `python tests/make_stored_data.py FOLDER`.

tests/data/stored holds what earlier versions made; test_stored_data.py opens, resumes, refits and reports all of it.
A version that writes something new adds a folder there and changes none.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from drivers.rig import SIMULATED

SMALL = """
[camera.truth]
tolerance = 0.02
mixing_s = 0.1
[camera.truth.bench]
light = "collimated"
tank = { size_mm = [240.0, 160.0, 120.0] }
wall = { shape = [60, 80], y_mm = [-80.0, 80.0], z_mm = [0.0, 120.0] }
camera = { kind = "orthographic", shape = [20, 30], pixel_mm = 8.0 }
"""
SEQUENCE = """
name = "stored"
exposure_ms = 8.0
[patterns.rays]
kind = "rays"
y_mm = [-40.0, 0.0, 40.0]
width_mm = 8.0
z_mm = [54.0, 66.0]
[[steps]]
do = "note"
text = "filled"
[[steps]]
do = "capture"
pattern = "rays"
frames = 2
[[steps]]
do = "series"
total_ul = [200.0, 900.0]
steps = [
    { do = "mix", pattern = "rays", tolerance = 0.05, every_s = 0.02, at_least_s = 0.2 },
    { do = "capture", pattern = "dark" },
    { do = "capture", pattern = "rays", frames = 2 },
    { do = "wait", seconds = 3.0 },
]
"""


def command(*words: str) -> list[str]:
    return [sys.executable, "-c", "import sys; from ui.cli import main; sys.exit(main())", *words]


def tankrig(folder: Path, *words: str) -> None:
    subprocess.run(command(*words), cwd=folder, check=True)


def rig(folder: Path) -> None:
    """A small simulated rig, all of which lies in `folder`."""
    folder.mkdir(parents=True)
    text = SIMULATED.read_text(encoding="utf-8")
    text = text.replace("shape = [80, 120]\npixel_mm = 2.0", "shape = [20, 30]\npixel_mm = 8.0")
    text = text.replace("shape = [480, 640]", "shape = [60, 80]")
    text = text.replace('driver = "simulated-projector"', 'driver = "simulated-projector"\nshape = [60, 80]')
    (folder / "rig.toml").write_text(text + SMALL, encoding="utf-8")
    (folder / "sequence.toml").write_text(SEQUENCE, encoding="utf-8")


def killed(folder: Path, at: bytes, later_s: float) -> None:
    """A run whose program is killed some time after `at` has come into its journal."""
    with (folder / "log").open("wb") as log:
        program = subprocess.Popen(
            command("run", "sequence.toml", "--rig", "rig.toml", "--out", "run", "--no-fit"), cwd=folder, stderr=log
        )
        journal = folder / "run" / "journal.jsonl"
        while not journal.exists() or at not in journal.read_bytes():
            assert program.poll() is None, (folder / "log").read_text()
            time.sleep(0.002)
        time.sleep(later_s)
        program.send_signal(signal.SIGKILL)
        program.wait()
    (folder / "log").unlink()


def count_files(folder: Path) -> None:
    """Of a pump that rests, and of one whose program was killed in a dose that nobody knows the end of."""
    from contextlib import suppress

    from tankrig.errors import DeviceError
    from tests.doser_bench import NewEraBench

    for name, fault in (("at-rest", {}), ("unsure", {"reset_after": 200})):
        (folder / name).mkdir(parents=True)
        with NewEraBench(folder / name, counter_survives=False) as bench:
            doser = bench.open()
            doser.dose_to(25.0)
            bench.faults(**fault)
            with suppress(DeviceError):
                doser.dose_to(50.0)
        for file in (folder / name).iterdir():
            if file.name != "count":
                file.unlink()


def prepared_model(folder: Path) -> None:
    """The smallest there is."""
    import tankrig
    from tankrig.light.prepared.box import Box

    os.environ["TANKRIG_CACHE"] = str(folder)
    projector = tankrig.scene.Projector("collimated", (tankrig.scene.Beam((-20.0, -4.0), (58.0, 62.0)),))
    camera = tankrig.scene.Camera("orthographic", (10, 15), 16.0)
    scene = tankrig.scene.Scene(tankrig.scene.Tank(), tankrig.scene.Medium(0.0004, 0.005, 0.45), projector, camera)
    tankrig.prepare(scene, 0.05, box=Box((0.0045, 0.006), (0.9, 0.95), (0.4, 0.5)))


def main(out: Path) -> None:
    count_files(out / "count-files")
    prepared_model(out / "cache")
    for name in ("finished", "in-a-wait", "in-a-dose"):
        rig(out / name)
    tankrig(out / "finished", "run", "sequence.toml", "--rig", "rig.toml", "--out", "run")
    killed(out / "in-a-wait", b'"total_ul":200', 3.0)
    killed(out / "in-a-dose", b'"total_ul":900', 0.3)
    time.sleep(4.0)  # the doser's watchdog
    subprocess.run(["pkill", "-f", "drivers.rig_doser.emulator.*" + str(out)], check=False)
    for rubbish in (*out.rglob("emulator.log"), *out.rglob("rig.lock"), *out.rglob("doser"), *out.rglob("report.html")):
        rubbish.unlink(missing_ok=True)


if __name__ == "__main__":
    os.environ.pop("TANKRIG_RIG", None)
    main(Path(sys.argv[1]).absolute())
