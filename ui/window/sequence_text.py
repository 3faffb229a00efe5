"""A sequence as text: what it says, where it is wrong, and how an edit changes it."""

import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
import tomlkit.exceptions

from tankrig.errors import SequenceError
from tankrig.sequence.loading import sequence_beside
from tankrig.sequence.sequence import Sequence

Path_ = tuple[str | int, ...]
"""Keys and numbers that lead to a place in a TOML document."""

EMPTY = 'name = "new sequence"\nexposure_ms = 20.0\n'
STEPS_MISSING = 'key "steps" is missing; add it'
NO_STEPS = "there are no steps yet; add one on the tab Steps"
"""What a person who builds a sequence is told, rather than which key its file lacks."""


@dataclass(frozen=True)
class Problem:
    """What is wrong, and in which line of the text, from 1; 0 where no line is to blame."""

    sentence: str
    line: int


@dataclass(frozen=True)
class Reading:
    """What a text says.

    Parameters
    ----------
    table
        The parsed text, or of the part before the line that is wrong.
    sequence
        Where nothing is wrong.
    problem
        Else.
    """

    table: dict[str, Any]
    sequence: Sequence | None = None
    problem: Problem | None = None


def read(text: str, folder: Path, name: str = "sequence") -> Reading:
    """Read a sequence as far as it makes sense.

    Parameters
    ----------
    text
        TOML.
    folder
        Which the paths of its pictures are relative to.
    name
        For messages.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        line = _line_of_syntax(str(error), text)
        return Reading(_before(text, line), problem=Problem(f"line {line} is not TOML: {error}", line))
    try:
        return Reading(table, sequence_beside(folder, table, name))
    except SequenceError as error:
        sentence = str(error).removeprefix(f"{name}: ")
        if sentence == STEPS_MISSING:
            return Reading(table, problem=Problem(NO_STEPS, 0))
        return Reading(table, problem=Problem(sentence, line_of(text, sentence)))


def edited(text: str, change: Callable[[Any], object]) -> str:
    """The text after `change` was applied to its document; comments and order stay.

    Raises
    ------
    SequenceError
        When the text is no TOML, so that only its text can be edited.
    """
    try:
        document = tomlkit.parse(text)
    except tomlkit.exceptions.TOMLKitError as error:
        raise SequenceError(f"the text is not TOML ({error}); mend the marked line first") from error
    try:
        change(document)
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        raise SequenceError("what is to be changed is not there as it should be; mend the marked line first") from error
    return tomlkit.dumps(document)


def patterns_of(table: dict[str, Any]) -> dict[str, Any]:
    """The patterns of a parsed sequence, as far as they are patterns."""
    patterns = table.get("patterns")
    return {name: one for name, one in patterns.items() if isinstance(one, dict)} if isinstance(patterns, dict) else {}


def at(document: Any, place: Path_) -> Any:
    """The part of a document that a path leads to."""
    for key in place:
        document = document[key]
    return document


def line_of(text: str, sentence: str) -> int:
    """The line that a message about a sequence speaks of; 0 where none is found.

    >>> line_of('a = 1\\n[[steps]]\\ndo = "note"\\n[[steps]]\\ndo = "dance"', 'steps[1].do = "dance" is unknown')
    5
    """
    lines = text.splitlines()
    first, last = 0, len(lines)
    place = re.match(r'(?:key ")?([A-Za-z_][\w.\[\]-]*)', sentence)
    parts = re.findall(r"[\w-]+", place.group(1)) if place else []
    found = 0
    while parts:
        part = parts.pop(0)
        if part == "patterns" and parts:
            part = parts.pop(0)
            pattern, inner = rf"\s*(\[patterns\.[\"']?{re.escape(part)}[\"']?\]|patterns\.{re.escape(part)}\b)", False
            number = 0
        elif part == "steps" and parts and parts[0].isdigit():
            number, inner = int(parts.pop(0)), found > 0
            pattern = r"[^#]*\{\s*\w" if inner else r"\s*\[\[steps\]\]"
        else:
            pattern, number, inner = rf"(\s*|[^#]*[{{,]\s*){re.escape(part)}\s*=", 0, True
        hits = [row for row in range(first, last) if re.match(pattern, lines[row])]
        if len(hits) <= number:
            break
        found, first = hits[number] + 1, hits[number]
        if not inner:
            last = next((row for row in range(found, len(lines)) if re.match(r"\s*\[", lines[row])), len(lines))
    return found or _line_of_quoted(lines, sentence)


def _line_of_quoted(lines: list[str], sentence: str) -> int:
    """The last line that holds a word which the message puts in quotes, or its number."""
    for word in re.findall(r'"([^"]+)"', sentence) + re.findall(r"to ([\d.]+) µl", sentence):
        hits = [row for row, line in enumerate(lines, 1) if re.search(rf"(?<![\w.]){re.escape(word)}(?![\w])", line)]
        if hits:
            return hits[-1]
    return 0


def _line_of_syntax(message: str, text: str) -> int:
    found = re.search(r"line (\d+)", message)
    return int(found.group(1)) if found else len(text.splitlines())


def _before(text: str, line: int) -> dict[str, Any]:
    """What stands before a line that is no TOML, as far as it can be read."""
    lines = text.splitlines()
    for end in range(min(line - 1, len(lines)), 0, -1):
        try:
            return tomllib.loads("\n".join(lines[:end]))
        except tomllib.TOMLDecodeError:
            continue
    return {}
