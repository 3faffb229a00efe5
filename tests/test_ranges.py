"""A range is declared once: files, Python and forms refuse the same numbers, and take the same ones."""

import dataclasses
import math
import os
import typing
from typing import Any

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tankrig.bench import Bench
from tankrig.calibration.tolerances import Tolerances
from tankrig.dosing import DoseLimits
from tankrig.errors import SequenceError, TankrigError
from tankrig.pattern.kinds import KINDS, Cells
from tankrig.pattern.wall import Wall
from tankrig.ranges import Within, ranges_of
from tankrig.scene import Beam, Camera, Medium, Projector, Tank
from tankrig.scene.free_phase import FreePhase
from tankrig.scene.mie import Mie
from tankrig.scene.optics import Blur, Face, Halo, WideLens
from tankrig.scene.phase_functions import FournierForand, HenyeyGreenstein, ReynoldsMcCormick, TwoTerm
from tankrig.sequence import Burst, Capture, Dose, Mix, Pace, Repeat, Wait
from tankrig.sequence.loading import sequence_from_table

NEEDED: dict[str, Any] = {
    "total_ul": 10.0, "pattern": "full", "patterns": ["full"], "times": 2, "seconds": 1.0, "bit": 1, "period_px": 8.0,
    "step": 1, "cell_px": 4, "index": 1, "y_mm": [-10.0, 10.0], "z_mm": [50.0, 60.0], "period_mm": 8.0, "path": "x.png",
    "steps": [{"do": "wait", "seconds": 1.0}], "light": [[1.0]],
}  # fmt: skip
"""Values of fields that have to be given."""
KINDS_OF_STEPS = (Dose, Mix, Capture, Burst, Wait, Repeat)
DECLARED = [(kind, name) for kind in (*KINDS_OF_STEPS, *KINDS) for name in ranges_of(kind)]

WALL, PLAIN = Wall((12, 16), (-80.0, 80.0), (0.0, 120.0)), Camera("orthographic", (20, 30), 8.0)
PARTS = (
    Tank(), Medium(0.001, 0.01, 0.5), Beam((-2.0, 2.0), (58.0, 62.0)), PLAIN, Blur(), Halo(), WideLens(), Face(), WALL,
    Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),)), HenyeyGreenstein(0.5), TwoTerm(0.9, -0.3, 0.9),
    ReynoldsMcCormick(0.6, 1.0), FournierForand(1.1, 3.6), Mie(0.5, 1.58, 1.33, 2000.0), FreePhase(0.8, ()),
    Bench(Tank(), WALL, "collimated", PLAIN), DoseLimits(10.0, 20.0, 30.0), Pace(), Tolerances(),
)  # fmt: skip
"""Of scenes and rig files."""
OF_PARTS = [(part, name) for part in PARTS for name in ranges_of(type(part))]


def whole(kind: type, name: str) -> bool:
    """Whether a field takes whole numbers."""
    hint = typing.get_type_hints(kind)[name]
    return int in (hint, *typing.get_args(hint))


def numbers(within: Within, only_whole: bool) -> st.SearchStrategy[float]:
    """Anything, its ends, and beside them."""
    if only_whole:
        ends = [int(within.low) - 1, int(within.low), int(within.high), int(within.high) + 1]
        return st.sampled_from(ends) | st.integers(-(10**13), 10**13)
    ends = [end for low in (within.low, within.high) for end in (low, math.nextafter(low, -1e9), low + 1e-9)]
    return st.sampled_from(ends) | st.floats(-1e12, 1e12)


def table_of(kind: type, name: str, value: float) -> dict[str, Any]:
    """A sequence's table in which a step or a pattern has a number."""
    fields = {one.name: one for one in dataclasses.fields(kind) if one.init}
    given_here = {key: NEEDED[key] for key, one in fields.items() if one.default is dataclasses.MISSING}
    if kind is Cells:
        given_here["z_mm"] = [given_here["z_mm"]]  # of each sheet
    word = "do" if "do" in fields else "kind"
    one = {**given_here, word: fields[word].default, name: value}
    if name == "timeout_s" and kind is Capture:
        one["until"] = {"g": 0.1}
    if word == "do":
        return {"name": "x", "steps": [one]}
    return {"name": "x", "patterns": {"it": one}, "steps": [{"do": "wait", "seconds": 1.0}]}


@pytest.mark.parametrize(("kind", "name"), DECLARED)
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_a_file_refuses_what_is_outside_in_the_declared_words_and_nothing_else_for_that(
    kind: type, name: str, data: st.DataObject
) -> None:
    within = ranges_of(kind)[name]
    value = data.draw(numbers(within, whole(kind, name)))
    said = ""
    try:
        sequence_from_table(table_of(kind, name, value), "sequence.toml")
    except SequenceError as refusal:
        said = str(refusal)
    assert (f"{name} = {value} {within.advice}" in said) == (not within.holds(value)), said


@pytest.mark.parametrize(("kind", "name"), DECLARED)
def test_a_form_takes_what_a_file_takes(kind: type, name: str) -> None:
    """What the window cannot enter a person has to write into the file by hand."""
    from ui.window.app import application
    from ui.window.forms import Form

    application()
    within = ranges_of(kind)[name]
    field: Any = Form(kind, {}, {}).rows[name]
    step = 1 if whole(kind, name) else 1e-6 * max(1.0, abs(within.low))
    for value in (within.low - step, within.low, within.low + step, within.high, 2 * within.high + 1):
        field.set_text(f"{value:.17g}")
        assert (not field.wrong) == within.holds(value), field.wrong


@pytest.mark.parametrize(
    ("part", "name"), OF_PARTS, ids=lambda one: one if isinstance(one, str) else type(one).__name__
)
@given(data=st.data())
@settings(max_examples=15, deadline=None)
def test_parts_of_scenes_and_rig_files_refuse_what_is_outside_in_the_declared_words_and_nothing_else(
    part: Any, name: str, data: st.DataObject
) -> None:
    within = ranges_of(type(part))[name]
    value = data.draw(numbers(within, False))
    several = isinstance(getattr(part, name), tuple)
    said = ""
    try:
        dataclasses.replace(part, **{name: (value, *getattr(part, name)[1:]) if several else value})
    except TankrigError as refusal:
        said = str(refusal)
    if not within.holds(value):
        assert said.startswith(f"{name} = ")
        assert said.endswith(within.refusal(value))
    else:
        assert said == "" or name == "pixel_mm"  # of which a plain camera may have less than any does


def test_nothing_is_declared_in_vain() -> None:
    """A type that is changed must not lose its range."""
    assert len(DECLARED) >= 25
    assert len(OF_PARTS) >= 45
    assert {name for _, name in DECLARED} >= {"total_ul", "exposure_ms", "gain", "frames", "times", "seconds", "level"}
