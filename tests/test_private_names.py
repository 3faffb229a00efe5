"""Tests judge what a user of a class, a command or the window meets; ruff's SLF001 sees the rest of the ways around."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PRODUCT = ("tankrig", "drivers", "ui")
PRIVATE = re.compile(r"(.*\.)?_[a-zA-Z]\w*(?<!_)")
"""A name that ends in an underscore too is somebody else's convention, as `_repr_html_` is the notebooks'."""


def reached_into(tree: ast.AST) -> Iterator[str]:
    """Private names of the product that a file imports, or puts something in the place of."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in PRODUCT:
            yield from (f"line {node.lineno}: {one.name}" for one in node.names if PRIVATE.fullmatch(one.name))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
            words = [one.value for one in node.args[:2] if isinstance(one, ast.Constant) and isinstance(one.value, str)]
            if name in ("setattr", "delattr", "getattr", "hasattr", "patch", "object"):
                yield from (f"line {node.lineno}: {one}" for one in words if PRIVATE.fullmatch(one))


def test_no_test_knows_a_private_name_of_the_product() -> None:
    """A test of how something is done fails when it is done better, and passes when nobody can use it any more."""
    files = sorted(Path(__file__).parent.rglob("*.py"))
    found = {path.name: list(reached_into(ast.parse(path.read_text(encoding="utf-8")))) for path in files}
    assert {name: here for name, here in found.items() if here} == {}


def test_a_private_name_is_found_however_it_is_reached() -> None:
    for line in (
        "from tankrig.live.fits import _rough", "monkeypatch.setattr(writer, '_QUEUE_BYTES', 0)",
        "monkeypatch.setattr('tankrig.run.writer._QUEUE_BYTES', 0)", "patch.object(kind, '_take')",
        "getattr(pump, '_line')", "setattr(core, '_left', None)",
    ):  # fmt: skip
        assert list(reached_into(ast.parse(line))), line
    for line in (
        "from tests.x import _own",
        "from numpy import __version__",
        "words.index('_ul')",
        "hasattr(x, '_repr_html_')",
        "f(x, '_after')",
    ):
        assert not list(reached_into(ast.parse(line))), line
