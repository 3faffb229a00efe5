"""Tables on a terminal of any width: no number is cut, and none is torn apart over two lines."""

from collections.abc import Collection, Sequence
from typing import Literal

GAPS = (2, 1)
"""Spaces between two columns, and where the terminal is too narrow for these."""


def tell_table(
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    left: Collection[int] = (0,),
    styles: Sequence[str | None] = (),
    sentences: bool = False,
) -> None:
    """Print a table; where the terminal is too narrow, as several beneath each other, each with the first column.

    Parameters
    ----------
    headings
        Of the columns; a line break in one is kept.
    rows
        As many cells as there are headings; an empty row is an empty line.
    left
        Numbers of the columns that begin on the left; the others end on the right.
    styles
        Of the rows, in rich's words; none where left out.
    sentences
        Whether the last column holds words, which may go on in the next line.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    gap = next((one for one in GAPS if len(parts_of(headings, rows, console.width, sentences, one)) == 1), GAPS[-1])
    parts = parts_of(headings, rows, console.width, sentences, gap)
    for part in parts:
        table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, gap, 0, 0))
        for column in part:
            wraps = sentences and column == len(headings) - 1
            justify: Literal["left", "right"] = "left" if column in left or wraps else "right"
            table.add_column(Text(headings[column]), justify=justify, no_wrap=not wraps, overflow="fold")
        for number, row in enumerate(rows):
            cells = [row[column] for column in part] if row else [""]
            if len(parts) == 1 or any(cells[1:]):
                table.add_row(*map(Text, cells), style=styles[number] if styles else None)
        # Where two columns alone are wider than the terminal, it breaks their lines, and in a file they are whole.
        needed = sum(_needed(headings, rows, column, sentences) + gap for column in part) - gap
        Console(width=max(console.width, needed)).print(table, highlight=False)


def parts_of(
    headings: Sequence[str], rows: Sequence[Sequence[str]], width: int, sentences: bool = False, gap: int = GAPS[0]
) -> list[list[int]]:
    """Numbers of the columns that stand beside each other, so that none is cut.

    Examples
    --------
    >>> parts_of(("model", "RMSE", "sigma"), [("all orders", "0.012", "19.80±0.02")], 30)
    [[0, 1, 2]]
    >>> parts_of(("model", "RMSE", "sigma"), [("all orders", "0.012", "19.80±0.02")], 24)
    [[0, 1], [0, 2]]
    """
    first = used = _needed(headings, rows, 0, sentences)
    parts: list[list[int]] = [[0]]
    for column in range(1, len(headings)):
        needs = gap + _needed(headings, rows, column, sentences)
        if used + needs > width and len(parts[-1]) > 1:
            parts.append([0])
            used = first
        parts[-1].append(column)
        used += needs
    return parts


def _needed(headings: Sequence[str], rows: Sequence[Sequence[str]], column: int, sentences: bool) -> int:
    """Letters that a column is wide at least: its longest cell, or its longest word where words may be wrapped."""
    from rich.cells import cell_len

    texts = [*headings[column].split("\n"), *(row[column] for row in rows if row)]
    if sentences and column == len(headings) - 1:
        texts = [word for text in texts for word in text.split()]
    return max(map(cell_len, texts), default=0)
