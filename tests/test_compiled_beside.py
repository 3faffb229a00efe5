"""A first prediction's second compiler: it compiles what the prediction needs, and nobody waits for it in vain."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba import typeof

import tankrig
from tankrig.light import compiled_beside
from tankrig.light.compiled_beside import begun, compile_paths, paths_compiled_beside
from tankrig.light.paths import lattices
from tankrig.light.tank import tank_image
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

from .xserver import until

REFERENCES = Path(__file__).parent / "data" / "reference"
LIGHT = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
SCENE = Scene(Tank(), Medium(0.0002, 0.0198, 0.5), LIGHT, Camera("orthographic", (40, 60), 4.0))


def kinds_of_arguments(follow: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> set[Any]:
    """That paths are traced with, each of which is compiled by itself."""
    kinds = set()
    with monkeypatch.context() as patch:
        trace = lattices.trace
        patch.setattr(lattices, "trace", lambda *all_of: (kinds.add(tuple(map(typeof, all_of))), trace(*all_of)))
        follow()
    return kinds


@pytest.mark.parametrize("name", ["pub02", "pub09"])
def test_what_is_compiled_beside_is_what_the_image_needs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the second processor would work for nothing, and the first prediction take longer than without it."""
    scene = tankrig.load_scene(REFERENCES / f"{name}.toml")
    beside = kinds_of_arguments(lambda: compile_paths(scene), monkeypatch)
    assert beside
    assert beside == kinds_of_arguments(lambda: tank_image(scene, 0.3), monkeypatch)


def test_the_other_process_finds_the_program_and_ends_by_itself() -> None:
    other = begun(SCENE)
    assert other is not None
    assert other.wait(200.0) == 0


def test_a_process_asks_for_another_once_however_many_images_it_makes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first fit after an installation started one for each image, and took three minutes for six seconds."""
    monkeypatch.setattr(compiled_beside, "THREADS", 2)
    monkeypatch.setattr(compiled_beside, "kept", lambda _: False)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})
    compiled_beside.first_time.cache_clear()
    assert [compiled_beside.wanted() for _ in range(3)] == [True, False, False]


@pytest.fixture
def sleeping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Path]:
    """The first time, with a program in place of Python that never ends: where the system tells of its process."""
    program, number = tmp_path / "sleeps", tmp_path / "number"
    program.write_text(f"#!/bin/sh\necho $$ > {number}.new; mv {number}.new {number}\nexec sleep 1000\n")
    program.chmod(0o755)
    monkeypatch.setattr(compiled_beside, "wanted", lambda: True)
    monkeypatch.setattr(sys, "executable", str(program))

    def process() -> Path:
        until(number.exists, 60.0)
        return Path("/proc", number.read_text().strip())

    return process


def test_an_error_ends_the_other_process(sleeping: Callable[[], Path]) -> None:
    found: list[bool] = []

    def stopped() -> None:
        with paths_compiled_beside(SCENE):
            found.append(sleeping().exists())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert found == [True]
    assert not sleeping().exists()


def test_one_that_hangs_is_given_up(sleeping: Callable[[], Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_beside, "PATIENCE_S", 0.2)
    with paths_compiled_beside(SCENE):
        there = sleeping()
        began = time.monotonic()
    assert time.monotonic() - began >= 0.2
    assert not there.exists()


@pytest.mark.parametrize("program", ["", "/nowhere/python", "/bin/false"])
def test_without_another_process_the_image_is_the_same(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python may be part of another program, and may be found no more after an update."""
    expected = tank_image(SCENE, 0.3).image
    monkeypatch.setattr(compiled_beside, "wanted", lambda: True)
    monkeypatch.setattr(sys, "executable", program)
    assert (tank_image(SCENE, 0.3).image == expected).all()
