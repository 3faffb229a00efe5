"""A calibration file is whole, dated and never lost; one that cannot be trusted is named and not used."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.calibration.file import SET_ASIDE, Calibration, all_in, in_force, load, newest, save
from tankrig.errors import StoreError

ONE = Calibration(
    "radiometry",
    "camera A",
    (4, 6),
    result={"gain_dn_per_e": np.float64(0.5), "curve": {"level": [0.0, 1.0]}},
    sd={"gain_dn_per_e": 0.01},
    how_well={"linearity_percent": 0.2},
    rests_on={"camera": "abc"},
    arrays={"flat": np.arange(24.0).reshape(4, 6)},
)


def test_what_is_saved_is_read_back_with_its_hash(tmp_path: Path) -> None:
    kept = save(ONE, tmp_path)
    found = load(kept.path)
    assert found.hash == kept.hash
    assert found.result == {"gain_dn_per_e": 0.5, "curve": {"level": [0.0, 1.0]}}
    assert (found.sd, found.how_well, found.rests_on) == (ONE.sd, ONE.how_well, ONE.rests_on)
    assert np.array_equal(found.arrays["flat"], ONE.arrays["flat"])
    assert (found.device, found.shape, found.date) == (ONE.device, ONE.shape, ONE.date)
    assert found.in_use
    assert found.age_days < 1.0


def test_nothing_is_overwritten_and_the_newest_counts(tmp_path: Path) -> None:
    first = save(ONE, tmp_path)
    before = first.path.read_bytes()
    second = save(replace(ONE, how_well={"linearity_percent": 0.1}), tmp_path)
    assert second.path != first.path
    assert first.path.read_bytes() == before
    assert newest(tmp_path, "radiometry").hash == second.hash
    assert {kind: one.hash for kind, one in in_force(tmp_path).items()} == {"radiometry": second.hash}
    assert newest(tmp_path, "camera") is None


@pytest.mark.parametrize("change", [{"how_well": {"linearity_percent": 0.4}}, {"doubts": ("it moved; hold it still",)}])
def test_a_doubtful_result_is_kept_but_used_only_when_accepted(tmp_path: Path, change: dict[str, object]) -> None:
    """Half an hour of a bad calibration must not replace a good one behind the lab's back."""
    good, doubtful = save(ONE, tmp_path), replace(ONE, **change)
    kept = save(doubtful, tmp_path)
    assert kept.path.parent.name == SET_ASIDE
    assert kept.doubts
    assert newest(tmp_path, "radiometry").hash == good.hash
    assert save(doubtful, tmp_path, accept=True).in_use
    assert newest(tmp_path, "radiometry").how_well == doubtful.how_well


def test_files_that_cannot_be_trusted_are_named_and_the_one_before_counts(tmp_path: Path) -> None:
    good = save(replace(ONE, date="2026-01-01T00:00:00+00:00"), tmp_path)
    cut = save(replace(ONE, date="2026-01-02T00:00:00+00:00"), tmp_path).path
    lines = cut.read_text().splitlines(keepends=True)
    cut.write_text("".join(lines[:-2]))  # still TOML, and still wrong
    edited = save(replace(ONE, date="2026-01-03T00:00:00+00:00"), tmp_path).path
    edited.write_text(edited.read_text().replace("0.5", "0.6"))
    newer = save(replace(ONE, date="2026-01-04T00:00:00+00:00"), tmp_path).path
    newer.write_text(newer.read_text().replace("format = 1", "format = 9"))
    bare = save(replace(ONE, date="2026-01-05T00:00:00+00:00"), tmp_path).path
    bare.with_suffix(".npz").unlink()
    half = tmp_path / "radiometry-2026-01-06T00-00-00.toml"
    half.write_text(good.path.read_text()[:200])
    told = [str(one) for one in all_in(tmp_path) if isinstance(one, StoreError)]
    for path, reason in ((half, "no whole"), (bare, "cannot be read"), (newer, "update tankrig"), (edited, "changed"),
                         (cut, "cut off")):  # fmt: skip
        assert any(path.stem in sentence and reason in sentence for sentence in told), (path, told)
    assert len(told) == 5
    assert newest(tmp_path, "radiometry").hash == good.hash


def test_another_camera_or_resolution_is_refused(tmp_path: Path) -> None:
    kept = save(ONE, tmp_path)
    kept.require_for("camera A", (4, 6))
    with pytest.raises(StoreError, match="measured with camera A and the rig has camera B"):
        kept.require_for("camera B", (4, 6))
    with pytest.raises(StoreError, match=r"measured with \[4, 6\] pixels .* has \[8, 6\]"):
        kept.require_for("camera A", (8, 6))
