"""The sequence page's text: what it says of right and wrong files, and the way back from each edit."""

from pathlib import Path

import pytest
from PySide6.QtCore import Qt

from tests import on_page
from tests.window_rig import write_rig
from ui.window import sequence_text
from ui.window.forms import Form
from ui.window.sequence_document import SequenceDocument

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "dilution.toml"


@pytest.fixture
def document():
    made = SequenceDocument()
    made.load(EXAMPLE)
    return made


@pytest.mark.parametrize(
    ("right", "wrong", "line"),
    [
        ("period_mm = 16.0", "period_m = 16.0", "period_m = 16.0"),
        ('pattern = "rays", frames = 4', 'pattern = "ray", frames = 4', '"ray"'),
        ('do = "capture", pattern = "dark", frames = 2', 'do = "capture", pattern = "dark", frames = 0', None),
        ("gain = 1.0", "gain = = 1.0", None),
        ('do = "series"', 'do = "serie"', 'do = "serie"'),
        ("[100.0, 200.0, 400.0, 800.0, 1600.0]", "[100.0, 900.0, 800.0]", "total_ul = [100.0, 900.0, 800.0]"),
        ("y_mm = [-40.0, 0.0, 40.0]", "y_mm = 5", "y_mm = 5"),
    ],
)  # fmt: skip
def test_the_wrong_line_is_found(right, wrong, line):
    """A person mends the line that is marked; a wrong mark is worse than none."""
    text = EXAMPLE.read_text()
    assert right in text
    found = sequence_text.read(text.replace(right, wrong, 1), EXAMPLE.parent)
    assert found.sequence is None
    marked = text.replace(right, wrong, 1).splitlines()[found.problem.line - 1]
    assert (line or wrong) in marked


def test_of_a_file_that_is_no_toml_the_rest_stays_usable():
    """The patterns before a torn line can still be looked at."""
    found = sequence_text.read(EXAMPLE.read_text().replace('do = "note"', 'do = "note'), EXAMPLE.parent)
    assert found.problem.line > 0
    assert set(found.table["patterns"]) == {"sheet", "stripes", "rays"}


def test_edits_keep_comments_and_come_back_one_by_one(document):
    """An edit that loses the file's comments, or cannot be undone, is not trusted twice."""
    before = document.text
    document.edit("exposure", lambda toml: toml.__setitem__("exposure_ms", 35.0))
    assert document.reading.sequence.exposure_ms == 35.0
    document.edit("frames", lambda toml: toml["steps"][1]["steps"][1].__setitem__("frames", 7))
    assert document.reading.sequence.tasks[3].action.frames == 7
    assert before.count("#") == document.text.count("#")
    document.undo.undo()
    assert document.reading.sequence.tasks[3].action.frames == 2
    document.undo.undo()
    assert document.text == before
    document.undo.redo()
    assert document.reading.sequence.exposure_ms == 35.0


def test_what_a_person_builds_is_not_told_in_the_language_of_files(document):
    """'key "steps" is missing; add it' stood above a form with no steps."""
    document.begin_anew()
    assert document.empty
    assert document.path is None
    assert document.problem.sentence == sequence_text.NO_STEPS
    assert not document.undo.canUndo()


def test_what_is_typed_is_undone_together(document):
    """Undo by the letter is no undo."""
    before = document.text
    for end in range(1, 6):
        document.edit_text(before + "# seen"[:end])
    document.undo.undo()
    assert document.text == before


def test_budgets_are_checked_while_editing(document, tmp_path):
    """A dose that the guard will refuse must be red before the run, not in it."""
    from drivers.rig import load_rig_file

    document.set_rig(load_rig_file(write_rig(tmp_path)))
    assert document.problem is None
    assert document.plan.ink_ul == 1600.0
    document.edit_text(document.text.replace("800.0, 1600.0", "800.0, 2600.0"))
    assert "one dose may have 1000 µl at most" in document.problem.sentence
    assert "2600" in document.text.splitlines()[document.problem.line - 1]
    document.undo.undo()
    document.edit_text(document.text.replace("duty = 0.5", "duty = 1.5"))
    assert document.problem.sentence.startswith("patterns.stripes.duty = 1.5 is outside")
    assert "duty = 1.5" in document.text.splitlines()[document.problem.line - 1]


def test_a_saved_sequence_is_the_one_that_was_edited(document, tmp_path):
    """What runs tomorrow is what is in the file."""
    from tankrig.sequence import load_sequence

    document.edit("gain", lambda toml: toml.__setitem__("gain", 2.0))
    document.save(tmp_path / "mine.toml")
    assert load_sequence(tmp_path / "mine.toml").gain == 2.0
    assert not document.unsaved


def test_steps_and_patterns_are_built_from_nothing():
    """A person with no file begins here."""
    from ui.window.patterns_editor import PatternsEditor
    from ui.window.steps_editor import NEW, StepsEditor

    document = SequenceDocument()
    steps, patterns = StepsEditor(document), PatternsEditor(document)
    assert document.problem is not None  # it has no steps
    for kind in NEW:
        on_page.choice(steps, "what to add").setCurrentText(kind)
        steps.add()
    assert [task.label for task in document.reading.sequence.tasks][:2] == ["capture full × 4", "dose to 100 µl"]
    on_page.choice(patterns, "which kind of pattern").setCurrentText("stripes")
    patterns.add()
    assert document.reading.sequence.patterns["stripes"].period_mm == 16.0
    steps.choose(("steps", 3))
    form = steps.findChild(Form)
    totals = form.rows["total_ul"]
    on_page.fill(totals, "150 oops")
    assert totals.says.text().startswith("give numbers in µl")
    assert totals.edit.property("wrong")
    on_page.fill(totals, "150 250 350")
    assert document.reading.sequence.steps[3].total_ul == (150.0, 250.0, 350.0)
    steps.move_step(-1)
    assert document.reading.sequence.steps[2].do == "series"
    steps.remove()
    assert "series" not in document.text


WRONG = (
    'exposure_ms = "much"\n',
    "steps = 3\n",
    "patterns = true\n",
    "patterns = []\n[[steps]]\ndo = 1\n",
    '[patterns.a]\nkind = "rays"\ny_mm = "wide"\n',
    '[[steps]]\ndo = "series"\ntotal_ul = "a"\nsteps = [3, { do = "x" }]\n',
    '[[steps]]\ndo = "capture"\npattern = ["a"]\nframes = "x"\n',
    "[[steps]]\nsteps = { a = 1 }\n",
    '"',
)


@pytest.mark.parametrize("text", WRONG)
def test_whatever_a_file_says_it_opens_and_the_rest_can_be_edited(text):
    """A file that brings the editor down cannot be mended in it."""
    from ui.window.sequence_page import SequencePage

    page = SequencePage()
    page.document.take(text)
    assert page.document.problem is not None
    for item in page.steps.tree.findItems("", Qt.MatchFlag.MatchContains | Qt.MatchFlag.MatchRecursive):
        page.steps.tree.setCurrentItem(item)
    page.steps.add()
    page.patterns.add()
    while page.document.undo.canUndo():
        page.document.undo.undo()
    assert page.document.text == text


def test_a_bursts_patterns_are_a_line_of_names(qtbot):
    from tankrig.sequence import Burst
    from ui.window.forms import Form
    from ui.window.steps_editor import words_of

    assert words_of({"do": "burst", "patterns": ["a", "b"], "times": 3}) == "burst of 2 patterns × 3"
    form = Form(Burst, {"patterns": ["a", "b"]}, {}, skip=("do",))
    qtbot.addWidget(form)
    field = form.rows["patterns"]
    assert field.value == ["a", "b"]
    assert not field.wrong
