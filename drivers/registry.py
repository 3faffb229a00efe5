"""Drivers by name: entry points of the group `tankrig.drivers`, each a `callable(settings) -> device`.

A lab adds its own by installing a package with such an entry point; nothing in this tree has to change.
"""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, TypeVar

from tankrig.errors import DeviceError

if TYPE_CHECKING:
    from pydantic import BaseModel

GROUP = "tankrig.drivers"


def driver_names() -> tuple[str, ...]:
    """Names of all installed drivers.

    >>> "rig-doser" in driver_names()
    True
    """
    return tuple(sorted(entry_points(group=GROUP).names))


def open_device(name: str, settings: Mapping[str, Any]) -> Any:
    """Open the device that the driver `name` makes of `settings` (a table of a rig file).

    Raises
    ------
    DeviceError
        If there is no such driver, its settings are wrong, or the device cannot be opened.
    """
    return _driver(name).load()(settings)


def checked(model: "type[_Settings]", driver: str, settings: Mapping[str, Any]) -> "_Settings":
    """The settings of `driver` as its `model` (pydantic) has them; a DeviceError names the first that is wrong."""
    from pydantic import ValidationError

    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        known = ", ".join(model.model_fields)
        raise DeviceError(f"{driver}: setting {place}: {first['msg']}; it takes {known}") from error


def _driver(name: str) -> EntryPoint:
    found = entry_points(group=GROUP, name=name)
    if not found:
        raise DeviceError(f"there is no driver {name!r}; installed are {', '.join(driver_names()) or 'none'}")
    return next(iter(found))


_Settings = TypeVar("_Settings", bound="BaseModel")
