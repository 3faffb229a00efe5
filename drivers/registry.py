"""Drivers by name: entry points of the group `tankrig.drivers`, each a `callable(settings) -> device`.

A lab adds its own by installing a package with such an entry point; nothing in this tree has to change
(docs/write_a_driver.md). Whatever is wrong with somebody's package becomes a `DeviceError` that names it, so that it
never takes the other drivers with it.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, TypeVar

from tankrig.errors import DeviceError, SettingsError, TankrigError
from tankrig.extras import missing

if TYPE_CHECKING:
    from pydantic import BaseModel

GROUP = "tankrig.drivers"


def driver_names() -> tuple[str, ...]:
    """Names of all installed drivers.

    >>> "rig-doser" in driver_names()
    True
    """
    return tuple(sorted(entry_points(group=GROUP).names))


def unusable_drivers() -> Iterator[DeviceError]:
    """Those installed drivers that cannot be used, each with the reason."""
    for name in driver_names():
        try:
            _driver(name)
        except DeviceError as error:
            yield error


def open_device(name: str, settings: Mapping[str, Any]) -> Any:
    """Open the device that the driver `name` makes of `settings` (a table of a rig file).

    Raises
    ------
    DeviceError
        If there is no such driver, its settings are wrong, or the device cannot be opened.
    """
    driver = _driver(name)
    with blamed(f'driver "{name}"', "could not open its device", "ask who wrote it"):
        return driver(settings)


def checked(model: "type[_Settings]", driver: str, settings: Mapping[str, Any]) -> "_Settings":
    """The settings of `driver` as its `model` (pydantic) has them; a SettingsError names the first that is wrong."""
    from pydantic import ValidationError

    try:
        return model.model_validate(dict(settings))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        known = ", ".join(model.model_fields)
        raise SettingsError(f"{driver}: setting {place}: {first['msg']}; it takes {known}") from error


def loaded(entry: EntryPoint) -> Any:
    """What an entry point stands for.

    Raises
    ------
    DeviceError
        If it cannot be imported, whatever its package raises meanwhile; the message names entry point and package.
    """
    package = entry.dist.name if entry.dist else "an unknown package"
    whose = f'{entry.group.removeprefix("tankrig.")} entry point "{entry.name}" of {package}'
    with blamed(whose, f"cannot be loaded from {entry.value}", f"mend or uninstall {package}"):
        return entry.load()


@contextmanager
def blamed(whose: str, what: str, remedy: str) -> Iterator[None]:
    """Turn everything that other people's code raises here, `SystemExit` too, into a DeviceError that says whose it is.

    tankrig's own errors, a person's Ctrl-C and the end of a generator pass through.
    """
    try:
        yield
    except (TankrigError, KeyboardInterrupt, GeneratorExit):
        raise
    except ModuleNotFoundError as error:
        if said := missing(error, whose):
            raise DeviceError(said) from error
        raise DeviceError(f"{whose}: {what} (ModuleNotFoundError: {error}); {remedy}") from error
    except BaseException as error:
        said = " ".join(str(error).split())
        raise DeviceError(f"{whose}: {what} ({type(error).__name__}{': ' if said else ''}{said}); {remedy}") from error


def _driver(name: str) -> Any:
    found = {(entry.value, entry.dist and entry.dist.name): entry for entry in entry_points(group=GROUP, name=name)}
    if not found:
        raise SettingsError(f"there is no driver {name!r}; installed are {', '.join(driver_names()) or 'none'}")
    if len({value for value, _ in found}) > 1:
        packages = " and ".join(sorted(package or "?" for _, package in found))
        raise DeviceError(f'driver "{name}": is installed by {packages}; uninstall all but one of them')
    driver = loaded(next(iter(found.values())))
    if not callable(driver):
        raise DeviceError(f'driver "{name}": its entry point is no function of the settings; ask who wrote it')
    return driver


_Settings = TypeVar("_Settings", bound="BaseModel")
