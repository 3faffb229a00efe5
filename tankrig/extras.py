"""What is installed besides the core, by the names of `pip install "tankrig[…]"`."""

from collections.abc import Iterator
from contextlib import contextmanager

from tankrig.errors import MissingExtraError

EXTRAS = {
    "serial": "rig",
    "usb": "rig",
    "tomlkit": "rig",
    "PySide6": "gui",
    "pyqtgraph": "gui",
    "jinja2": "report",
    "dask": "export",
    "h5netcdf": "export",
    "h5py": "export",
}
"""By the name of a package as it is imported, the extra that brings it."""
SOURCE_ONLY = ("tankrig.benchmark", "tankrig.benchmark_estimates", "drivers.new_era.emulator", "drivers.cavro.emulator")
"""Packages that stand in the source tree and are not in the wheel."""


@contextmanager
def needing_extra(what: str) -> Iterator[None]:
    """Say which extra is missing where a block cannot import what it needs.

    Parameters
    ----------
    what
        Needs it, for the message: "a report".

    Raises
    ------
    MissingExtraError
        Naming the extra and how to install it. Any other import that fails is raised as it is.

    Examples
    --------
    >>> with needing_extra("a report"):
    ...     raise ModuleNotFoundError("No module named 'jinja2'", name="jinja2")
    Traceback (most recent call last):
    tankrig.errors.MissingExtraError: a report needs jinja2, which is not installed; run: pip install "tankrig[report]"
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if said := missing(error, what):
            raise MissingExtraError(said) from error
        raise


def missing(error: ModuleNotFoundError, what: str) -> str:
    """One sentence about a module that is not there because an extra is not; empty where it is something else."""
    name = error.name or ""
    if name.startswith(SOURCE_ONLY):
        return (
            f"{what} needs {name}, which is not in the installed package; run it from the source tree "
            f"(./start there sets it up)"
        )
    package = name.partition(".")[0]
    if package not in EXTRAS:
        return ""
    return f'{what} needs {package}, which is not installed; run: pip install "tankrig[{EXTRAS[package]}]"'
