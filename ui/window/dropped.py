"""What a file or folder is that a person drops on the window."""

import tomllib
from enum import Enum
from pathlib import Path


class Dropped(Enum):
    """What to do with it."""

    RUN = "run"
    SEQUENCE = "sequence"
    RIG = "rig file"
    SCENE = "scene"
    OTHER = "nothing that the window opens"


def kind_of(path: Path) -> Dropped:
    """A run's folder, a sequence, a rig file, a scene, or something else; torn TOML counts as a sequence.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "x.toml")
    ...     _ = file.write_text('[doser]\\ndriver = "rig-doser"')
    ...     kind_of(file), kind_of(Path(folder))
    (<Dropped.RIG: 'rig file'>, <Dropped.OTHER: 'nothing that the window opens'>)
    """
    if path.is_dir():
        return Dropped.RUN if (path / "journal.jsonl").is_file() else Dropped.OTHER
    if path.suffix.lower() != ".toml":
        return Dropped.OTHER
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return Dropped.SEQUENCE
    if "doser" in table:
        return Dropped.RIG
    return Dropped.SCENE if "steps" not in table and {"medium", "camera"} & table.keys() else Dropped.SEQUENCE
