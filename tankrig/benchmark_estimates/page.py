"""The report: every part as a table, on one page that needs nothing but itself."""

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from tankrig.benchmark_estimates.section import Section
from tankrig.files import whole_file
from tankrig.report.inlined import rendered


def write_page(sections: Sequence[Section], path: Path) -> None:
    """Write the page; it is there whole or not at all.

    Raises
    ------
    StoreError
        When the file cannot be written.
    MissingExtraError
        Where the extra `report` is not installed.
    """
    page = rendered(
        "page.html", "tankrig.benchmark_estimates",
        sections=sections, version=version("tankrig"), machine=platform.machine(),
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )  # fmt: skip
    with whole_file(path) as unfinished:
        unfinished.write_text(page, encoding="utf-8")
