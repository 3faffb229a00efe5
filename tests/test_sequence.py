"""Sequences say what will be done, from a file or from Python; what is wrong is said before anything moves."""

import re
from pathlib import Path

import pytest

from tankrig import SequenceError
from tankrig.dosing import DoseLimits
from tankrig.pattern.kinds import ImageFile, Sheet
from tankrig.pattern.wall import Wall
from tankrig.sequence import Capture, Dose, Mix, Note, Pace, Repeat, Sequence, Series, Wait, dry_run, load_sequence
from tankrig.sequence.loading import sequence_from_table, sequence_table

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "dilution.toml"
WALL = Wall(shape=(120, 160), y_mm=(-80.0, 80.0), z_mm=(0.0, 120.0))
LIMITS = DoseLimits(dose_ul=1000.0, run_ul=2000.0, tank_ul=3000.0)


def written(folder: Path, text: str) -> Path:
    file = folder / "sequence.toml"
    file.write_text(text)
    return file


def test_the_example_loads_draws_and_keeps_its_budget():
    sequence = load_sequence(EXAMPLE)
    assert [task.action.total_ul for task in sequence.tasks if isinstance(task.action, Dose)] == [
        100.0, 200.0, 400.0, 800.0, 1600.0,
    ]  # fmt: skip
    assert sequence.frames == 5 * 14
    assert set(sequence.drawn(WALL)) == {"sheet", "dark", "stripes", "rays"}
    plan = dry_run(sequence, LIMITS, Pace(dose_ul_per_s=10.0, mixing_s=30.0), frame_bytes=80 * 120 * 2)
    assert plan.ink_ul == 1600.0
    assert plan.frames == 70
    assert plan.disk_bytes == 70 * 19200
    assert plan.seconds == pytest.approx(160.0 + 5 * 30.0 + 5 * (4 * 0.05 + 18 * 0.02))
    assert len(plan.steps) == len(sequence.tasks)


def test_the_documentation_shows_one_sequence_twice(tmp_path):
    page = (EXAMPLE.parents[1] / "sequences.md").read_text()
    toml, code = (re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)[0] for language in ("toml", "python"))
    names: dict[str, object] = {}
    exec(code, names)
    assert load_sequence(written(tmp_path, toml)) == names["sequence"]


def test_a_file_and_python_make_the_same_sequence(tmp_path):
    file = written(
        tmp_path,
        """
        name = "both"
        exposure_ms = 5
        [patterns.sheet]
        kind = "sheet"
        y_mm = [-60, 60]
        z_mm = [58, 62]
        [[steps]]
        do = "note"
        text = "begin"
        [[steps]]
        do = "repeat"
        times = 2
        steps = [ { do = "capture", pattern = "dark" }, { do = "wait", seconds = 1 } ]
        [[steps]]
        do = "series"
        total_ul = [0, 10]
        steps = [ { do = "mix" }, { do = "capture", pattern = "sheet", frames = 3, exposure_ms = 2.5, gain = 2 } ]
        [[steps]]
        do = "dose"
        total_ul = 20
        """,
    )
    sequence = Sequence(
        "both",
        steps=(
            Note("begin"),
            Repeat(2, (Capture("dark"), Wait(1.0))),
            Series((0.0, 10.0), (Mix(), Capture("sheet", frames=3, exposure_ms=2.5, gain=2.0))),
            Dose(20.0),
        ),
        patterns={"sheet": Sheet((-60.0, 60.0), (58.0, 62.0))},
        exposure_ms=5.0,
    )
    assert load_sequence(file) == sequence
    assert sequence_from_table(sequence_table(sequence), "settings") == sequence
    assert [task.label for task in sequence.tasks] == [
        "note: begin",
        "time 1 of 2, capture dark",
        "time 1 of 2, wait 1 s",
        "time 2 of 2, capture dark",
        "time 2 of 2, wait 1 s",
        "dose 1 of 2, dose to 0 µl",
        "dose 1 of 2, wait until mixed",
        "dose 1 of 2, capture sheet × 3",
        "dose 2 of 2, dose to 10 µl",
        "dose 2 of 2, wait until mixed",
        "dose 2 of 2, capture sheet × 3",
        "dose to 20 µl",
    ]
    settings = [sequence.camera_settings(step) for step in (Capture("dark"), Capture("sheet", 3, 2.5, 2.0))]
    assert [(setting.exposure_ms, setting.gain) for setting in settings] == [(5.0, 1.0), (2.5, 2.0)]


def test_a_picture_is_looked_for_beside_the_sequence(tmp_path):
    file = written(
        tmp_path,
        """
        name = "picture"
        [patterns.logo]
        kind = "image"
        path = "logo.png"
        [[steps]]
        do = "capture"
        pattern = "logo"
        """,
    )
    assert load_sequence(file).patterns["logo"] == ImageFile(str(tmp_path / "logo.png"))
    with pytest.raises(SequenceError, match=r"sequence\.toml: patterns\.logo \(capture logo\): .*logo\.png: does not"):
        load_sequence(file).drawn(WALL)


SHEET = 'name = "x"\n[patterns.sheet]\nkind = "sheet"\ny_mm = [-60, 60]\nz_mm = [58, 62]\n'


def step(*lines: str) -> str:
    """A sequence of one step."""
    return "\n".join([SHEET, "[[steps]]", *lines])


def pattern(*lines: str) -> str:
    """A sequence with one pattern."""
    return "\n".join(['name = "x"', "[patterns.a]", *lines, "[[steps]]", 'do = "mix"'])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("name = ", "is not TOML"),
        ('name = "x"', 'key "steps" is missing; add it'),
        ('name = "x"\nsteps = []', "steps is empty; give at least one step"),
        (step('do = "captur"'), 'steps[0].do = "captur" is unknown; did you mean "capture"?'),
        (step('pattern = "dark"'), "steps[0] has no key 'do'"),
        (step('do = "capture"', 'patern = "dark"'), 'key "steps[0].patern" is unknown; did you mean "pattern"?'),
        (step('do = "capture"', 'pattern = "shet"'), 'pattern "shet" is unknown; did you mean "sheet"?'),
        (step('do = "capture"'), 'key "steps[0].pattern" is missing; add it'),
        (step('do = "capture"', 'pattern = "dark"', "frames = 0"), "steps[0].frames = 0 records nothing"),
        (step('do = "capture"', 'pattern = "dark"', 'frames = "2"'), 'steps[0].frames = "2" is not a whole number'),
        (step('do = "mix"', "exposure_ms = inf"), "steps[0].exposure_ms = inf is not positive, or has no end"),
        (step('do = "capture"', 'pattern = "dark"', "exposure_ms = -1"), "steps[0].exposure_ms = -1.0 is not positive"),
        (step('do = "dose"', "total_ul = -5"), "steps[0].total_ul = -5.0 is no volume"),
        (step('do = "dose"', "total_ul = nan"), "steps[0].total_ul"),
        (step('do = "series"', "total_ul = [10, 5]", 'steps = [{ do = "mix" }]'), "a dose cannot take ink out"),
        (step('do = "series"', "total_ul = []", 'steps = [{ do = "mix" }]'), "steps[0].total_ul is empty"),
        (
            step('do = "repeat"', "times = 2", 'steps = [{ do = "wait", secs = 2 }]'),
            'key "steps[0].steps[0].secs" is unknown; did you mean "seconds"?',
        ),
        (step('do = "mix"', "timeout_s = 1"), "leaves no time to look"),
        (step('do = "mix"', "tolerance = 2"), "tolerance = 2.0 is outside"),
        (pattern('kind = "stripe"'), 'patterns.a.kind = "stripe" is unknown; did you mean "stripes"?'),
        (pattern('kind = "stripes"', "period = 3"), 'key "patterns.a.period" is unknown; did you mean "period_mm"?'),
        ('name = "x"\nexposure = 3\n[[steps]]\ndo = "mix"', 'key "exposure" is unknown; did you mean "exposure_ms"?'),
        ('name = "x"\nexposure_ms = 0\n[[steps]]\ndo = "mix"', "exposure_ms = 0.0 is not positive"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_in_one_sentence(tmp_path, text, reason):
    file = written(tmp_path, text)
    with pytest.raises(SequenceError, match=re.escape(reason)) as caught:
        load_sequence(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_or_not_text_is_refused(tmp_path):
    with pytest.raises(SequenceError, match=r"none\.toml: cannot be read"):
        load_sequence(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SequenceError, match="is not text"):
        load_sequence(tmp_path / "binary.toml")


@pytest.mark.parametrize(
    ("totals", "reason"),
    [
        ((1200.0,), "dose 1 of 1, dose to 1200 µl: one dose may have 1000 µl at most and this one has 1200"),
        ((900.0, 1800.0, 2400.0), "dose 3 of 3, dose to 2400 µl: the run may have 2000 µl at most"),
    ],
)
def test_a_sequence_over_a_budget_is_refused_before_anything_moves(totals, reason):
    sequence = Sequence("much", steps=(Series(totals, (Mix(),)),))
    with pytest.raises(SequenceError, match=reason):
        dry_run(sequence, LIMITS, Pace(), frame_bytes=2)


def test_ink_that_is_in_the_tank_already_counts():
    from tankrig.devices import Delivered

    sequence = Sequence("more", steps=(Series((500.0, 900.0), (Mix(),)),))
    tank = Delivered(500.0, 499.0, 501.0)
    assert dry_run(sequence, LIMITS, Pace(), 2, tank).ink_ul == 400.0
    with pytest.raises(SequenceError, match="the tank holds 700 µl already"):
        dry_run(sequence, LIMITS, Pace(), 2, Delivered(700.0, 699.0, 701.0))
    with pytest.raises(SequenceError, match="the tank may have 3000 µl"):
        dry_run(Sequence("x", (Dose(3100.0),)), LIMITS, Pace(), 2, Delivered(2900.0, 2900.0, 2900.0))
