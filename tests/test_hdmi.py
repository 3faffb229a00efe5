"""The projector's window on a real X server: the right pixels on the right screen at known times, or a refusal."""

import subprocess
import threading
import time

import numpy as np
import psutil
import pytest

from drivers.hdmi.projector import HdmiProjector
from drivers.hdmi.settings import HdmiProjectorSettings
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern
from tankrig.testing.projector import ProjectorContract, plain

from .xserver import OPERATOR, PROJECTOR, XServer, until

SHAPE = (240, 320)
PERIOD_NS = 1_000_000_000 // 60


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = XServer(tmp_path_factory.mktemp("x"))
    yield server
    server.close()


@pytest.fixture(autouse=True)
def desktop(server, monkeypatch):
    """This test's desktop is the X server's."""
    server.plug_in()
    monkeypatch.setenv("DISPLAY", server.display)
    monkeypatch.setenv("QT_QPA_PLATFORM", "xcb")
    monkeypatch.setenv("vblank_mode", "0")  # Mesa's made-up refreshes of a screen that has none
    return server


class Steady:
    """A virtual screen swaps at once; this swaps at its next refresh, as one with a vertical synchronisation does.

    While the intervals are measured it is as steady as a screen's own clock, whatever else this computer does.
    """

    def __init__(self) -> None:
        self.swaps = 0

    def __call__(self, swapped_ns: int) -> int:
        self.swaps += 1
        if self.swaps <= 41:
            return self.swaps * PERIOD_NS
        on_output_ns = (swapped_ns // PERIOD_NS + 1) * PERIOD_NS
        time.sleep(max(0, on_output_ns - time.monotonic_ns()) / 1e9)
        return on_output_ns


def settings(**changes):
    screen = {"output": PROJECTOR}
    return HdmiProjectorSettings(
        **{"screen": screen, "shape": SHAPE, "refresh_hz": 60.0, "latency_ms": 30.0, "timeout_s": 5.0, **changes}
    )


@pytest.fixture
def reopen():
    opened = []

    def open_again(swap_clock=None, **changes):
        opened.append(HdmiProjector(settings(**changes), swap_clock or Steady()))
        return opened[-1]

    yield open_again
    for projector in opened:
        projector.close()


@pytest.fixture
def projector(reopen):
    return reopen()


def projected(server) -> np.ndarray:
    return server.seen(800, 0, 320, 240)


def operators(server) -> np.ndarray:
    return server.seen(0, 0, 800, 600)


class TestHdmiProjector(ProjectorContract):
    pass


def checkerboard() -> np.ndarray:
    return (np.indices(SHAPE).sum(axis=0) % 2 * 255).astype(np.uint8)


def pictures() -> dict[str, np.ndarray]:
    row, column = np.indices(SHAPE)
    gray = column ^ (column >> 1)
    return {
        "checkerboard": checkerboard(),
        "columns": (column % 2 * 255).astype(np.uint8),
        "rows": (row % 2 * 255).astype(np.uint8),
        **{f"Gray code {bit}": ((gray >> bit & 1) * 255).astype(np.uint8) for bit in range(9)},
        "all levels": ((row * 320 + column) % 256).astype(np.uint8),
    }


def test_not_one_pixel_differs_on_the_projector_and_none_changes_on_the_operators_screen(desktop, projector):
    before = operators(desktop)
    for name, pixels in pictures().items():
        projector.show(Pattern(name, pixels))
        differing = int((projected(desktop) != pixels[..., None]).any(axis=2).sum())
        assert differing == 0, f"{name}: {differing} pixels differ"
        np.testing.assert_array_equal(operators(desktop), before)


def test_the_response_curve_is_applied_per_channel_where_the_picture_is_shown(desktop, reopen, tmp_path):
    levels = np.arange(256)
    curve = np.stack([levels // 2, 255 - levels, np.round(255 * (levels / 255) ** (1 / 2.2)).astype(int)], axis=1)
    np.savetxt(tmp_path / "response.txt", curve, fmt="%d")
    pixels = pictures()["all levels"]
    reopen(response=tmp_path / "response.txt").show(Pattern("all levels", pixels))
    np.testing.assert_array_equal(projected(desktop), curve[pixels])


def test_unplugged_the_window_hides_instead_of_jumping_and_the_projector_says_so(desktop, projector):
    before = operators(desktop)
    projector.show(Pattern("checkerboard", checkerboard()))
    projector.confirm()
    desktop.unplug()
    with pytest.raises(DeviceError, match=r"projector output DUMMY1: its screen is gone; connect the projector"):
        until(lambda: projector.confirm() is not None)
    with pytest.raises(DeviceError, match="its screen is gone"):
        projector.show(plain(projector, 0))
    np.testing.assert_array_equal(operators(desktop), before)


def test_unplugged_while_a_series_is_shown_it_ends_in_time(desktop, projector):
    threading.Timer(0.3, desktop.unplug).start()
    with pytest.raises(DeviceError, match="its screen is gone"):
        until(lambda: projector.show(plain(projector, 255)) is None)


def test_another_mode_of_its_screen_ends_it(desktop, projector):
    desktop.xrandr("--addmode", PROJECTOR, "800x600")
    desktop.xrandr("--output", PROJECTOR, "--mode", "800x600")
    with pytest.raises(DeviceError, match=r"its video mode changed|its screen is gone|its window was moved"):
        until(lambda: projector.confirm() is not None)


def test_a_screen_is_found_by_what_it_says_of_itself(desktop, reopen):
    desktop.identify("SN-0042", "PJ-1000")
    found = reopen(screen={"serial": "SN-0042", "model": "PJ-1000"})
    found.show(Pattern("checkerboard", checkerboard()))
    assert (projected(desktop) == checkerboard()[..., None]).all()
    with pytest.raises(DeviceError, match=r"projector serial SN-0043: is not connected; name one of .*SN-0042"):
        reopen(screen={"serial": "SN-0043"})


def test_an_output_that_the_x_server_scales_is_refused(reopen, tmp_path, monkeypatch):
    """The dummy driver cannot scale, so xrandr tells of it in its place."""
    told = """DUMMY1 connected 320x240+800+0 (0x4a) normal (normal left)
      640x480 (0x4a) 25.175MHz -HSync *current
            h: width   640 start  656 end  752 total  800 skew    0 clock  31.47KHz
            v: height  480 start  490 end  492 total  525           clock  59.94Hz
    """
    (tmp_path / "xrandr").write_text(f"#!/bin/sh\ncat <<END\n{told}\nEND\n")
    (tmp_path / "xrandr").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(
        DeviceError, match=r"is in a mode of \[480, 640\] pixels .* says \[240, 320\]; set that mode, unscaled"
    ):
        reopen()


def test_a_desktop_that_scales_is_refused(reopen, monkeypatch):
    monkeypatch.setenv("QT_SCALE_FACTOR", "2")
    with pytest.raises(DeviceError, match="the desktop scales it by 2; set its scale to 100 %"):
        reopen()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"screen": {"output": "HDMI-9"}}, f"projector output HDMI-9: is not connected; name one of {OPERATOR}"),
        ({"screen": {}}, "could be several screens"),
        ({"shape": (600, 800)}, r"is in a mode of \[240, 320\] pixels .* and the rig file says \[600, 800\]"),
        ({"refresh_hz": 50.0}, r"refreshes at 60\.00 Hz, and the rig file says 50"),
    ],
)
def test_the_wrong_screen_or_mode_is_refused(reopen, changes, reason):
    with pytest.raises(DeviceError, match=reason):
        reopen(**changes)


@pytest.mark.parametrize("interval", [0.5, 1.5, 2.0])
def test_swaps_that_are_not_the_refresh_rates_are_refused(reopen, interval):
    made_up = iter(np.cumsum([PERIOD_NS] * 20 + [interval * PERIOD_NS] + [PERIOD_NS] * 40).astype(int).tolist())
    with pytest.raises(DeviceError, match=r"swaps come .* ms apart where its refresh rate says 16\.7 ms"):
        reopen(swap_clock=lambda _: next(made_up))


def test_a_screen_without_vertical_synchronisation_is_refused(reopen):
    with pytest.raises(DeviceError, match=r"swaps come .* turn off what delays or hurries them"):
        reopen(swap_clock=lambda swapped_ns: swapped_ns)


def test_a_killed_window_is_noticed_and_a_closed_one_leaves_no_process(projector):
    (window,) = [one for one in psutil.Process().children() if "drivers.hdmi.window" in one.cmdline()]
    window.kill()
    with pytest.raises(DeviceError, match="its window's process has ended; open it again"):
        projector.show(plain(projector, 0))
    projector.close()
    assert not window.is_running()


def test_without_a_desktop_it_says_where_to_run(reopen, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":999")
    with pytest.raises(DeviceError, match="there is no desktop to ask"):
        reopen()


def test_a_response_curve_that_is_none_is_refused(reopen, tmp_path):
    (tmp_path / "response.txt").write_text("1 2 3\n")
    with pytest.raises(DeviceError, match="is no response curve; it takes 256 rows"):
        reopen(response=tmp_path / "response.txt")


def test_the_screen_does_not_blank_while_the_window_is_open(desktop, reopen):
    subprocess.run(["xset", "s", "1"], env=desktop.environment, check=True)
    try:
        projector = reopen()
        assert projector.kept_awake
        time.sleep(2.5)
        assert not desktop.blanked()
        projector.close()
        until(desktop.blanked)
    finally:
        subprocess.run(["xset", "s", "reset", "s", "600"], env=desktop.environment, check=True)
