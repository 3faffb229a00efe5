"""TOML files into checked dataclasses, with one sentence for whatever is wrong."""

import difflib
import json
import math
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from tankrig import bounded_reading
from tankrig.errors import TankrigError

T = TypeVar("T")

_ADVICE = {
    "float_type": "is not a number; give one, without quotes",
    "int_type": "is not a whole number; give one, without quotes",
    "int_from_float": "is not a whole number; give one",
    "string_type": "is not text; put it in quotes",
    "bool_type": "is neither true nor false; give one of them, without quotes",
    "tuple_type": "is not an array; put it in brackets: [ … ]",
    "too_long": "has too many entries; remove those beyond the last",
    "dataclass_type": "is not a table; give its keys and values",
    "model_type": "is not a table; give its keys and values",
    "dict_type": "is not a table; give its keys and values",
}
_UNKNOWN = ("unexpected_keyword_argument", "extra_forbidden")

MOST = 1e30
"""No number of a file is larger, in whatever unit: squares and products of two stay finite."""
MOST_WHOLE = 2**63 - 1
"""No whole number of a file is larger, a seed neither."""
MOST_LETTERS = 10_000
"""Of one text; people's reasons and notes are shorter."""
MOST_DEPTH = 32
"""Of tables and arrays within each other."""


OF_FILES = {"a sequence file": "steps", "a scene file": "medium", "a rig file": "doser"}
"""A key that each kind of file has, and no other."""


def read_toml(path: Path, what: str, error: type[TankrigError]) -> dict[str, Any]:
    """Parse a TOML file.

    Parameters
    ----------
    path
        Of the file.
    what
        What the file should be, for messages: "a sequence file".
    error
        What to raise when it cannot be read or is not TOML.
    """
    try:
        table = bounded_reading.parsed_toml(bounded_reading.text(path))
    except OSError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror or cause}); give the path of {what}") from cause
    except UnicodeDecodeError as cause:
        raise error(f"{path}: is not text, so not {what}; give a TOML file") from cause
    except ValueError as cause:
        raise error(f"{path}: is not TOML ({cause}); mend that line") from cause
    if OF_FILES.get(what, "") not in table and (others := [one for one, key in OF_FILES.items() if key in table]):
        raise error(f"{path}: is {others[0]}, where {what} is wanted; give that")
    return table


def checked(kind: type[T], table: dict[str, Any], name: str, error: type[TankrigError]) -> T:
    """Make a `kind` of a parsed file.

    Parameters
    ----------
    kind
        A dataclass or model that forbids extra keys.
    table
        What the file holds.
    name
        Of the file; stands first in every message.
    error
        What to raise, in one sentence, about the first unknown key or, with none, the first wrong value.

    Examples
    --------
    >>> from tankrig.errors import SceneError
    >>> from tankrig.scene import Medium
    >>> checked(Medium, {"sigma_a": 0.1, "sigma_s": 0.2, "g": 0}, "medium.toml", SceneError)
    Medium(sigma_a=0.1, sigma_s=0.2, g=0.0)
    >>> checked(Medium, {"sigma_a": 0.1, "sigma": 0.2, "g": 0}, "medium.toml", SceneError)
    Traceback (most recent call last):
    tankrig.errors.SceneError: medium.toml: key "sigma" is unknown; did you mean "sigma_s"?
    """
    from pydantic import TypeAdapter, ValidationError

    asked: Any = kind
    adapter: TypeAdapter[T] = adapter_of(asked)
    try:
        # As JSON, where strict validation still lets arrays become tuples and tables become dataclasses.
        found: T = adapter.validate_json(json.dumps(table, default=str))
    except ValidationError as cause:
        problems = sorted(cause.errors(), key=lambda problem: problem["type"] not in _UNKNOWN)
        said = _out_of_bounds(table) if problems[0]["type"] == "json_invalid" else ""
        raise error(f"{name}: {_readable(said or _sentence(problems[0], _schema_of(asked)))}") from cause
    except (ArithmeticError, ValueError, RecursionError) as cause:  # a key's check that took such a value for granted
        if said := _out_of_bounds(table):
            raise error(f"{name}: {said}") from cause
        raise
    if said := _out_of_bounds(table):
        raise error(f"{name}: {said}")
    return found


def _out_of_bounds(table: dict[str, Any]) -> str:
    """What is wrong with the first value that no key of any file could have; empty where there is none.

    Whatever else a key's own check forgets, it meets only finite numbers, and texts that can be printed.
    """
    waiting: list[tuple[str, Any, int]] = [("", table, 0)]
    while waiting:
        place, value, depth = waiting.pop()
        if depth > MOST_DEPTH:
            return f"{_cut(place)} is nested deeper than anything that is known; take it out"
        if isinstance(value, dict):
            inner = [(f"{place}.{key}" if place else str(key), one, depth + 1) for key, one in value.items()]
            if wrong := [key for key in value if not _is_plain(str(key))]:
                return f"key {_shown(str(wrong[0]))} has letters that no key has; remove it"
        elif isinstance(value, list | tuple):
            inner = [(f"{place}[{index}]", one, depth + 1) for index, one in enumerate(value)]
        else:
            if what := _refused(value):
                return f"{place} = {_shown(value)} {what}"
            continue
        waiting.extend(reversed(inner))
    return ""


def _refused(value: Any) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return "is not a finite number; give a finite one"
    if isinstance(value, float) and abs(value) > MOST:
        return "is larger than any number that has a meaning here; give a smaller one"
    if isinstance(value, int) and abs(value) > MOST_WHOLE:
        return "is larger than any whole number that has a meaning here; give a smaller one"
    if isinstance(value, str) and len(value) > MOST_LETTERS:
        return f"has {len(value)} letters; give {MOST_LETTERS} at most"
    if isinstance(value, str) and not _is_plain(value.replace("\n", "").replace("\t", "")):
        return "has letters that cannot be printed; remove them"
    return ""


def _is_plain(text: str) -> bool:
    """Whether a text has no control characters, which would tear a sentence or a path apart."""
    return not any(letter < " " or "\x7f" <= letter < "\xa0" for letter in text)


@cache
def adapter_of(kind: Any) -> Any:
    """What checks a kind, and makes plain data of it; making it takes longer than using it."""
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


@cache
def _schema_of(kind: Any) -> dict[str, Any]:
    """Keys that a kind knows. Making it takes longer than all the rest, and whoever types is told with each letter."""
    schema: dict[str, Any] = adapter_of(kind).json_schema()
    return schema


def _sentence(problem: Any, schema: dict[str, Any]) -> str:
    """One of pydantic's error records in words."""
    kind, value = problem["type"], problem["input"]
    place, known = _walk(list(problem["loc"]), schema)
    if kind == "value_error":  # raised by a dataclass's own check; names its key already
        return f"{place}{'.' if place else ''}{problem['ctx']['error']}"
    if kind in _UNKNOWN:
        return f'key "{place}" is unknown; {_near(place.rpartition(".")[2], known, "remove it")}'
    if kind in ("missing", "missing_argument"):
        if place.endswith("]"):  # an array that is too short; pydantic places the absent entry
            return f"{place.rpartition('[')[0]} = {_shown(value)} has too few entries; add the missing ones"
        return f'key "{place}" is missing; add it'
    if kind == "union_tag_not_found":
        return f"{place} has no key {problem['ctx']['discriminator']}; add it to say what it is"
    if kind == "union_tag_invalid":
        tags = [tag.strip("' ") for tag in problem["ctx"]["expected_tags"].split(",")]
        key, tag = problem["ctx"]["discriminator"].strip("'"), problem["ctx"]["tag"]
        return f'{place}.{key} = "{tag}" is unknown; {_near(tag, tags, "use one of " + ", ".join(tags))}'
    if kind == "literal_error":
        advice = "is unknown; use " + str(problem["ctx"]["expected"]).replace("'", '"')
    else:
        advice = _ADVICE.get(kind, f"is refused: {problem['msg']}")
    return f"{place} = {_shown(value)} {advice}"


def _near(word: str, known: list[str], otherwise: str) -> str:
    close = difflib.get_close_matches(word, known, n=1)
    return f'did you mean "{close[0]}"?' if close else otherwise


def _walk(loc: list[Any], schema: dict[str, Any]) -> tuple[str, list[str]]:
    """Where in the file a problem is, in TOML's words, and the keys that are known beside it.

    Pydantic's place also names the chosen kind of a table that can be of several kinds; that is no key of the file.
    """
    place, known, node = "", list(schema.get("properties", ())), _resolved(schema, schema)
    for part in loc:
        kinds = node.get("discriminator", {}).get("mapping", {})
        if part in kinds:
            node = _resolved({"$ref": kinds[part]}, schema)
            continue
        known = list(node.get("properties", known))
        place += f"[{part}]" if isinstance(part, int) else f".{_cut(part)}" if place else _cut(str(part))
        inner = node.get("items") if isinstance(part, int) else node.get("properties", {}).get(part)
        node = _resolved(inner or node.get("additionalProperties") or {}, schema)
    return place, known


def _resolved(node: Any, schema: dict[str, Any]) -> dict[str, Any]:
    if not isinstance(node, dict):
        return {}
    if "$ref" in node:
        return _resolved(schema["$defs"][node["$ref"].rpartition("/")[2]], schema)
    for choice in node.get("anyOf", ()):  # a key that may be absent
        if choice.get("type") != "null":
            return _resolved(choice, schema)
    return node


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)  # nan and inf as TOML writes them
    try:
        return _cut(json.dumps(value, default=str, ensure_ascii=False))
    except ValueError:  # a whole number of more digits than Python writes
        return f"{value:.2e}" if abs(value) < MOST else "a number of thousands of digits"


def _readable(sentence: str) -> str:
    """A sentence without the middle of what makes it endless: names of hundreds of letters that a file gives."""
    return sentence if len(sentence) <= 600 else f"{sentence[:400]} … {sentence[-160:]}"


def _cut(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "…"
