"""How the pages become a site: `./start docs` (Sphinx, MyST for the Markdown, numpydoc for the docstrings).

The source is the whole tree, so that pages may link to files that are no pages; which files are pages is said here.
"""

import re
from importlib.metadata import version as installed
from typing import Any

from sphinx.application import Sphinx

project = "tankrig"
author = copyright = "the tankrig developers"
release = version = installed("tankrig")

extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinx_click"]
root_doc = "docs/index"
include_patterns = [
    "CHANGELOG.md", "CONTRIBUTING.md", "docs/**.md", "firmware_notes/*.md"
]  # fmt: skip
exclude_patterns = [".*", "out", "runs", "build", "dist", "docs/README.md"]

myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]  # a step of a sequence is a part of a TOML file

default_role = "code"  # docstrings put names between single backquotes
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
numpydoc_show_class_members = False

html_theme = "furo"
html_title = "tankrig"
html_copy_source = False
html_show_sphinx = False


_ARRAY_LIKE = re.compile(r"_Buffer \| .*?_NestedSequence\[complex \| bytes \| str\]")


def _short(*about: Any) -> tuple[str, str] | None:
    """Say ArrayLike as the code does, and not what it stands for; a module has no signature."""
    said, gives = about[-2:]
    return (_ARRAY_LIKE.sub("ArrayLike", said), gives) if said else None


def _stands_elsewhere(app: Sphinx, what: str, name: str, thing: object, _: bool, options: Any) -> bool | None:
    """Leave out of a package's page what tankrig itself exports."""
    import tankrig

    of_a_package = what == "module" and getattr(options, "imported_members", False)
    if of_a_package and app.env.current_document.docname != "docs/api" and getattr(tankrig, name, None) is thing:
        return True
    return None


def _with_pages_of_its_folder(_: Sphinx, page: str, source: list[str]) -> None:
    """Give the pages of decisions and protocols their place in the site below the one that lists them."""
    below = {"docs/decisions/README": "0*", "firmware_notes/README": "[a-z]*"}
    if page in below:
        source[0] += f"\n```{{toctree}}\n:hidden:\n:glob:\n\n{below[page]}\n```\n"


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _with_pages_of_its_folder)
    app.connect("autodoc-process-signature", _short)
    app.connect("autodoc-skip-member", _stands_elsewhere)
