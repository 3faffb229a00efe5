"""What may stand between the projector's window and its light is refused, on real X servers, in a sentence each."""

import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.hdmi.proof import output_doubt, unchanged
from drivers.hdmi.xlib import IDENTITY, Crtc
from tankrig.errors import DeviceError
from tankrig.testing.projector import plain

from .test_hdmi import SHAPE, desktop, reopen, server  # noqa: F401 - fixtures
from .xserver import OPERATOR, PROJECTOR, start_x_server, stop_x_server, until

COVERS = {"all of it": (800, 0, 320, 240), "one pixel": (1119, 239, 200, 200), "one from the left": (700, 0, 101, 10)}


@pytest.fixture
def as_before(desktop):  # noqa: F811
    """The desktop, put right again in the end."""
    yield desktop
    desktop.mix_colours((0,) * 18)
    desktop.xrandr("--output", OPERATOR, "--primary", "--pos", "0x0")
    desktop.xrandr("--output", PROJECTOR, "--brightness", "1", "--gamma", "1:1:1")
    desktop.plug_in()


@pytest.mark.parametrize("place", COVERS.values(), ids=COVERS)
def test_a_window_on_top_is_named_even_if_it_covers_one_pixel(as_before, reopen, place):  # noqa: F811
    projector = reopen()
    projector.show(plain(projector, 255))
    projector.confirm()
    with (
        as_before.window(*place, title="a message"),
        pytest.raises(DeviceError, match='DUMMY1: the window "a message" covers its picture, or a part of it; move'),
    ):
        projector.confirm()


def test_a_window_beside_it_is_no_matter(as_before, reopen):  # noqa: F811
    projector = reopen()
    projector.show(plain(projector, 255))
    with as_before.window(0, 0, 800, 600), as_before.window(800, 240, 300, 300):
        projector.confirm()


def test_what_covered_the_picture_for_a_moment_is_known_until_the_next_one_is_shown(as_before, reopen):  # noqa: F811
    projector = reopen()
    projector.show(plain(projector, 255))
    with as_before.window(900, 50, 50, 50):
        pass
    for _ in range(2):
        with pytest.raises(DeviceError, match="something has covered its picture for a while since it was shown"):
            projector.confirm()
    projector.show(plain(projector, 128))
    projector.confirm()


def test_no_picture_is_taken_for_shown_below_a_window_that_insists_on_being_on_top(as_before, reopen):  # noqa: F811
    """Refused on opening; or, where a busy computer lets the projector's window be on top just then, soon after."""

    def show_for_seconds() -> None:
        projector, end_s = reopen(), time.monotonic() + 20.0
        while time.monotonic() < end_s:
            projector.show(plain(projector, 255))
            projector.confirm()

    refused = pytest.raises(DeviceError, match=r"covers its picture|has covered its picture")
    with as_before.insisting_window(900, 50, 50, 50), refused:
        show_for_seconds()


def test_an_output_that_shows_the_operators_picture_is_refused(as_before, reopen):  # noqa: F811
    as_before.xrandr("--output", PROJECTOR, "--pos", "700x0")
    with pytest.raises(
        DeviceError, match=r"DUMMY1 shows the same part of the desktop as DUMMY0 \(mirrored\); place it"
    ):
        reopen()


def test_an_operators_screen_that_is_put_onto_the_projectors_is_noticed(as_before, reopen):  # noqa: F811
    projector = reopen()
    projector.show(plain(projector, 255))
    as_before.xrandr("--output", OPERATOR, "--pos", "500x0")
    with pytest.raises(DeviceError, match=r"shows the same part of the desktop as DUMMY0|its video mode changed"):
        projector.confirm()


@pytest.mark.parametrize("change", [("--brightness", "0.98"), ("--gamma", "1:1:1.1"), ("--gamma", "0.95")])
def test_a_changed_brightness_or_gamma_is_refused_on_opening_and_noticed_later(as_before, reopen, change):  # noqa: F811
    projector = reopen()
    projector.show(plain(projector, 255))
    as_before.xrandr("--output", PROJECTOR, *change)
    with pytest.raises(DeviceError, match=r"the brightness or gamma of DUMMY1 is changed .*; undo that \(xrandr "):
        projector.confirm()
    projector.close()
    with pytest.raises(DeviceError, match="the brightness or gamma of DUMMY1 is changed"):
        reopen()
    as_before.xrandr("--output", PROJECTOR, "--gamma", "1:1:1", "--brightness", "1")  # as the sentence says
    reopen().confirm()


def test_the_operators_own_brightness_is_no_matter(as_before, reopen):  # noqa: F811
    as_before.xrandr("--output", OPERATOR, "--brightness", "0.5")
    reopen().confirm()
    as_before.xrandr("--output", OPERATOR, "--brightness", "1")


def test_a_colour_matrix_is_refused_and_the_one_that_changes_nothing_is_not(as_before, reopen):  # noqa: F811
    one = (0, 1)
    as_before.mix_colours((*one, *(0, 0) * 3, *one, *(0, 0) * 3, *one))
    projector = reopen()
    as_before.mix_colours((*one, *(0, 0) * 3, 0xC0000000, 0, *(0, 0) * 3, *one))
    with pytest.raises(DeviceError, match=r"its colours are mixed by a colour matrix \(CTM\); switch night light"):
        projector.confirm()


def test_the_operators_main_screen_is_refused_unless_the_rig_file_accepts_it(as_before, reopen):  # noqa: F811
    as_before.xrandr("--output", PROJECTOR, "--primary")
    with pytest.raises(DeviceError, match=r"is the desktop's main screen, .*accept_primary = true in \[projector\]"):
        reopen()
    projector = reopen(accept_primary=True)
    projector.show(plain(projector, 255))
    projector.confirm()


def test_a_compositor_is_refused_unless_the_rig_file_accepts_it(as_before, reopen):  # noqa: F811
    projector = reopen()
    with as_before.compositor():
        with pytest.raises(DeviceError, match=r"a compositor makes the screen's .*accept_compositor = true"):
            projector.confirm()
        with pytest.raises(DeviceError, match="a compositor makes the screen's picture"):
            reopen()
        accepted = reopen(accept_compositor=True)
        accepted.show(plain(accepted, 255))
        accepted.confirm()


def test_a_window_that_was_taken_off_the_screen_is_noticed(as_before, reopen):  # noqa: F811
    projector = reopen()
    projector.show(plain(projector, 255))
    as_before.unmap("tankrig projector")
    with pytest.raises(DeviceError, match=r"its window is not on the screen|its window was moved"):
        until(lambda: projector.confirm() is not None)


def test_the_only_screen_of_a_desktop_is_told_apart(reopen, monkeypatch):  # noqa: F811
    process, display = start_x_server("Xvfb", "-screen", "0", "320x240x24", "-nolisten", "tcp")
    try:
        if not display:
            pytest.skip("needs Xvfb")
        monkeypatch.setenv("DISPLAY", display)
        with pytest.raises(DeviceError, match=r"is the desktop's only screen, where .*accept_primary = true"):
            reopen(screen={"output": "screen"})
        # This server's table of levels is whatever was in its memory until somebody sets one.
        subprocess.run(["xrandr", "--output", "screen", "--gamma", "1:1:1"], check=True, timeout=20.0)
        accepted = reopen(screen={"output": "screen"}, accept_primary=True)
        accepted.show(plain(accepted, 255))
        accepted.confirm()
        accepted.close()
    finally:
        stop_x_server(process)


def test_a_desktop_that_can_prove_nothing_is_refused(reopen, monkeypatch):  # noqa: F811
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")
    shape = {"shape": (800, 800), "screen": {"output": "", "model": None}, "accept_primary": True}
    with pytest.raises(DeviceError, match=r"Offscreen does not tell what becomes of a picture .* X11 \(Xorg\) session"):
        reopen(**shape)


def test_confirming_costs_little_beside_an_exposure(as_before, reopen):  # noqa: F811, ARG001
    projector = reopen()
    projector.show(plain(projector, 255))
    took = []
    for _ in range(50):
        start = time.perf_counter()
        projector.confirm()
        took.append(time.perf_counter() - start)
    print(f"confirm: median {1e3 * np.median(took):.2f} ms, most {1e3 * max(took):.2f} ms")
    assert np.median(took) < 0.02


# -- the rules, for any desktop --------------------------------------------------------------------------------------

STRAIGHT = tuple(tuple(257 * level for level in range(256)) for _ in range(3))
OWN = Crtc((800, 0, 320, 240), ("HDMI-1",), True, IDENTITY, STRAIGHT)
sides = st.integers(1, 2000)
corners = st.integers(-2000, 2000)


@given(corners, corners, sides, sides)
def test_an_output_is_refused_exactly_when_another_shows_one_of_its_pixels(x, y, width, height):
    other = Crtc((x, y, width, height), ("DP-1",), True, IDENTITY, ())
    xs, ys = set(range(x, x + width)), set(range(y, y + height))
    shared = bool(xs & set(range(800, 1120))) and bool(ys & set(range(240)))
    assert ("mirrored" in output_doubt((other, OWN), "HDMI-1", OWN.place)) == shared


@given(st.sampled_from([256, 1024, 4096]), st.floats(0.0, 0.99))
def test_less_brightness_never_passes_and_an_untouched_ramp_always_does(size, brightness):
    straight = [65535 * level / (size - 1) for level in range(size)]
    assert unchanged(tuple(round(value) for value in straight))
    assert not unchanged(tuple(round(brightness * value) for value in straight))


@given(st.integers(0, 8), st.floats(-2.0, 2.0))
def test_any_transform_but_none_is_refused(place, value):
    transform = tuple(value if number == place else one for number, one in enumerate(IDENTITY))
    doubt = output_doubt((replace(OWN, transform=transform),), "HDMI-1", OWN.place)
    assert ("scaled or transformed" in doubt) == (abs(value - IDENTITY[place]) > 1e-4)


@pytest.mark.parametrize(
    ("crtc", "words"),
    [
        (replace(OWN, upright=False), "is turned or mirrored"),
        (replace(OWN, outputs=("HDMI-1", "VGA-1")), "shows the same part of the desktop as VGA-1"),
        (replace(OWN, outputs=("VGA-1",)), "HDMI-1 is switched off"),
        (replace(OWN, place=(800, 0, 640, 480)), "does not fill its screen"),
    ],
)
def test_what_a_card_may_do_to_a_picture_is_refused(crtc, words):
    assert words in output_doubt((crtc,), "HDMI-1", (800, 0, 320, 240))
    assert output_doubt((OWN,), "HDMI-1", OWN.place) == ""
