"""What the window has done in its background process: each a plain function of things that can be sent there."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import StoreError
from tankrig.run.regions import Counted, Region, read_regions, write_regions
from tankrig.run.regions import count_regions as in_all_frames
from tankrig.scene.description import Camera, Medium, Tank
from ui.window import progress
from ui.window.source import RefitSettings

if TYPE_CHECKING:
    from tankrig.advice.design import Wanted
    from tankrig.advice.expected import Expected
    from tankrig.advice.next_pictures import NextPictures
    from tankrig.advice.ranking import Advice
    from tankrig.bench import Bench, KnownScenes
    from tankrig.live.exposures import Photograph
    from tankrig.live.results import DoseFit, SeriesFit
    from tankrig.prediction import Prediction
    from tankrig.run.reading import Run
    from tankrig.scene import Scene
    from tankrig.scene.phase_table import PhaseFunction
    from tankrig.sequence import Pace

Image = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Comparison:
    """One photograph beside the model's image of it.

    Parameters
    ----------
    pattern, dose_ml
        What it is of.
    observed, model, residual
        (rows, columns), counts per ms; the residual is NaN where a pixel was left out.
    rmse
        Root mean square of what each sum of orders leaves, as a part of the observed peak; "single" is single
        scattering at its own best σt.
    tank, camera
        Where the pixels lie.
    """

    pattern: str
    dose_ml: float
    observed: Image
    model: Image
    residual: Image
    rmse: dict[str, float]
    tank: Tank
    camera: Camera


@dataclass(frozen=True, eq=False)
class Reading:
    """A run as it was read from disk.

    Parameters
    ----------
    run
        The run.
    labels
        Of its steps, all of them; a run that was imported followed none.
    patterns
        Names of those that light anything and can be fitted.
    bench
        Where it was recorded.
    without_fits
        Whether its recorded fits do not hold, see `tankrig.live.recorded.fits_that_hold`.
    counted
        In regions of its frames, where some are saved with it.
    doubts
        What lies beside the run and cannot be read, in sentences.
    separates
        Whether it has steps that separate orders of scattering.
    phase
        Which phase functions its fits search, as its sequence asked.
    """

    run: "Run"
    labels: tuple[str, ...]
    patterns: tuple[str, ...]
    bench: "Bench | KnownScenes"
    without_fits: bool = False
    counted: tuple[Counted, ...] = ()
    doubts: tuple[str, ...] = ()
    separates: bool = False
    phase: "str | PhaseFunction" = "hg"


@dataclass(frozen=True, eq=False)
class Found:
    """What the background has found of a run: fits, and the photographs that they are of.

    Parameters
    ----------
    doses, series
        Fits; the series where there are two doses or more.
    photographs
        What was fitted, as it was fitted.
    left_out
        What is not fitted, in sentences.
    """

    doses: "tuple[DoseFit, ...]"
    series: "SeriesFit | None"
    photographs: "tuple[Photograph, ...]"
    left_out: tuple[str, ...] = ()


def compare(photograph: "Photograph", fit: "DoseFit") -> Comparison:
    """The model's image of a photograph at a fit's coefficients, by orders of scattering."""
    from tankrig.report.pictures import by_order, predicted

    prediction = predicted(photograph, fit)
    gain, peak = fit.gain, float(photograph.image.max())
    left = (photograph.image - gain * prediction.image)[photograph.used]
    offset = 0.0 if photograph.offset == 0.0 else float(np.median(left))
    rebuilt = by_order(photograph, prediction, gain, offset)
    rmse = {one.orders: one.rmse / peak for one in rebuilt}
    if fit.single is not None:
        rmse["single"] = _single(photograph, fit.medium, fit.single.sigma_t) / peak
    scene = photograph.scene
    return Comparison(
        photograph.pattern, photograph.dose_ml, photograph.image, rebuilt[-1].image, rebuilt[-1].residual, rmse,
        scene.tank, scene.camera,
    )  # fmt: skip


def _single(photograph: "Photograph", medium: Medium, sigma_t: float) -> float:
    """RMSE of this photograph by single scattering at the σt that is best for all of the dose's.

    At its own gain and, where that is free, its own background.
    """
    from tankrig.light.single import single_scattering

    by = sigma_t / medium.sigma_t
    thin = replace(medium, sigma_a=by * medium.sigma_a, sigma_s=by * medium.sigma_s)
    thinned = replace(photograph.scene, medium=thin)
    image, observed = single_scattering(thinned)[photograph.used], photograph.image[photograph.used]
    design = np.stack([image] if photograph.offset == 0.0 else [image, np.ones_like(image)], axis=1)
    best = np.linalg.lstsq(design, observed, rcond=None)[0]
    return float(np.sqrt(np.mean((observed - design @ best) ** 2)))


def read(path: Path) -> Reading:
    """Read a run from disk: its journal, its steps, and where it was recorded.

    Raises
    ------
    StoreError
        When it cannot be read.
    """
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.live.recorded import fits_that_hold, wave_names
    from tankrig.run.reading import open_run
    from tankrig.sequence.loading import sequence_from_table

    run = open_run(path)
    table = run.settings.get("sequence")
    labels = () if table is None else tuple(task.label for task in sequence_from_table(dict(table), str(path)).tasks)
    waves = wave_names(run)
    lit = tuple(one.name for one in run.patterns.values() if one.pixels.any() and one.name not in waves)
    plan = PhotographPlan.of_run(run)
    _ = run.conditions  # found here and not where it would keep the window waiting
    wrong = bool(run.fits) and not fits_that_hold(run)
    counted: tuple[Counted, ...] = ()
    doubts: tuple[str, ...] = ()
    try:
        counted = read_regions(path)
    except StoreError as error:
        doubts = (str(error),)
    return Reading(run, labels, lit, plan.bench, wrong, counted, doubts, bool(waves), plan.phase)


def count_regions(path: Path, regions: tuple[Region, ...]) -> tuple[Counted, ...]:
    """Count regions in all frames of a run, and save that with it.

    Raises
    ------
    StoreError
        When a frame cannot be read, or the file not be written.
    """
    from tankrig.run.reading import open_run

    counted = in_all_frames(open_run(path), regions, progress.done)
    write_regions(path, counted)
    return counted


def found_in(path: Path) -> Found:
    """The last fits that a run has recorded, and the photographs that they are of."""
    from tankrig.report.results import results_of
    from tankrig.run.reading import open_run

    results = results_of(open_run(path))
    return Found(tuple(results.doses), results.series, tuple(results.photographs), results.left_out)


def refit(path: Path, settings: RefitSettings) -> Found:
    """Fit a run anew, with some of its patterns only, or with a background that is fitted rather than subtracted.

    The phase functions that are searched are those of the settings, and the search goes as that of `tankrig refit`.

    Returns
    -------
    The fit of each dose, that of the series where there are two doses or more, and the photographs as they were fitted.

    Raises
    ------
    ImageError
        When the run has no photograph of these patterns with ink in the tank.
    """
    from tankrig.errors import ImageError
    from tankrig.live.exposures import exposures_of
    from tankrig.live.fits import fit_all, fit_dose
    from tankrig.live.results import diluted
    from tankrig.run.reading import open_run

    photographs = [one for one in exposures_of(open_run(path)).photographs() if one.pattern in settings.patterns]
    if not photographs:
        raise ImageError(
            f"{path}: has no photograph of {', '.join(settings.patterns)} with ink in the tank; choose other patterns"
        )
    if settings.free_background:
        photographs = [replace(one, offset="free") for one in photographs]
    fits: list[DoseFit] = []
    doses_ml = sorted({one.dose_ml for one in photographs})
    for number, dose_ml in enumerate(doses_ml):
        progress.done(number / (len(doses_ml) + 1))
        here = [one for one in photographs if one.dose_ml == dose_ml]
        start = diluted(fits[-1].medium, fits[-1].dose_ml, dose_ml) if fits else None
        fits.append(fit_dose(here, start, phase=settings.phase))
    if len(fits) < 2:
        return Found(tuple(fits), None, tuple(photographs))
    last = fits[-1]
    # Henyey–Greenstein's three numbers are found from anywhere; other phase functions from what a dose has found.
    start = None if last.medium.phase is None else diluted(last.medium, last.dose_ml, 1.0)
    return Found(tuple(fits), fit_all(photographs, start, phase=settings.phase), tuple(photographs))


@dataclass(frozen=True)
class Suggestion:
    """Something to photograph next.

    Parameters
    ----------
    words
        What, and what it is expected to tell.
    total_ul
        Ink that the tank has to hold for it; None where it holds that already.
    pattern, table
        Name of the pattern, and its table in a sequence file; None where every sequence has it.
    frames
        How many.
    more
        What else a sequence file says of the capture: its exposure, and what ends it.
    """

    words: str
    total_ul: float | None
    pattern: str
    table: dict[str, Any] | None
    frames: int
    more: Mapping[str, Any] = field(default_factory=dict)


ADVISED = {"sigma_s": "σs", "g": "g", "sigma_a": "σa"}
BEST = 5
"""Suggestions that are shown."""


def advise(path: Path, pace: "Pace", most_ul: float) -> tuple[Suggestion, ...]:
    """What would tell most next, by what a run has photographed and fitted so far; the best first.

    Parameters
    ----------
    path
        Of the run.
    pace, most_ul
        Of the rig: how long steps take, and what the tank may hold in all, µl.

    Raises
    ------
    ImageError
        When the run has no photograph of ink, or no fit of one.
    """
    from tankrig.advice.candidates import beginning_of, candidates_of
    from tankrig.advice.ranking import prepared_answer, ranked
    from tankrig.run.reading import open_run

    known, taken, plan, exposure_ms = beginning_of(path)
    run = open_run(path)
    candidates = candidates_of(taken, plan, exposure_ms, pace, most_ul)
    shots = [*taken, *(one.shot for one in candidates)]
    answer = prepared_answer(known, [one.scene for one in shots], [one.dose_ml for one in shots], progress.done)
    before, found = ranked(known, taken, candidates, answer)
    patterns = dict(run.require_sequence().get("patterns", {}))
    held_ul = 1000.0 * max(shot.dose_ml for shot in taken)
    return tuple(
        Suggestion(
            _words(one, before, held_ul),
            1000.0 * one.candidate.shot.dose_ml if one.candidate.volume_ul > 0.0 else None,
            one.candidate.shot.pattern,
            patterns.get(one.candidate.shot.pattern),
            one.candidate.shot.frames,
        )
        for one in found[:BEST]
    )


DESIGNED = "designed"
"""Name of a designed picture's pattern, where a sequence has none of that name."""
DESIGNED_FRAMES = 4
"""Of a designed picture, unless the run's own captures were to end by an `until` that is not reached."""


def design(
    path: Path,
    fit: "DoseFit",
    photographs: "tuple[Photograph, ...]",
    wanted: "Wanted" = "all",
    heights_mm: tuple[float, ...] = (),
) -> Suggestion:
    """The picture of cells that would tell most beside what a run has photographed at a dose.

    Parameters
    ----------
    path
        Of the run, which may go on.
    fit
        Of the dose.
    photographs
        Of the dose, as they were fitted: they will be fitted with the picture.
    wanted
        What is to be known.
    heights_mm
        Middles of its sheets; empty: half the tank's height.

    Raises
    ------
    SceneError, SequenceError
        When there are no pictures of such cells, or none can be designed for such a liquid.
    """
    from tankrig.advice.cells import cells_in
    from tankrig.advice.next_pictures import next_pictures, table_of
    from tankrig.advice.starting import from_fit
    from tankrig.bench import Bench
    from tankrig.errors import SequenceError
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.live.results import to_fields
    from tankrig.pattern.kinds import draw
    from tankrig.run.reading import open_run
    from tankrig.sequence import Capture
    from tankrig.sequence.loading import sequence_from_table

    run = open_run(path)
    plan = PhotographPlan.of_run(run)
    if not isinstance(plan.bench, Bench):
        raise SequenceError(f"{path}: was imported, and nobody knows which projector could show pictures for it")
    sequence = sequence_from_table(dict(run.require_sequence()), str(path))
    cells = cells_in(plan.bench.tank.size_mm, heights_mm)
    draw(cells, plan.bench.wall)  # what the projector cannot show is refused before anything is computed
    captures = [task.action for task in sequence.tasks if isinstance(task.action, Capture)]
    like = next((one for one in reversed(captures) if one.pattern in fit.patterns), Capture("full"))
    camera, full = sequence.camera_settings(like), plan.saturation
    known, taken = from_fit(fit, photographs)
    found = next_pictures(
        known, fit.dose_ml, fit.sd, plan.bench, photographs[0].scene.camera, cells, 1, DESIGNED_FRAMES, wanted,
        None if full is None else full / (camera.exposure_ms * camera.gain), progress=progress.done, taken=taken,
    )  # fmt: skip
    # As it was designed for: the sequence that it is appended to may have another exposure.
    more: dict[str, Any] = {"exposure_ms": camera.exposure_ms} | ({"gain": camera.gain} if camera.gain != 1.0 else {})
    until = like.until if like.until is not None and not like.until.reached(to_fields(fit)) else None
    if until is not None:
        more["until"] = {name: wish for name, wish in vars(until).items() if wish is not None}
        more |= {} if like.timeout_s is None else {"timeout_s": like.timeout_s}
    return Suggestion(
        _words_of_design(found, fit.dose_ml), None, DESIGNED, table_of(found.design.pictures[0]),
        DESIGNED_FRAMES if until is None else like.frames,
        more,
    )  # fmt: skip


def _words_of_design(found: "NextPictures", dose_ml: float) -> str:
    """A picture that was designed, and by how much it is expected to narrow what is known."""
    (picture,) = found.design.pictures
    sheets = " and ".join(f"{0.5 * sum(z_mm):g}" for z_mm in picture.z_mm)
    told = []
    for name, symbol in ADVISED.items():
        after, now = found.design.after.relative_sd[name], found.now.relative_sd[name] if found.now else math.inf
        told.append(f"{symbol} {100.0 * after / now:.0f} %")
    return (
        f"at {1000.0 * dose_ml:g} µl: a designed picture of {len(picture.light[0])} cells at z = {sheets} mm × "
        f"{found.frames}; errors then, of what they are now: {', '.join(told)}; {found.bits:.2f} bits more "
        f"than {found.best}"
    )


def _words(one: "Advice", before: "Expected | None", held_ul: float) -> str:
    """A suggestion, and by how much it is expected to narrow what is known."""
    shot = one.candidate.shot
    dose = f"dose to {1000.0 * shot.dose_ml:g} µl, then " if one.candidate.volume_ul > 0.0 else f"at {held_ul:g} µl: "
    told = []
    for name, symbol in ADVISED.items():
        after, now = one.after.relative_sd[name], before.relative_sd[name] if before is not None else math.inf
        told.append(f"{symbol} {100.0 * after / now:.0f} %" if math.isfinite(now) and now > 0.0 else symbol)
    minutes = one.candidate.minutes
    return (
        f"{dose}{shot.pattern} × {shot.frames}, about {minutes:.1f} min; errors then, of what they are now: "
        f"{', '.join(told)}"
    )


def compare_models(photograph: "Photograph") -> tuple[tuple[str, ...], ...]:
    """A photograph fitted by several models: a row of words for each, see `tankrig.estimation.comparison`."""
    from tankrig.estimation.comparison import compare_models as compared
    from tankrig.live.formatting import with_error

    found = compared(
        photograph.image, photograph.scene, offset=photograph.offset, noise=photograph.noise, mask=photograph.mask
    )
    peak = float(photograph.image.max())
    rows: list[tuple[str, ...]] = []
    for one in found.rows:
        if one.estimate is None:
            rows.append((one.contender.name, "–", "", "", "", one.refusal))
            continue
        interval = one.estimate.interval(0.95)
        cells = []
        for name in ("sigma_s", "g", "sigma_a"):
            low, high = interval[name]
            text = with_error(getattr(one.estimate.medium, name), 0.5 * (high - low)) if high - low < 1e9 else "–"
            cells.append(text if one.estimate.identifiable[name] else f"({text})")
        rows.append((one.contender.name, f"{100.0 * one.estimate.rmse / peak:.2g}", *cells, f"{one.bic:.0f}"))
    return tuple(rows)


def predict_scene(scene: "Scene", tolerance: float) -> "Prediction":
    """The picture of a scene, as its image alone: orders would only make it slow to hand over."""
    import tankrig

    return replace(tankrig.predict(scene, tolerance=tolerance), orders={})


def report(path: Path) -> Path:
    """Write a run's report, once what it lacks is fitted; of a search for the ink's own phase function, which takes ten
    minutes and more, it says that it is missing."""
    from tankrig.live.refit import refit as fit_what_is_missing
    from tankrig.report import write_report

    fit_what_is_missing(path, further=False)
    return write_report(path)


def export(path: Path, target: Path) -> Path:
    """Write a run's frames as NetCDF where the target ends in .nc, else as a folder of TIFFs."""
    from tankrig.run.export import export_netcdf, export_tiff
    from tankrig.run.reading import open_run

    (export_netcdf if target.suffix == ".nc" else export_tiff)(open_run(path), target)
    return target
