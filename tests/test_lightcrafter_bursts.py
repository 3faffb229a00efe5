"""Bursts: the LightCrafter shows patterns of its flash, triggers the camera with each, and frames are paired right."""

import threading
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.lightcrafter4500.emulator.controller import Shown
from drivers.lightcrafter4500.flash import Flash, picture_of
from tankrig.devices import BurstProjector, CameraSettings, Frame, TriggeredCamera
from tankrig.errors import DeviceError
from tankrig.pattern import Pattern
from tankrig.run.burst import IncompleteBurstError, take_burst

from .lightcrafter_bench import LightcrafterBench

SHAPE = (12, 16)
EXPOSURE_MS = 8.6
_RANDOM = np.random.default_rng(4)


def grey(number: int) -> Pattern:
    return Pattern(f"grey {number}", _RANDOM.integers(1, 255, SHAPE, np.uint8))


def lit_or_not(number: int) -> Pattern:
    return Pattern(f"plane {number}", _RANDOM.choice(np.array([0, 255], np.uint8), SHAPE))


GREYS = [grey(number) for number in range(9)]
PLANES = [lit_or_not(number) for number in range(48)]


@pytest.fixture(scope="module")
def greys(tmp_path_factory):
    """Three pictures of three 8-bit patterns each."""
    folder = tmp_path_factory.mktemp("greys")
    for image in range(3):
        cv2.imwrite(str(folder / f"{image}.png"), picture_of(GREYS[3 * image : 3 * image + 3]))
    return folder


@pytest.fixture(scope="module")
def planes(tmp_path_factory):
    """Two pictures of 24 patterns of one bit each."""
    folder = tmp_path_factory.mktemp("planes")
    for image in range(2):
        cv2.imwrite(str(folder / f"{image}.bmp"), picture_of(PLANES[24 * image : 24 * image + 24]))
    return folder


class TriggeredStandIn:
    """A camera on the stand-in's clock and trigger: its pixels tell what the mirrors showed while it exposed.

    `loses` are triggers that it does not see; `drops` frames that are lost on their way, which its count tells.
    """

    name, shape, saturation = "triggered camera", SHAPE, 255

    def __init__(self, bench: LightcrafterBench, flash: Flash, exposure_ms: float) -> None:
        self.bench, self.flash, self.exposure_s = bench, flash, exposure_ms / 1000
        self.seen, self.count, self.armed = 0, 7, False
        self.loses: set[int] = set()
        self.drops: set[int] = set()
        self.spurious: set[int] = set()

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def capture(self, after_ns: int, timeout_s: float) -> Frame:
        raise NotImplementedError

    def close(self) -> None: ...

    def arm(self) -> None:
        self.armed, self.since = True, len(self.bench.controller.shown)
        self.taken = 0

    def disarm(self) -> None:
        self.armed = False

    def triggered(self, timeout_s: float) -> Frame | None:
        assert self.armed
        end_s = self.bench.clock.now_s + timeout_s
        while True:
            self.bench.controller.advance(self.bench.clock.now_s)
            shown: list[Shown] = list(self.bench.controller.shown)[self.since :]
            if self.taken < len(shown):
                number, self.taken = self.taken, self.taken + 1
                if number in self.loses:
                    continue
                self.count += 1
                if number in self.drops:
                    continue
                return self.frame(shown, shown[number].from_s)
            if self.bench.clock.now_s > end_s:
                return None
            self.bench.clock.sleep(0.001)

    def frame(self, shown: list[Shown], start_s: float) -> Frame:
        """All light of the exposure, so that a pattern that only half belongs to it is seen."""
        self.bench.clock.sleep(max(0.0, start_s + self.exposure_s - self.bench.clock.now_s))
        light, image = np.zeros(SHAPE), 0
        images = self.bench.sent(0x1A34)[-2]
        for one in shown:
            image += one.entry.swap
            part = min(one.until_s, start_s + self.exposure_s) - max(one.from_s, start_s)
            if part > 0:
                from drivers.lightcrafter4500.flash import Place

                place = Place(images[image], one.entry.number, one.entry.bits)
                light += self.flash.at(place).pixels * part / (one.until_s - one.from_s)
        start_ns = round(1e9 * start_s)
        return Frame(np.round(light).astype(np.uint8), start_ns, start_ns, start_ns + 1, self.count)


class Rig:
    """Driver, stand-in and camera."""

    def __init__(self, folder, exposure_ms: float = EXPOSURE_MS, **changes) -> None:
        self.bench = LightcrafterBench(mode_s=0.0, lock_s=0.0, validate_s=0.05)
        self.projector = self.bench.open(shape=SHAPE, flash=folder, **changes)
        self.exposure_ms = exposure_ms
        self.camera = TriggeredStandIn(self.bench, Flash(folder, SHAPE), exposure_ms)

    def take(self, patterns):
        clock, real = self.bench.clock, time.monotonic_ns
        time.monotonic_ns = lambda: round(1e9 * clock.now_s)  # the moment from which frames count is on this clock too
        try:
            return take_burst(self.projector, self.camera, patterns, self.exposure_ms)
        finally:
            time.monotonic_ns = real


def mispaired(frames, patterns) -> int:
    return sum(
        not np.array_equal(frame.pixels, pattern.pixels) for frame, pattern in zip(frames, patterns, strict=True)
    )


def test_the_roles_are_told_by_the_protocols(greys):
    rig = Rig(greys)
    assert isinstance(rig.projector, BurstProjector)
    assert isinstance(rig.camera, TriggeredCamera)


def test_more_than_100_patterns_of_8_bits_a_second_and_none_is_mispaired(greys):
    rig = Rig(greys)
    patterns = [GREYS[number % 3] for number in range(60)] + [GREYS[3 + number % 3] for number in range(60)]
    frames, timing = rig.take(patterns)
    assert mispaired(frames, patterns) == 0
    took_s = (frames[-1].exposure_start_ns - frames[0].exposure_start_ns) / 1e9 + timing.period_ms / 1000
    assert len(frames) / took_s >= 100.0
    print(f"{len(frames) / took_s:.1f} patterns/s, 0 of {len(frames)} mispaired")


def test_more_than_a_thousand_patterns_of_1_bit_a_second(planes):
    rig = Rig(planes, exposure_ms=0.5, burst_gap_ms=0.3)
    frames, _ = rig.take(PLANES)
    assert mispaired(frames, PLANES) == 0
    assert 47e9 / (frames[-1].exposure_start_ns - frames[0].exposure_start_ns) > 1000.0


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.integers(0, 2), min_size=1, max_size=12),
    st.lists(st.integers(3, 5), max_size=12),
    st.sets(st.integers(0, 11), max_size=2),
    st.sets(st.integers(0, 11), max_size=2),
    st.dictionaries(
        st.integers(0, 40),
        st.tuples(
            st.sampled_from(["lost_replies", "empty_reports", "stale_reports", "refuse_next"]), st.integers(1, 3)
        ),
        max_size=2,
    ),
)
def test_a_burst_is_paired_right_or_refused_whatever_is_lost(greys, first, second, loses, drops, faults):
    rig = Rig(greys)
    board, now = rig.bench.board, rig.bench.board.arrived

    def spoiling(name: str, number: int) -> Callable[[object], None]:
        return lambda board: setattr(board.faults, name, number)

    board.schedule = {now + at: spoiling(*fault) for at, fault in faults.items()}
    rig.camera.loses, rig.camera.drops = loses, drops
    patterns = [GREYS[number] for number in first + second]
    began_s = rig.bench.clock.now_s
    try:
        frames, _ = rig.take(patterns)
    except DeviceError:
        assert rig.bench.clock.now_s - began_s < 8.0
    else:
        assert mispaired(frames, patterns) == 0
        assert not (loses | drops) & set(range(len(patterns)))
    assert not rig.camera.armed


@pytest.mark.parametrize("lost", [0, 3, 5])
def test_a_frame_that_is_lost_spoils_its_burst(greys, lost):
    rig = Rig(greys)
    rig.camera.loses = {lost}
    with pytest.raises(IncompleteBurstError, match="6 patterns and only 5 frames, so that nobody knows which"):
        rig.take(GREYS[:6])


def test_after_a_burst_the_video_is_shown_again(greys):
    rig = Rig(greys)
    rig.take(GREYS[:3])
    with pytest.raises(DeviceError, match="shows nothing since its burst; show a pattern first"):
        rig.projector.confirm()
    rig.projector.show(GREYS[8])
    rig.projector.confirm()
    assert rig.bench.displaying
    assert rig.bench.sent(0x1A22)[-1] == b"\0"


def test_a_start_is_sent_once_so_that_no_burst_is_shown_twice(greys):
    rig = Rig(greys)
    rig.projector.load_burst(GREYS[:3], EXPOSURE_MS)
    before = rig.bench.sent(0x1A24).count(b"\2")
    rig.bench.faults.lost_replies = 1
    with pytest.raises(DeviceError, match="did not answer 1A24 in time"):
        rig.projector.play_burst()
    assert rig.bench.sent(0x1A24).count(b"\2") == before + 1
    with pytest.raises(DeviceError, match="has no patterns to show in a burst; load them first"):
        rig.projector.play_burst()


@pytest.mark.parametrize(
    ("patterns", "exposure_ms", "reason"),
    [
        ([grey(99)], 8.6, 'pattern "grey 99" is in none of its pictures'),
        (GREYS[:1], 8.0, "takes 8333 µs for a pattern of 8 bits, .* expose 8.6 ms or longer"),
        ([*GREYS[:3], *GREYS[3:6], *GREYS[:3]], 8.6, "goes through pictures 0, 1, 0 .* which holds two ready"),
        (GREYS[:1] * 129, 8.6, "shows 1 to 128 patterns in a burst, not 129"),
        ([], 8.6, "shows 1 to 128 patterns in a burst, not 0"),
    ],
)
def test_what_it_cannot_show_is_refused_and_the_video_goes_on(greys, patterns, exposure_ms, reason):
    rig = Rig(greys)
    with pytest.raises(DeviceError, match=reason):
        rig.projector.load_burst(patterns, exposure_ms)
    rig.projector.confirm()


def test_without_pictures_of_its_flash_it_shows_no_bursts():
    with pytest.raises(DeviceError, match="nobody has said what its flash holds; set flash"):
        LightcrafterBench().open().load_burst([], EXPOSURE_MS)


def test_patterns_called_for_from_outside_come_at_their_edges(greys):
    rig = Rig(greys, burst_trigger="rising")
    controller, clock = rig.bench.controller, rig.bench.clock
    timing = rig.projector.load_burst(GREYS[:3], EXPOSURE_MS)
    assert timing.period_ms is None
    before = len(controller.shown)
    rig.projector.play_burst()
    edges_s = [clock.now_s + 0.02 * number for number in (1, 2, 3)]
    for edge_s in edges_s:
        assert controller.trigger_in(edge_s)
    assert [shown.from_s for shown in list(controller.shown)[before:]] == edges_s


def test_flash_holds_what_was_put_into_its_pictures(planes, greys):
    assert [place.number for place in Flash(planes, SHAPE).places(PLANES[:24])] == list(range(24))
    assert [(place.image, place.number, place.bits) for place in Flash(greys, SHAPE).places(GREYS[2:5])] == [
        (0, 2, 8), (1, 0, 8), (1, 1, 8),
    ]  # fmt: skip


def test_two_threads_do_not_disturb_each_others_commands(greys):
    rig = Rig(greys)
    errors = []

    def confirm() -> None:
        try:
            for _ in range(50):
                rig.projector.confirm()
        except DeviceError as error:
            errors.append(error)

    threads = [threading.Thread(target=confirm) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert errors == []
