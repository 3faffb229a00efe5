"""What is counted in rectangles of a run's frames, and kept beside it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from tankrig.errors import StoreError
from tankrig.run.regions import REGIONS, Counted, Region, count_regions, read_regions, write_regions
from tankrig.run.start import new_run
from tankrig.sequence import Capture, Sequence

from .memory_rig import memory_rig


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Five frames of two patterns."""
    folder = tmp_path_factory.mktemp("regions")
    steps = (Capture("full", frames=3), Capture("dark", frames=2))
    outcome = new_run(Sequence("two", steps, exposure_ms=1.0), memory_rig(folder), folder / "run").run()
    assert outcome.error is None
    return tankrig.open_run(folder / "run")


def test_what_is_counted_is_what_the_frames_hold(run):
    """A mean of other pixels than the ones inside the rectangle would be believed."""
    regions = (Region("left", (0, 3), (0, 2)), Region("one pixel", (2, 3), (1, 2)))
    counted = count_regions(run, regions)
    frames = run.frames
    assert len(counted) == 2 * len(frames)
    for one in counted:
        part = frames.sel(frame=one.frame).values[slice(*one.region.rows), slice(*one.region.columns)]
        assert (one.mean, one.sd) == pytest.approx((part.mean(), part.std()))
        assert (one.smallest, one.largest) == (part.min(), part.max())
        assert one.pattern == str(frames.pattern.sel(frame=one.frame).values)
        assert one.exposure_ms == pytest.approx(float(frames.exposure_ms.sel(frame=one.frame)))
    times = [one.time_s for one in counted if one.region is regions[0]]
    assert times == sorted(times)


def test_regions_are_read_back_as_they_were_saved(run):
    """Whoever opens the run a year later sees the same rectangles and numbers."""
    counted = count_regions(run, (Region('a, "quoted"\nname', (0, 3), (0, 2)), Region("µ", (1, 2), (1, 2))))
    write_regions(run.path, counted)
    again = read_regions(run.path)
    assert [one.region for one in again] == [one.region for one in counted]
    assert [one.mean for one in again] == pytest.approx([one.mean for one in counted], abs=1e-6)
    assert tankrig.open_run(run.path).frames.shape == run.frames.shape, "a run with such a file is still a run"
    (run.path / REGIONS).unlink()
    assert read_regions(run.path) == ()


def test_a_region_beside_the_picture_is_refused_and_a_damaged_file_is_told(run):
    with pytest.raises(StoreError, match=r"far away holds no pixel.*move it"):
        count_regions(run, (Region("far away", (900, 910), (0, 2)),))
    (run.path / REGIONS).write_text("region,frame\nx,one\n")
    with pytest.raises(StoreError, match="save the regions again"):
        read_regions(run.path)
    (run.path / REGIONS).unlink()


@settings(max_examples=20, deadline=None)
@given(
    name=st.text(st.characters(codec="utf-8", exclude_characters="\r\x00"), max_size=20),
    place=st.tuples(*[st.integers(0, 4000)] * 4),
    mean=st.floats(0, 65535), ink=st.floats(0, 1e5) | st.just(float("inf")) | st.just(float("nan")),
)  # fmt: skip
def test_whatever_a_region_is_called_it_is_kept(tmp_path_factory, name, place, mean, ink):
    folder = tmp_path_factory.mktemp("kept")
    region = Region(name, place[:2], place[2:])
    one = Counted(region, 0, 0.25, "rays", ink, 20.0, float("nan"), mean, 0.5, 0, 65535)
    write_regions(folder, [one])
    (again,) = read_regions(folder)
    assert again.region == region
    np.testing.assert_allclose([again.mean, again.ink_ul], [mean, ink], rtol=1e-5, atol=1e-6)
