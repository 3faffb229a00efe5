"""Steps and patterns as TOML that a person would have written."""

from itertools import chain, count
from typing import Any

import tomlkit


def step_table(step: dict[str, Any], nested: bool) -> Any:
    """A step as a table of its own or, nested in another step, on one line.

    >>> step_table({"do": "wait", "seconds": 1.0}, nested=True).as_string()
    '{do = "wait", seconds = 1.0}'
    """
    table = tomlkit.inline_table() if nested else tomlkit.table()
    for key, value in step.items():
        if key == "steps":
            inner = tomlkit.array()
            for one in value:
                inner.append(step_table(one, nested=True))
            value = inner.multiline(not nested)
        table[key] = value
    return table


def inline(value: Any) -> Any:
    """A value as it stands behind a key: tables on the same line.

    >>> inline({"sigma_s": "1 %"}).as_string()
    '{sigma_s = "1 %"}'
    """
    if not isinstance(value, dict):
        return value
    table = tomlkit.inline_table()
    table.update(value)
    return table


def steps_in(owner: Any, nested: bool) -> Any:
    """The steps of a document or of a step; made where there are none."""
    if "steps" not in owner:
        owner["steps"] = tomlkit.array().multiline(True) if nested else tomlkit.aot()
    return owner["steps"]


def on_one_line(steps: Any) -> bool:
    """Whether each of these steps is to stand on one line: in an array, as `[[steps]]` cannot follow in one.

    >>> on_one_line(tomlkit.parse('steps = [{ do = "wait", seconds = 1.0 }]')["steps"])
    True
    """
    return isinstance(steps, tomlkit.items.Array)


def pattern_table(values: dict[str, Any]) -> Any:
    """A pattern as a table."""
    table = tomlkit.table()
    table.update(values)
    return table


def free_name(name: str, values: dict[str, Any], known: dict[str, Any]) -> str:
    """A name for a pattern: the one it has where that is free or means the same, else the next with a number.

    >>> free_name("sheet", {"kind": "full"}, {"sheet": {"kind": "dark"}, "sheet-2": {"kind": "full"}})
    'sheet-2'
    """
    names = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(one for one in names if one not in known or known[one] == values)


def patterns_in(document: Any) -> Any:
    """The patterns of a document; made where there are none, before the steps."""
    if "patterns" not in document:
        document["patterns"] = tomlkit.table(is_super_table=True)
        if "steps" in document:  # tables come last in the order in which they were added
            document["steps"] = document.pop("steps")
    return document["patterns"]
