"""What is connected, and whether a rig is fit to be used: asked of the drivers, each of which knows its own devices.

A driver takes part with an entry point of the group `tankrig.health` under its own name: a module with
`find() -> Iterator[Found]` and `checks(settings, device) -> Iterator[Check]`. A driver whose module is broken is named
with the reason, and the others are asked all the same.
"""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from statistics import median
from typing import Any, Protocol

from drivers.calibration_health import calibration_checks, level_check
from drivers.check import Check, failed
from drivers.registry import blamed, loaded, open_device, unusable_drivers
from drivers.rig import RigFile, calibrated_bench
from tankrig.bench import Bench
from tankrig.devices import CameraDevice, CameraSettings, Doser, Projector
from tankrig.errors import DeviceError, TankrigError
from tankrig.sequence import ExposureRule

GROUP = "tankrig.health"


@dataclass(frozen=True)
class Found:
    """A device that is connected.

    Parameters
    ----------
    what
        For people.
    lines
        For the rig file; empty where the device is none of a rig's.
    """

    what: str
    lines: str = ""


class Health(Protocol):
    """What a driver's module of the group `tankrig.health` has."""

    def find(self) -> Iterator[Found]:
        """The driver's devices that are connected."""

    def checks(self, settings: Mapping[str, Any], device: Any) -> Iterator[Check]:
        """What to look at beside that it opens; `device` is None when it did not."""


def find_devices() -> Iterator[Found | DeviceError]:
    """All that is connected: serial ports, and what each driver finds."""
    yield from _serial_ports()
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            with blamed(f'health of driver "{entry.name}"', "could not look for devices", "ask who wrote it"):
                yield from loaded(entry).find()
        except DeviceError as error:
            yield error
    yield from unusable_drivers()


def examine(rig: RigFile, with_light: bool = True) -> Iterator[Check]:
    """Check the devices of a rig file one after the other, then together; moves no ink.

    Parameters
    ----------
    rig
        What the file says.
    with_light
        Whether to flash the projector to measure its latency.
    """
    with ExitStack() as opened:
        devices: dict[str, Any] = {}
        yield from _part("devices", _devices(rig, opened, devices))
        yield from _part("exposure", exposure_checks(rig.exposure_rule, devices))
        yield from calibration_checks(rig, devices)
        if with_light and {"projector", "camera"} <= devices.keys():
            yield from _part("light", _light(rig, devices))


def _part(part: str, checks: Iterator[Check]) -> Iterator[Check]:
    for check in checks:
        yield replace(check, part=part)


def _devices(rig: RigFile, opened: ExitStack, devices: dict[str, Any]) -> Iterator[Check]:
    """Open them, into `devices`, and ask each by itself."""
    for kind in ("doser", "projector", "camera"):
        settings = dict(getattr(rig, kind))
        driver = settings.pop("driver")
        device = None
        try:
            device = devices[kind] = open_device(driver, settings)
            opened.callback(device.close)
            yield Check(f"{kind} opens", True, f"{device.name} ({driver})")
        except DeviceError as error:
            yield failed(f"{kind} opens", error)
        yield from _own_checks(driver, settings, device)
    if "doser" in devices:
        yield from _doser(devices["doser"], rig)
    for kind, shape in (("projector", rig.bench.wall.shape), ("camera", rig.bench.camera.shape)):
        if kind in devices:
            yield _shape(kind, devices[kind].shape, shape)
    if "camera" in devices:
        yield _camera(devices["camera"])


def _light(rig: RigFile, devices: Mapping[str, Any]) -> Iterator[Check]:
    projector, camera = devices["projector"], devices["camera"]
    yield _latency(projector, camera, rig.latency_ms)
    yield _seen(projector, camera, rig.exposure_rule)
    yield level_check(projector, camera, _believed(rig).wall, rig.exposure_rule)


def _own_checks(driver: str, settings: Mapping[str, Any], device: Any) -> Iterator[Check]:
    """What the driver's own module looks at."""
    for entry in entry_points(group=GROUP, name=driver):
        try:
            with blamed(f'health of driver "{driver}"', "could not check its device", "ask who wrote it"):
                yield from loaded(entry).checks(settings, device)
        except DeviceError as error:
            yield failed(f"{driver} checks its own device", error)


def _believed(rig: RigFile) -> Bench:
    try:
        return calibrated_bench(rig)
    except TankrigError:  # told by the checks of the calibration
        return rig.bench


def _shape(kind: str, has: tuple[int, int], calibrated: tuple[int, int]) -> Check:
    same = tuple(has) == tuple(calibrated)
    return Check(
        f"{kind} has the calibrated pixels", same, f"{list(has)} (rows, columns), calibrated {list(calibrated)}",
        f"correct bench in the rig file, or {kind}.shape, and calibrate anew",
    )  # fmt: skip


def _doser(doser: Doser, rig: RigFile) -> Iterator[Check]:
    try:
        volume_ul, low_ul, high_ul = doser.delivered()
    except DeviceError as error:
        yield failed("doser tells what it delivered", error)
        return
    known = not doser.unknown
    yield Check(
        "doser tells what it delivered", known, f"{doser.identity}: {volume_ul:g} µl ({low_ul:g} to {high_ul:g})",
        "find out what is in the tank and resolve it (tankrig run --resume RUN --delivered-ul X)",
    )  # fmt: skip
    fine = rig.limits.dose_ul >= doser.increment_ul
    yield Check(
        "doses can be as small as the limits", fine,
        f"increment {doser.increment_ul:g} µl, limit of a dose {rig.limits.dose_ul:g} µl", "raise limits.dose_ul",
    )  # fmt: skip


def _camera(camera: CameraDevice) -> Check:
    from time import monotonic_ns

    what = "camera gives frames that began when asked"
    try:
        actual = camera.configure(CameraSettings(exposure_ms=20.0))
        starts = [camera.capture(monotonic_ns(), 5.0).exposure_start_ns for _ in range(3)]
    except TankrigError as error:
        return failed(what, error)
    return Check(what, True, f"{len(starts)} of them, exposure {actual.exposure_ms:g} ms, gain {actual.gain:g}")


def exposure_checks(rule: ExposureRule, devices: Mapping[str, Any]) -> Iterator[Check]:
    """Whether the period of the light is known and true, and the camera can expose whole numbers of it."""
    what = "exposures are whole numbers of the projector's periods"
    if rule.accept.strip():
        yield Check(what, True, f"the rig file accepts any: {rule.accept}")
        return
    if rule.period_ms is None:
        yield Check(
            what, None, "nobody has said what the period of its light is",
            "set period_ms in the rig file's [exposure], or 0 where the light is steady",
        )  # fmt: skip
        return
    swaps_ms = getattr(devices.get("projector"), "swap_ms", ())
    if rule.period_ms and swaps_ms:
        measured_ms = float(median(swaps_ms))
        yield Check(
            "the projector's period is what the rig file says", rule.allows(measured_ms),
            f"{measured_ms:.3f} ms measured, {rule.period_ms:.3f} ms in the rig file",
            f"set refresh_hz = {1000.0 / measured_ms:.2f} in [projector]",
        )  # fmt: skip
    if "camera" in devices:
        yield _camera_keeps(what, rule, devices["camera"])


def _camera_keeps(what: str, rule: ExposureRule, camera: CameraDevice) -> Check:
    if not rule.period_ms:
        return Check(what, True, "the rig file says that its light is steady, so any will do")
    try:
        asked = [number * rule.period_ms for number in (1, 2, 3, 4)]
        made = [camera.configure(CameraSettings(exposure_ms)).exposure_ms for exposure_ms in asked]
    except TankrigError as error:
        return failed(what, error)
    whole = [f"{exposure_ms:.3f}" for exposure_ms in made if rule.allows(exposure_ms)]
    told = ", ".join(f"{exposure_ms:.3f}" for exposure_ms in made)
    return Check(
        what, bool(whole), f"of {rule.period_ms:.3f} ms: the camera makes {told} ms of one to four of them",
        "set the camera's frame rate or the projector's refresh rate so that they fit, or say in the rig file's "
        "[exposure] why it does not matter: accept = …",
    )  # fmt: skip


def _seen(projector: Projector, camera: CameraDevice, rule: ExposureRule) -> Check:
    from tankrig.calibration.witness import witness

    what = "the camera sees what the projector is told to show"
    try:
        testimony = witness(projector, camera, rule)
    except TankrigError as error:
        return replace(failed(what, error), passed=None)  # a dark tank is no fault of the devices
    return Check(
        what, testimony.follows, testimony.finding,
        "look at the projector's picture, with ink in the tank or a sheet of paper where its light falls",
    )  # fmt: skip


def _latency(projector: Projector, camera: CameraDevice, assumed_ms: float | None) -> Check:
    from tankrig.calibration.latency import measure_latency

    what = "light follows a swap within the latency of the rig file"
    try:
        measured = measure_latency(projector, camera)
    except TankrigError as error:
        return replace(failed(what, error), passed=None)  # a dark tank is no fault of the devices
    finding = (
        f"median {measured.median_ms:.1f} ms, 99 % within {measured.p99_ms:.1f} ms of {len(measured.samples_ms)} flips"
    )
    if assumed_ms is None:
        return Check(what, True, finding)
    return Check(
        what, measured.p99_ms <= assumed_ms, f"{finding}, assumed {assumed_ms:g} ms",
        f"set latency_ms = {measured.p99_ms:.1f} in [projector]",
    )  # fmt: skip


def _serial_ports() -> Iterator[Found]:
    from pathlib import Path

    from serial.tools.list_ports import comports

    named = {link.resolve(): link for link in sorted(Path("/dev/serial/by-id").glob("*"))}
    for port in comports():
        if port.hwid == "n/a":
            continue  # of the mainboard, with nothing to tell whether anything is connected
        path = named.get(Path(port.device).resolve(), Path(port.device))
        yield Found(f"serial port {port.device}: {port.description}", f'[doser]\nport = "{path}"')
