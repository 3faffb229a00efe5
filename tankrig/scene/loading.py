"""From a scene file (TOML) to a checked `Scene`."""

import difflib
import json
import os
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from tankrig.errors import SceneError
from tankrig.scene.description import Beam, Scene

MAY_BE_ABSENT = {"refractive_index", "position_mm"}
"""Keys that a file need not have; those that a scene needs after all (a pinhole's position) the scene asks for."""

ADVICE = {
    "float_type": "is not a number; give one, without quotes",
    "int_type": "is not a whole number; give one, without quotes",
    "int_from_float": "is not a whole number; give one",
    "tuple_type": "is not an array; put it in brackets: [ … ]",
    "too_long": "has too many entries; remove those beyond the last",
    "dataclass_type": "is not a table; give its keys and values",
}
"""What to say about each kind of wrong value (pydantic's name of it)."""


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path
        A TOML file with the tables `tank`, `medium`, `projector` and `camera` (see docs/scene.md).

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        In one sentence: the file, the key, its value, and what to do.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> text = '''
    ... [tank]
    ... size_mm = [240.0, 160.0, 120.0]
    ... surface = "matched"
    ... [medium]
    ... sigma_a = 0.0002
    ... sigma_s = 0.0198
    ... g = 0.5
    ... [projector]
    ... kind = "collimated"
    ... beams = [ { y_mm = [-2.0, 2.0], z_mm = [58.0, 62.0], irradiance = 1.0 } ]
    ... [camera]
    ... kind = "orthographic"
    ... shape = [80, 120]
    ... pixel_mm = 2.0
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "scene.toml")
    ...     _ = file.write_text(text)
    ...     load_scene(file).medium
    Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.5)
    """
    file = Path(path)
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise SceneError(
            f"{file}: cannot be read ({error.strerror or error}); give the path of a scene file"
        ) from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: is not text, so not a scene file; give a TOML file") from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, a nest of thousands of arrays
        raise SceneError(f"{file}: is not TOML ({error}); mend that line") from error
    return replace(scene_from_table(table, str(file)), source=str(file))


def scene_from_table(table: dict[str, Any], name: str) -> Scene:
    """Check a parsed scene file; `name` stands first in every message.

    Raises
    ------
    SceneError
        Naming the first key that is wrong.
    """
    from pydantic import TypeAdapter, ValidationError

    _check_keys(table, Scene, "", name)
    try:
        # As JSON, where strict validation still lets arrays become tuples and tables become dataclasses.
        return TypeAdapter(Scene).validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        raise SceneError(f"{name}: {_sentence(error.errors()[0])}") from error


def _check_keys(table: dict[str, Any], kind: type, place: str, name: str) -> None:
    """Refuse unknown keys, then missing ones, before any value is looked at: a misspelt key is both."""
    known = {item.name: item.type for item in fields(kind) if item.name != "source"}
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            advice = f'did you mean "{near[0]}"?' if near else f"remove it (known here: {', '.join(known)})"
            raise SceneError(f'{name}: key "{place}{key}" is unknown; {advice}')
    for key, inner in known.items():
        if key not in table:
            if key not in MAY_BE_ABSENT:
                raise SceneError(f'{name}: key "{place}{key}" is missing; add it (docs/scene.md shows how)')
        elif isinstance(inner, type) and is_dataclass(inner) and isinstance(table[key], dict):
            _check_keys(table[key], inner, f"{place}{key}.", name)
        elif key == "beams" and isinstance(table[key], list):
            for index, beam in enumerate(table[key]):
                if isinstance(beam, dict):
                    _check_keys(beam, Beam, f"{place}{key}[{index}].", name)


def _sentence(problem: Any) -> str:
    """One of pydantic's error records in the words of a scene file."""
    place, kind, value = list(problem["loc"]), problem["type"], problem["input"]
    if kind == "value_error":  # raised by a dataclass's own check; names its key already
        return f"{_dotted(place)}.{problem['ctx']['error']}".lstrip(".")
    if kind == "missing":  # an array that is too short; pydantic places the absent element
        return f"{_dotted(place[:-1])} = {_shown(value)} has too few entries; add the missing ones"
    if kind == "literal_error":
        advice = "is unknown; use " + str(problem["ctx"]["expected"]).replace("'", '"')
    else:
        advice = ADVICE.get(kind, f"is refused: {problem['msg']}")
    return f"{_dotted(place)} = {_shown(value)} {advice}"


def _dotted(place: list[Any]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")


def _shown(value: Any) -> str:
    """A value as TOML would write it."""
    text: str = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "…"
