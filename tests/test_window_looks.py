"""Every page in both themes and three sizes, empty, running, replaying and failed: what is drawn can be read and seen.

TANKRIG_LOOKS names a folder for the pictures, so that a person can look at them, too.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tankrig.scene import Camera, Tank
from tests import recorded_runs as runs
from tests.window_contrast import faint_rings, faint_texts, picture_of, thin_outlines
from tests.window_rig import until, wait_ms, window_on, write_rig
from ui.window.separated import Basis, SeparatedSheet, SheetKey

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200)]

SIZES = ((1024, 700), (1280, 800), (1600, 1000))
FOLDER = os.environ.get("TANKRIG_LOOKS")
TANK, CAMERA = Tank((240.0, 160.0, 120.0)), Camera("orthographic", (80, 120), 2.0)
RUNNING = """name = "two doses, and waves between them"
exposure_ms = 5.0
[patterns.rays]
kind = "rays"
y_mm = [-40.0, 0.0, 40.0]
z_mm = [56.0, 64.0]
width_mm = 8.0
[[steps]]
do = "dose"
total_ul = 100.0
[[steps]]
do = "wait"
seconds = 600.0
[[steps]]
do = "capture"
pattern = "rays"
frames = 4
[[steps]]
do = "separate"
z_mm = [56.0, 64.0]
periods_mm = [16.0, 32.0]
heights_mm = [30.0, 60.0, 90.0]
"""


def sheets() -> list[SeparatedSheet]:
    """Sheets at three heights, as ink of medium density would have them."""
    y, x = np.mgrid[:80, :120] * 2.0
    found = []
    for dose_ml, decay in ((0.1, 0.004), (0.2, 0.012)):
        for z in (30.0, 60.0, 90.0):
            lit = 1.0 / (1.0 + np.exp((np.abs(y - 80.0) - 60.0) / 2.0))
            whole = (400.0 + z) * lit * np.exp(-decay * x) + 60.0 * np.exp(-decay * x / 3)
            part = np.exp(-decay * x * 1.5)
            first = np.where(lit > 0.5, whole * part, np.nan).astype(np.float32)
            images = [one.astype(np.float32) for one in (whole, whole * part**0.8, whole * (1 - part**0.8))]
            found.append(SeparatedSheet(
                SheetKey(dose_ml, z), Basis("x", None), images[0], {16.0: images[1], 32.0: images[1]},
                {16.0: images[2], 32.0: images[2]}, first, first, TANK, CAMERA, {16.0: 0.533, 32.0: 0.61},
                (0.53, 0.007), (decay, 0.02 * decay), (1.01, 0.02),
                ("the ink moved while the waves were shown, by 1.3 %; wait until it has mixed, and separate anew",),
            ))  # fmt: skip
    return found


def nothing(*_: Any, **__: Any) -> None:
    """In place of what the background computes."""


def compared(shown: Any) -> None:
    """A photograph beside the model's picture, as the background would bring it."""
    from types import SimpleNamespace

    from ui.window.jobs import Comparison, Found

    y, x = np.mgrid[:80, :120] * 2.0
    image = 900.0 * np.exp(-x / 80.0 - ((y - 80.0) / 30.0) ** 2)
    noise = np.random.default_rng(1).normal(0.0, 9.0, image.shape)
    fits = tuple(shown.by_dose)
    photographs = tuple(SimpleNamespace(pattern=runs.PATTERN, dose_ml=one.dose_ml, offset=0.0) for one in fits)
    shown.take_found(Found(fits, shown.series, photographs))
    rmse = {"1": 0.41, "1–3": 0.12, "1–20": 0.02, "all": 0.006, "single": 0.05}
    key = shown.chosen
    one = Comparison(key.pattern, key.dose_ml, image + noise, image, noise, rmse, TANK, CAMERA)
    shown.take_comparison(key, shown.fit_of(key), one)


def empty(window: Any) -> None:
    """As a person meets it."""


def running(window: Any) -> None:
    """A run goes on, and the first dose was fitted."""
    (window.home / "running.toml").write_text(RUNNING)
    window.sequence.load(window.home / "running.toml")
    until(lambda: window.top.run.isEnabled(), 60.0)
    window.run()
    until(lambda: window.status.running and window.status.progress.step == 1, 60.0)
    window.background.run = nothing  # of what was made up nothing is computed
    live = window.on_screen.shown
    other = runs.recorded(window.home / "elsewhere", 2)
    from tankrig.run.reading import open_run

    for event in open_run(other).events("fit"):
        live.take(event)
    live.take_separated(sheets())


def replaying(window: Any) -> None:
    """A run with fits, separated sheets and a region."""
    window.show_run(window.folder / "run-a")
    shown = window.on_screen.shown
    until(lambda: shown.reading is not None)
    until(lambda: window.background.waiting == 0, 60.0)
    window.background.run = nothing  # of what was made up nothing is computed
    compared(shown)
    shown.take_separated(sheets())
    window.live.regions.add()


def failed(window: Any) -> None:
    """The rig cannot be used, and the sequence is wrong."""
    (window.home / "wrong.toml").write_text('name = "x"\n[[steps]]\ndo = "capture"\npattern = "full"\nframes = 0\n')
    window.sequence.load(window.home / "wrong.toml")
    rig = Path(window.home / "rig.toml")
    broken = window.home / "broken.toml"
    broken.write_text(rig.read_text().replace('driver = "simulated-doser"', 'driver = "no-such-doser"'))
    window.use_rig(broken)
    until(lambda: window.status.state.value == "failed" or window.status.trouble, 60.0)


@pytest.mark.parametrize("state", [empty, running, replaying, failed])
def test_every_page_can_be_read_and_seen(tmp_path: Path, state: Callable[[Any], None]) -> None:
    """Text 4.5 to 1, outlines and the keyboard's place 3 to 1, in the pixels that are drawn."""
    if state is not empty:
        for name, doses in (("a", 3), ("b", 2)):
            runs.recorded(tmp_path / "runs" / f"run-{name}", doses, "completed" if name == "a" else "aborted")
    wrong: list[Any] = []
    looked = 0
    with window_on(tmp_path, write_rig(tmp_path)) as window:
        window.home = tmp_path
        until(lambda: window.status.state.value == "ready" and window.live.displayed, 60.0)
        state(window)
        for theme in ("dark", "light"):
            window.set_theme(theme)
            for size in SIZES:
                window.resize(*size)
                for title, page in window.docks.pages():
                    window.show_page(page)
                    window.setFocus()
                    wait_ms(350)
                    picture = picture_of(window)
                    assert picture.shape[1::-1] == size, "the window does not fit the screen"
                    where = f"{state.__name__}, {theme}, {size[0]} × {size[1]}, {title}"
                    found = [faint_texts(window, picture), thin_outlines(window, picture)]
                    if size == SIZES[0]:
                        found.append(faint_rings(window, page))
                    looked += sum(count for count, _ in found)
                    wrong += [(where, *one) for _, several in found for one in several]
                    if FOLDER:
                        name = f"{state.__name__}-{theme}-{size[0]}-{title}.png"
                        cv2.imwrite(str(Path(FOLDER) / name), picture[..., ::-1])
        window.set_theme("dark")
        if window.status.busy:
            window.stop()
            until(lambda: not window.status.busy, 60.0)
    print(f"\n{state.__name__}: {looked} texts, outlines and places of the keyboard")
    assert looked > 1000
    assert not wrong, "\n".join(map(str, wrong))
