"""Every contestant on every case, and what a prediction's cost depends on."""

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from tankrig.benchmark.contestant import Contestant
from tankrig.benchmark.equal import Equal, at_equal_error
from tankrig.benchmark.result import Result
from tankrig.benchmark.trial import Trial, run_trial
from tankrig.benchmark.truth import Case
from tankrig.errors import TankrigError
from tankrig.scene import Beam, Scene

Told = Callable[[str, bool], object]
"""Told what is measured next (False), and what was found (True)."""

SHORT_S = 5.0
"""Trials that take longer are not repeated."""


@dataclass(frozen=True)
class Cost:
    """Time of the tank model on a changed scene."""

    what: str
    value: str
    seconds: float
    cpu_seconds: float
    peak_mib: float


@dataclass(frozen=True)
class Missing:
    """A trial without a result, and why."""

    case: str
    label: str
    why: str


@dataclass(frozen=True)
class Race:
    """All that was measured."""

    results: tuple[Result, ...]
    equal: tuple[Equal, ...]
    costs: tuple[Cost, ...]
    missing: tuple[Missing, ...]

    def as_json(self) -> dict[str, object]:
        """Plain lists and dictionaries."""
        return {name: [asdict(one) for one in found] for name, found in vars(self).items()}


def race(
    cases: Sequence[Case],
    field: Sequence[Contestant],
    repeat: int = 3,
    costs: bool = True,
    limit_s: float = 60.0,
    tell: Told = lambda _, __: None,
) -> Race:
    """Measure, one process at a time.

    Parameters
    ----------
    cases
        With their references.
    field
        Who takes part.
    repeat
        Trials of each, of whose times the median counts; one is enough where it takes longer than `SHORT_S`.
    costs
        Also time changed versions of the first case's scene.
    limit_s
        A trial that takes longer, its warming up included, is given up and listed as missing.
    tell
        Called twice for everything that is measured.
    """
    results, missing, found = [], [], []

    def trials_of(
        case: str, label: str, contestant: Contestant, scene: Scene, threads: int | None = None
    ) -> list[Trial]:
        tell(f"{case}: {label}", False)
        try:
            return _trials(contestant, scene, repeat, limit_s, threads)
        except TankrigError as error:
            missing.append(Missing(case, label, str(error)))
            tell(f"{case}: {label}: {error}", True)
            return []

    for case in cases:
        for contestant in field:
            if trials := trials_of(case.name, contestant.label, contestant, case.scene):
                results.append(_result(case, contestant, trials))
                error, seconds = results[-1].error, results[-1].seconds
                tell(f"{case.name}: {contestant.label}: {100 * error:.2f} % in {seconds:.3f} s", True)
    for what, value, scene, contestant, threads in variations(cases[0].scene) if costs else ():
        if trials := trials_of("cost", f"{what} {value}", contestant, scene, threads):
            found.append(Cost(what, value, *_figures(trials)))
            tell(f"cost: {what} {value}: {found[-1].seconds:.3f} s", True)
    return Race(tuple(results), at_equal_error(results), tuple(found), tuple(missing))


def _trials(contestant: Contestant, scene: Scene, repeat: int, limit_s: float, threads: int | None) -> list[Trial]:
    trials = [run_trial(contestant, scene, threads, limit_s)]
    while len(trials) < repeat and trials[0].seconds < SHORT_S:
        trials.append(run_trial(contestant, scene, threads, limit_s))
    return trials


def _figures(trials: list[Trial]) -> tuple[float, float, float]:
    """Median seconds and CPU seconds, and most MiB."""
    seconds = statistics.median(one.seconds for one in trials)
    cpu_seconds = statistics.median(one.cpu_seconds for one in trials)
    return seconds, cpu_seconds, max(one.peak_bytes for one in trials) / 2**20


def _result(case: Case, contestant: Contestant, trials: list[Trial]) -> Result:
    image, setting = trials[0].image, (contestant.tolerance, contestant.samples)
    light = float(image.sum() / case.image.sum())
    errors = case.excess(image), case.noise, light
    return Result(case.name, contestant.label, contestant.model, *setting, *errors, *_figures(trials))


def variations(scene: Scene) -> Iterator[tuple[str, str, Scene, Contestant, int | None]]:
    """What a prediction's cost may depend on, one thing changed at a time."""
    tank = Contestant("tank", 0.01)
    rows, columns = scene.camera.shape
    for factor in (0.5, 1.0, 4.0):
        shape = (max(1, round(rows * factor)), max(1, round(columns * factor)))
        camera = replace(scene.camera, shape=shape, pixel_mm=scene.camera.pixel_mm / factor)
        yield "pixels", f"{shape[1]}×{shape[0]}", replace(scene, camera=camera), tank, None
    length, width, _ = scene.tank.size_mm
    fine = replace(scene.camera, shape=(1024, 1280), pixel_mm=max(length / 1280, width / 1024))
    yield "pixels", "1280×1024", replace(scene, camera=fine), tank, None
    for order in (1, 2, 3, 20):
        yield "orders", f"1–{order}", scene, replace(tank, max_order=order), None
    for count in (1, 3, 7):
        pitch = width / (count + 1)
        middles = [(index + 1) * pitch - width / 2 for index in range(count)]
        height = scene.projector.beams[0].z_mm
        beams = tuple(Beam((middle - pitch / 8, middle + pitch / 8), height) for middle in middles)
        yield "beams", str(count), replace(scene, projector=replace(scene.projector, beams=beams)), tank, None
    for factor in (0.5, 2.0):
        yield "tank size", f"×{factor:g}", _stretched(scene, factor), tank, None
    for threads in (1, 2):
        yield "processors", str(threads), scene, tank, threads


def _stretched(scene: Scene, k: float) -> Scene:
    """Every length times k, in the same medium."""

    def scaled(place: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return None if place is None else (k * place[0], k * place[1], k * place[2])

    light, camera = scene.projector, scene.camera
    beams = tuple(
        Beam((k * beam.y_mm[0], k * beam.y_mm[1]), (k * beam.z_mm[0], k * beam.z_mm[1]), beam.irradiance)
        for beam in light.beams
    )
    return Scene(
        replace(scene.tank, size_mm=scaled(scene.tank.size_mm) or scene.tank.size_mm),
        scene.medium,
        replace(light, beams=beams, position_mm=scaled(light.position_mm)),
        replace(camera, pixel_mm=k * camera.pixel_mm, position_mm=scaled(camera.position_mm)),
    )
