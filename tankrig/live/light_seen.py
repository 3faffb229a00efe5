"""Whether the camera can see what a sequence's patterns light, before anything moves."""

import warnings

import numpy as np

from tankrig.bench import Bench
from tankrig.errors import SceneError, SequenceError
from tankrig.pattern import Pattern
from tankrig.pattern.kinds import Dark
from tankrig.scene.description import Medium, Scene
from tankrig.scene.outline import beam_outlines
from tankrig.sequence import Sequence

_ANY = Medium(0.0, 0.01, 0.0)
_ALONG, _ACROSS = 41, 5
"""Points of a beam's outline that are looked for in the picture."""


def require_light_seen(sequence: Sequence, bench: Bench) -> None:
    """Refuse a sequence with a pattern of whose light the camera sees nothing; `Dark` patterns are meant to be dark.

    Parameters
    ----------
    sequence
        Its patterns are drawn for the bench.
    bench
        As calibrated.

    Raises
    ------
    SequenceError
        In one sentence that names the pattern, and what is wrong with it.
    """
    for name, pattern in sequence.drawn(bench.wall).items():
        meant_to_be_dark = isinstance(sequence.patterns.get(name, Dark() if name == "dark" else None), Dark)
        if not meant_to_be_dark and (fault := _unseen(pattern, bench)):
            where = f"{sequence.called}: {sequence.first_with(name)}"
            raise SequenceError(f'{where}: pattern "{name}" cannot be fitted: it {fault}')


def _unseen(pattern: Pattern, bench: Bench) -> str:
    """What is wrong with a pattern, and what to do; empty where its light is seen."""
    if not pattern.pixels.any():
        return 'lights nothing, all of its pixels are 0; draw it, or capture "dark" where none is meant to be'
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about how well it can be modelled
            scene = bench.scene(pattern, _ANY)
    except SceneError as error:
        return f"lights nothing in the tank ({error})"
    if not _in_the_picture(scene):
        return "lights nothing that the camera sees: its beams pass beside the picture; move the pattern or the camera"
    return ""


def _in_the_picture(scene: Scene) -> bool:
    """Whether any part of a beam lies in the camera's picture."""
    camera = scene.camera
    rows, columns = camera.shape
    left, top = 0.0, -scene.tank.size_mm[1] / 2.0
    right, bottom = left + columns * camera.pixel_mm, top + rows * camera.pixel_mm
    along, across = np.linspace(0.0, 1.0, _ALONG)[:, None], np.linspace(0.0, 1.0, _ACROSS)[:, None, None]
    for low_in, low_out, high_out, high_in in beam_outlines(scene):
        low, high = low_in + along * (low_out - low_in), high_in + along * (high_out - high_in)
        x, y = np.moveaxis(low + across * (high - low), -1, 0)
        if ((x > left) & (x < right) & (y > top) & (y < bottom)).any():
            return True
    return False
