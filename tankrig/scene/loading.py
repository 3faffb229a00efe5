"""From a scene file (TOML) to a checked `Scene`."""

import difflib
import json
import os
import tomllib
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

from tankrig.errors import SceneError
from tankrig.scene.description import Scene


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
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError(
            f"{file}: cannot be read ({error.strerror or error}); give the path of a scene file"
        ) from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: is not text, so not a scene file; give a TOML file") from error
    except tomllib.TOMLDecodeError as error:
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

    if "source" in table:  # a field of Scene that no file may set
        raise SceneError(f'{name}: key "source" is unknown; remove it')
    try:
        # As JSON, where strict validation still lets arrays become tuples and tables become dataclasses.
        return TypeAdapter(Scene).validate_json(json.dumps(table, default=str))
    except ValidationError as error:
        raise SceneError(f"{name}: {_sentence(error.errors()[0])}") from error


def _sentence(problem: Any) -> str:
    """One of pydantic's error records in the words of a scene file."""
    place = [part for part in problem["loc"] if part not in ("function-after",)]
    key = _dotted(place)
    kind, message, value = problem["type"], problem["msg"], problem["input"]
    if kind == "value_error":  # raised by a dataclass's own check; names its key already
        text = str(problem["ctx"]["error"])
        return f"{key}.{text}" if key else text
    if kind in ("missing", "missing_argument"):
        return f'key "{key}" is missing; add it'
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        near = difflib.get_close_matches(str(place[-1]), _known_keys(place[:-1]), n=1)
        return f'key "{key}" is unknown; ' + (f'did you mean "{near[0]}"?' if near else "remove it")
    message = message.replace("Input should", "should").replace("a valid tuple", "an array").replace("a valid ", "a ")
    return f"{key} = {_shown(value)} {message[0].lower()}{message[1:]}"


def _dotted(place: list[Any]) -> str:
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _shown(value: Any) -> str:
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= 60 else text[:57] + "…"


def _known_keys(place: list[Any]) -> list[str]:
    """Keys of the table at `place`, found by walking the dataclasses."""
    kind: Any = Scene
    for part in place:
        kind = get_args(kind)[0] if isinstance(part, int) else get_type_hints(kind).get(part, kind)
    return [item.name for item in fields(kind) if item.name != "source"] if is_dataclass(kind) else []
