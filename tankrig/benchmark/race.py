"""Every contestant on every case, and what a prediction's cost depends on."""

import statistics
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace

from tankrig.benchmark.contestant import Contestant
from tankrig.benchmark.trial import run_trial
from tankrig.benchmark.truth import Case
from tankrig.errors import SceneError
from tankrig.scene import Beam, Scene

Told = Callable[[str], None]


@dataclass(frozen=True)
class Result:
    """One contestant on one case.

    Parameters
    ----------
    case, label
        Names of the case and of the contestant.
    error
        Relative L2 error net of the reference's noise.
    noise
        Relative L2 of that noise; errors well below it cannot be told from 0.
    seconds, cpu_seconds
        Median over the repeated trials.
    peak_mib
        Largest resident memory of any trial.
    """

    case: str
    label: str
    error: float
    noise: float
    seconds: float
    cpu_seconds: float
    peak_mib: float


@dataclass(frozen=True)
class Cost:
    """Time of the tank model on a changed scene."""

    what: str
    value: str
    seconds: float
    cpu_seconds: float
    peak_mib: float


@dataclass(frozen=True)
class Race:
    """All that was measured."""

    results: tuple[Result, ...]
    costs: tuple[Cost, ...]
    refused: tuple[tuple[str, str, str], ...]

    def as_json(self) -> dict[str, object]:
        """Plain lists and dictionaries."""
        return {
            "results": [asdict(result) for result in self.results],
            "costs": [asdict(cost) for cost in self.costs],
            "refused": [dict(zip(("case", "label", "why"), item, strict=True)) for item in self.refused],
        }


def race(
    cases: Sequence[Case], field: Sequence[Contestant], repeat: int = 3, costs: bool = True, tell: Told = lambda _: None
) -> Race:
    """Measure, one process at a time.

    Parameters
    ----------
    cases
        With their references.
    field
        Who takes part.
    repeat
        Trials of each, of whose times the median counts.
    costs
        Also time changed versions of the first case's scene.
    tell
        Called with what is measured next.
    """
    results, refused = [], []
    for case in cases:
        for contestant in field:
            tell(f"{case.name}: {contestant.label}")
            try:
                results.append(_result(case, contestant, repeat))
            except SceneError as error:
                refused.append((case.name, contestant.label, str(error)))
    found = []
    if costs:
        for what, value, scene, contestant, threads in variations(cases[0].scene):
            tell(f"cost: {what} {value}")
            trials = [run_trial(contestant, scene, threads) for _ in range(repeat)]
            seconds = statistics.median(one.seconds for one in trials)
            busy = statistics.median(one.cpu_seconds for one in trials)
            found.append(Cost(what, value, seconds, busy, max(one.peak_bytes for one in trials) / 2**20))
    return Race(tuple(results), tuple(found), tuple(refused))


def _result(case: Case, contestant: Contestant, repeat: int) -> Result:
    trials = [run_trial(contestant, case.scene) for _ in range(repeat)]
    return Result(
        case.name,
        contestant.label,
        case.excess(trials[0].image),
        case.noise,
        statistics.median(one.seconds for one in trials),
        statistics.median(one.cpu_seconds for one in trials),
        max(one.peak_bytes for one in trials) / 2**20,
    )


def variations(scene: Scene) -> Iterator[tuple[str, str, Scene, Contestant, int | None]]:
    """What a prediction's cost may depend on, one thing changed at a time."""
    tank = Contestant("tank", 0.01)
    rows, columns = scene.camera.shape
    for factor in (0.5, 1.0, 4.0):
        shape = (max(1, round(rows * factor)), max(1, round(columns * factor)))
        camera = replace(scene.camera, shape=shape, pixel_mm=scene.camera.pixel_mm / factor)
        yield "pixels", f"{shape[1]}×{shape[0]}", replace(scene, camera=camera), tank, None
    for order in (1, 2, 3, 20):
        yield "orders", f"1–{order}", scene, replace(tank, max_order=order), None
    width = scene.tank.size_mm[1]
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
