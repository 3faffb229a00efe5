"""Rig files: from TOML to three open devices."""

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.registry import open_device
from tankrig.bench import Bench
from tankrig.calibration.file import FOLDER, Calibration, in_force, usable
from tankrig.calibration.geometry_in_force import DEVICES, USED, measured, require_of_one_bench
from tankrig.calibration.radiometry import Radiometry
from tankrig.calibration.tolerances import Tolerances
from tankrig.checked_toml import checked, read_toml
from tankrig.devices import CameraDevice, Projector
from tankrig.dosing import DoseLimits, TankLedger
from tankrig.errors import DeviceError, SceneError, SettingsError
from tankrig.run.rig import Rig, RigLock
from tankrig.scene.description import CLOSED, Medium
from tankrig.scene.loading import unsaid_reflectances
from tankrig.sequence import ExposureRule, Pace
from tankrig.sequence.exposure import LEAST_PERIOD_MS
from tankrig.sequence.steps import MOST_EXPOSURE_MS

if TYPE_CHECKING:
    from drivers.simulated.bench_truth import TrueBench
    from drivers.simulated.settings import SimulatedCameraSettings


@dataclass(frozen=True)
class RigFile:
    """What a rig file says; drivers/simulated/rig.toml is one.

    Parameters
    ----------
    name
        For people.
    projector, camera, doser
        For each the name of its `driver` and that driver's settings. Text that begins with "./" is a path beside the
        rig file.
    bench
        Geometry and radiometry, as calibrated.
    limits
        Budgets for ink.
    pace
        How fast the rig is, for estimates of time.
    folder
        Where the tank's ledger and the rig's lock are kept; relative to the rig file.
    calibration_folder
        Where calibration files are kept; relative to the rig file.
    calibration
        By kind, the beginning of the hash of the calibration file to use; the newest where left out.
    exposure
        The period of the projector's light, where that is not what its `refresh_hz` says, and a person's reason why
        exposures need not be whole numbers of it.
    tolerances
        By how much what no calibration measures may be off; the calibrations' stated uncertainties hold it.
    flash_before_run
        Whether the camera is asked, before a run begins, if it sees what the projector is told to show.
    """

    __pydantic_config__ = CLOSED
    name: str
    projector: dict[str, Any]
    camera: dict[str, Any]
    doser: dict[str, Any]
    bench: Bench
    limits: DoseLimits
    pace: Pace = field(default_factory=Pace)
    folder: str = "."
    calibration_folder: str = FOLDER
    calibration: dict[str, str] = field(default_factory=dict)
    exposure: ExposureRule = field(default_factory=ExposureRule)
    tolerances: Tolerances = field(default_factory=Tolerances)
    flash_before_run: bool = False

    @property
    def exposure_rule(self) -> ExposureRule:
        """What exposures must keep to: by `exposure`, and by the projector's `refresh_hz` where that says no period."""
        refresh_hz = self.projector.get("refresh_hz")
        if self.exposure.period_ms is not None or not isinstance(refresh_hz, int | float):
            return self.exposure
        if not 1000.0 / MOST_EXPOSURE_MS <= refresh_hz <= 1000.0 / LEAST_PERIOD_MS:  # its driver will refuse it
            return self.exposure
        return replace(self.exposure, period_ms=1000.0 / refresh_hz)

    @property
    def latency_ms(self) -> float | None:
        """Within which light follows a swap, as far as the rig file says; the longest where it says several."""
        said = self.projector.get("latency_ms")
        times = said if isinstance(said, list | tuple) else [said]
        return max((float(one) for one in times if isinstance(one, int | float)), default=None)

    @property
    def ledger(self) -> Path:
        """File of the tank's ledger."""
        return Path(self.folder) / "tank.ledger"

    @property
    def lock(self) -> Path:
        """File that keeps a second program off."""
        return Path(self.folder) / "rig.lock"


def load_rig_file(path: str | os.PathLike[str], beside: Path | None = None) -> RigFile:
    """Read a rig file; opens nothing.

    Parameters
    ----------
    path
        Of the file.
    beside
        What its paths are relative to; its own folder where left out.

    Raises
    ------
    SceneError
        In one sentence: the file, the key, its value, and what to do.
    """
    file = Path(path)
    table = read_toml(file, "a rig file", SceneError)
    beside = beside or file.absolute().parent
    for device in ("projector", "camera", "doser"):
        settings = table.get(device)
        if isinstance(settings, dict):
            if not isinstance(settings.get("driver"), str):
                raise SceneError(f'{file}: key "{device}.driver" is missing; name one (tankrig devices lists them)')
            table[device] = {
                key: str(beside / value) if isinstance(value, str) and value.startswith("./") else value
                for key, value in settings.items()
            }
    for name, usual in (("folder", "."), ("calibration_folder", FOLDER)):
        if isinstance(given := table.get(name, usual), str):  # what is none is refused below, like any other key
            table[name] = str(beside / given)
    description = checked(RigFile, table, str(file), SceneError)
    for face in unsaid_reflectances(table["bench"]["tank"]):
        raise SceneError(f'{file}: key "bench.tank.faces.{face}.reflectance" is missing; add it')
    if description.camera["driver"] == "simulated-camera":
        from drivers.simulated.agreement import require_agreement

        require_agreement(str(file), description.projector, description.camera, description.bench)
    return description


SIMULATED = Path(__file__).parent / "simulated" / "rig.toml"
"""The rig file of the simulated rig."""


def simulated_rig(folder: str | os.PathLike[str]) -> RigFile:
    """The simulated rig, with all that it remembers in `folder`: a new folder is a tank of clear water.

    A `rig.toml` in the folder stands in for the one that ships.
    """
    folder = Path(folder)
    own = folder / "rig.toml"
    return load_rig_file(own if own.exists() else SIMULATED, beside=folder.absolute())


def true_liquids(description: RigFile) -> tuple[Medium, Medium] | None:
    """Water, per mm, and ink, per mm and ml, in the tank of a simulated camera; of a real one nobody knows them."""
    settings = _simulated_camera(description)
    return (settings.truth.water, settings.truth.ink) if settings else None


def true_bench(description: RigFile) -> "TrueBench | None":
    """All that is true of a simulated bench, its lenses, places, level and stray light; of a real one nobody knows."""
    settings = _simulated_camera(description)
    if settings is None:
        return None
    from drivers.simulated import bench_tank

    return bench_tank.true_bench(settings)


def is_as_described(description: RigFile) -> bool:
    """Whether a rig is a simulated one without boards, whose bench is as its file says: there is nothing to measure."""
    settings = _simulated_camera(description)
    return settings is not None and settings.boards is None and settings.truth.bench == description.bench


def _simulated_camera(description: RigFile) -> "SimulatedCameraSettings | None":
    settings = dict(description.camera)
    if settings.pop("driver") != "simulated-camera":
        return None
    from drivers.simulated.settings import SimulatedCameraSettings

    return checked(SimulatedCameraSettings, settings, "simulated-camera", SettingsError)


def calibrated_bench(description: RigFile) -> Bench:
    """The bench that the rig file describes, with what was measured of it in place of what was believed.

    Raises
    ------
    StoreError
        When a calibration file that the rig file names cannot be used, or those of the geometry do not belong together.
    DecisionError
        When the newest calibration file of a kind is damaged, and nobody has said that an older one is to be used.
    """
    return _measured(description, in_force(Path(description.calibration_folder), description.calibration))


def require_of_bench(description: RigFile, found: Mapping[str, Calibration]) -> None:
    """Refuse calibrations of another rig than the file describes, and such as do not belong together.

    Raises
    ------
    StoreError
        See `tankrig.calibration.geometry_in_force.require_of_one_bench`.
    """
    bench = description.bench
    shapes = {"camera": bench.camera.shape, "projector": bench.wall.shape}
    require_of_one_bench(found, description.name, shapes)


def _measured(description: RigFile, found: Mapping[str, Calibration]) -> Bench:
    require_of_bench(description, found)
    bench = measured(description.bench, found)
    if "radiometry" not in found:
        return bench
    response = tuple(Radiometry.of(found["radiometry"]).response.curve.tolist())
    return replace(bench, wall=replace(bench.wall, response=response))


@contextmanager
def tank_ledger(description: RigFile) -> Iterator[TankLedger | None]:
    """The ledger of the rig's tank while it is read; None where nothing was ever dosed into it.

    Raises
    ------
    StoreError
        When it is no ledger, or another program doses into the tank.
    """
    if not description.ledger.exists():
        yield None
        return
    ledger = TankLedger(description.ledger)
    try:
        yield ledger
    finally:
        ledger.close()


@contextmanager
def open_light(description: RigFile) -> Iterator[tuple[Projector, CameraDevice]]:
    """Take the rig for this program and open its projector and its camera, to calibrate them; the doser is let be.

    Raises
    ------
    StoreError
        When another program uses the rig.
    DeviceError
        When a device cannot be opened.
    """
    with ExitStack() as last_first:
        last_first.callback(RigLock(description.lock, description.name).close)
        devices = []
        for kind in ("projector", "camera"):
            settings = dict(getattr(description, kind))
            devices.append(open_device(settings.pop("driver"), settings))
            last_first.callback(devices[-1].close)
            _require_kind(kind, devices[-1], getattr(description, kind)["driver"])
        yield devices[0], devices[1]


_DOES = {"projector": "show", "camera": "capture", "doser": "dose_to"}
"""What only a device of that kind can do."""


def _require_kind(kind: str, device: object, driver: str) -> None:
    """Refuse what a driver has opened where it is a device of another kind.

    Raises
    ------
    SettingsError
        Naming the table of the rig file.
    """
    if not callable(getattr(device, _DOES[kind], None)):
        raise SettingsError(
            f'[{kind}] driver = "{driver}" makes no {kind}; name a driver of a {kind} (tankrig devices lists them)'
        )


def open_rig(
    description: RigFile,
    looking: bool = False,
    meanwhile: Callable[[Projector, CameraDevice, Callable[[], bool]], object] | None = None,
) -> Rig:
    """Take the rig for this program and open its devices.

    Parameters
    ----------
    description
        What the rig file says.
    looking
        Only to look and to dose by hand: what a run would have to ask about its calibrations is left open, and the
        newest ones that can be used are.
    meanwhile
        Called with projector and camera once they are open, and with what says whether the doser still boots, which
        takes seconds; comes back when it does no longer.

    Raises
    ------
    StoreError
        When another program uses the rig, or a calibration file that the rig file names cannot be used.
    DecisionError
        When the newest calibration file of a kind is damaged, and nobody has said that an older one is to be used.
    DeviceError
        When a device cannot be opened, or is not what the rig file describes; those that were opened are closed.
    """
    folder, named = Path(description.calibration_folder), description.calibration
    calibrations = usable(folder, named) if looking else in_force(folder, named)
    bench = _measured(description, calibrations)
    with ExitStack() as undo:
        lock = RigLock(description.lock, description.name)
        undo.callback(lock.close)

        def opened(kind: str) -> Any:
            settings = dict(getattr(description, kind))
            device = open_device(settings.pop("driver"), settings)
            undo.callback(device.close)
            _require_kind(kind, device, getattr(description, kind)["driver"])
            return device

        with ThreadPoolExecutor(1, "open-doser") as beside:
            doser = beside.submit(opened, "doser")  # it boots while the others are opened
            devices = {kind: opened(kind) for kind in ("projector", "camera")}
            _require_as_calibrated(description.name, devices, bench, calibrations)
            if meanwhile is not None:
                meanwhile(devices["projector"], devices["camera"], lambda: not doser.done())
            devices["doser"] = doser.result()
        rig = Rig(
            name=description.name,
            bench=bench,
            limits=description.limits,
            ledger=description.ledger,
            pace=description.pace,
            exposure=description.exposure_rule,
            flash_before_run=description.flash_before_run,
            calibrations=calibrations,
            lock=lock,
            **devices,
        )
        undo.pop_all()
        return rig


def _require_as_calibrated(
    rig: str, devices: Mapping[str, Any], bench: Bench, calibrations: Mapping[str, Calibration]
) -> None:
    """Projector and camera are those that were calibrated, with as many pixels."""
    for kind in USED:
        if kind in calibrations:
            device = devices[DEVICES[kind]]
            calibrations[kind].require_for(device.name, device.shape)
    for kind, shape in (("projector", bench.wall.shape), ("camera", bench.camera.shape)):
        if tuple(devices[kind].shape) != tuple(shape):
            raise DeviceError(
                f"{devices[kind].name}: has {list(devices[kind].shape)} pixels (rows, columns) and rig {rig} was "
                f"calibrated with {list(shape)}; calibrate it anew"
            )
