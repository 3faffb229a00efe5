"""The commands of docs/first_bench.md as a newcomer types them, each in a process of its own."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from shlex import split
from typing import Any

import tomlkit

TREE = Path(__file__).parents[1]
PAGE = TREE / "docs" / "first_bench.md"
_RUN = "import sys\nfrom ui.cli import main\nsys.exit(main())"


def commands_of_the_page() -> list[list[str]]:
    """In the order in which they stand in its blocks."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if line.strip()]
    assert all(line.startswith("tankrig ") for line in lines), lines
    return [split(line)[1:] for line in lines]


def typed(
    words: list[str], folder: Path, timeout_s: float = 600.0, **environment: str
) -> "subprocess.CompletedProcess[str]":
    """A command in a folder, with nobody at the terminal.

    One that does not end in time fails with what it and the processes that it started were doing.
    """
    command = [sys.executable, "-c", _RUN, *words]
    with subprocess.Popen(
        command,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(TREE), "PYTHONFAULTHANDLER": "1"} | environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            said, wrong = process.communicate(timeout=timeout_s)
        except BaseException as error:
            os.killpg(process.pid, signal.SIGABRT)  # each process writes where its threads are, and ends
            if isinstance(error, KeyboardInterrupt):
                raise
            said, wrong = process.communicate(timeout=60.0)
            raise AssertionError(f"{' '.join(words)}: not done in time\n{said}{wrong}") from error
    return subprocess.CompletedProcess(command, process.returncode, said, wrong)


def make_small(folder: Path) -> None:
    """A quarter of the pixels, two doses, one pattern: what models cost is what the short form of the walk leaves out.

    Lenses that blur by parts of a pixel blur twice as many mm with half as many pixels, so that rays are made wider.
    """
    rig: Any = tomlkit.parse((folder / "rig.toml").read_text(encoding="utf-8"))
    camera, projector = [270, 480], [192, 256]
    rig["camera"]["boards"]["camera_shape"] = rig["bench"]["camera"]["shape"] = camera
    rig["camera"]["boards"]["projector_shape"] = rig["projector"]["shape"] = projector
    rig["bench"]["wall"]["shape"] = projector
    (fx, _, _), (_, fy, _), _ = rig["bench"]["camera"]["matrix"]
    middle = (camera[1] - 1) / 2, (camera[0] - 1) / 2
    rig["bench"]["camera"]["matrix"] = [[fx / 2, 0.0, middle[0]], [0.0, fy / 2, middle[1]], [0.0, 0.0, 1.0]]
    (folder / "rig.toml").write_text(tomlkit.dumps(rig), encoding="utf-8")
    sequence: Any = tomlkit.parse((folder / "bench_dilution.toml").read_text(encoding="utf-8"))
    sequence["patterns"]["rays"]["width_mm"] = 10.0
    series = next(step for step in sequence["steps"] if step["do"] == "series")
    series["total_ul"] = series["total_ul"][:2]
    series["steps"] = [step for step in series["steps"] if step.get("pattern") != "stripes"]
    (folder / "bench_dilution.toml").write_text(tomlkit.dumps(sequence), encoding="utf-8")


def found_by(run: Path, rig: Path) -> dict[str, Any]:
    """What a run's journal says of doses and ink, beside the truth of its simulated rig."""
    from drivers.rig import load_rig_file
    from ui.cli.fits import fits_of

    return json.loads(json.dumps(fits_of(run, load_rig_file(rig))))
