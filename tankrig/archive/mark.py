"""The mark of the code that decides what a refit finds: what is written in it, not how it is explained."""

import ast
import hashlib
from functools import lru_cache
from pathlib import Path

MATTERS = (
    "archive/models.py",
    "bench.py", "calibration", "estimation", "geometry", "image", "light", "live", "pattern", "run/conditions.py",
    "run/reading.py", "scene", "sequence",
)  # fmt: skip
"""Modules and packages of `tankrig` that a fit goes through. Prepared models have a mark of their own, of the code that
computes light (`tankrig.light.prepared.cache.code_mark`); this one goes on to what is estimated from it."""


@lru_cache(maxsize=1)
def refit_mark() -> str:
    """Of the code that a refit goes through: another mark, and every run of an archive is fitted anew.

    Comments and docstrings do not count, so that a release that explains more refits nothing. Another version of Python
    may write the same code down differently, and then counts as other code.

    Examples
    --------
    >>> len(refit_mark())
    64
    """
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for name in MATTERS:
        place = package / name
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(str(file.relative_to(package)).encode())
            digest.update(meaning(file.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()


def meaning(source: str) -> str:
    """What a program says, without its comments and docstrings.

    Examples
    --------
    >>> meaning('def f():\\n    "One."\\n    return 1') == meaning("def f():\\n    return 1  # one")
    True
    """
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return ast.dump(tree)
