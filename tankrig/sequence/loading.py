"""Sequences from files, and back into plain data for a run's settings."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from tankrig.checked_toml import adapter_of, checked, read_toml
from tankrig.errors import SequenceError
from tankrig.pattern.kinds import ImageFile
from tankrig.sequence.sequence import Sequence


def load_sequence(path: str | os.PathLike[str]) -> Sequence:
    """Read a sequence file.

    Parameters
    ----------
    path
        A TOML file; docs/examples/dilution.toml shows all that it may hold.

    Raises
    ------
    SequenceError
        In one sentence: the file, the key, its value, and what to do.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> text = '''
    ... name = "one picture"
    ... [[steps]]
    ... do = "capture"
    ... pattern = "full"
    ... '''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = pathlib.Path(folder, "sequence.toml")
    ...     _ = file.write_text(text)
    ...     load_sequence(file).tasks[0].label
    'capture full'
    """
    file = Path(path)
    sequence = sequence_beside(file.parent, read_toml(file, "a sequence file", SequenceError), str(file))
    return replace(sequence, source=str(file))


def sequence_beside(folder: Path, table: dict[str, Any], name: str) -> Sequence:
    """The sequence of a parsed file in `folder`, which its pictures' paths are relative to; see `sequence_from_table`.

    Raises
    ------
    SequenceError
        About the first thing that is wrong.
    """
    sequence = sequence_from_table(table, name)
    patterns = {
        key: replace(kind, path=str((folder / kind.path).absolute())) if isinstance(kind, ImageFile) else kind
        for key, kind in sequence.patterns.items()
    }
    return replace(sequence, patterns=patterns)


def sequence_from_table(table: dict[str, Any], name: str) -> Sequence:
    """Check what a sequence file, or a run's settings, hold; `name` stands first in every message.

    Raises
    ------
    SequenceError
        About the first thing that is wrong.
    """
    if "source" in table:  # a field of Sequence that no file may set
        raise SequenceError(f'{name}: key "source" is unknown; remove it')
    return checked(Sequence, table, name, SequenceError)


def sequence_table(sequence: Sequence) -> dict[str, Any]:
    """The sequence as plain data, of which `sequence_from_table` makes it again."""
    table: dict[str, Any] = adapter_of(Sequence).dump_python(sequence, mode="json", exclude={"source"})
    return table
