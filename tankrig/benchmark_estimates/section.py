"""One part of the report: what was measured, against which bound."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Cell:
    """One figure of a table; `met` is None where it has no bound."""

    text: str
    met: bool | None = None


@dataclass(frozen=True)
class Section:
    """A table with what it says.

    Parameters
    ----------
    title, about
        What was measured and how.
    headings
        Of the columns; the first names a row.
    rows
        Of the table.
    result
        A sentence that sums it up.
    numbers
        What the table was made of, for `--json`.
    """

    title: str
    about: str
    headings: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    result: str
    numbers: Any = field(repr=False, default=None)

    @property
    def missed(self) -> int:
        """Figures outside their bounds."""
        return sum(cell.met is False for row in self.rows for cell in row)
