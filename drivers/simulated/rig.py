"""The simulated rig's own rig file, which ships with the package."""

from importlib.resources import files
from pathlib import Path

from tankrig.files import whole_file

NAME = "rig.toml"


def simulated_rig_file(folder: Path) -> Path:
    """The rig file of a simulated rig that lives in `folder`; put there if there is none yet.

    A new folder is a new tank of clear water; the same folder again is the same tank with the ink that it holds.

    Raises
    ------
    StoreError
        When it cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from drivers.rig import load_rig_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     load_rig_file(simulated_rig_file(Path(folder, "rig"))).name
    'simulated rig'
    """
    file = folder / NAME
    if not file.exists():
        with whole_file(file) as unfinished:
            unfinished.write_bytes((files("drivers.simulated") / NAME).read_bytes())
    return file
