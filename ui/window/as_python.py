"""What is on screen as a few lines of Python that get the same numbers."""

from ui.window.source import Kind, Source

_RUN = """import tankrig

run = tankrig.open_run({path!r})
frames = run.frames  # xarray: counts by frame, with pattern, ink in the tank, exposure and time
fits = [event.fields for event in run.fits]  # as they were recorded
"""
_REFIT = """from dataclasses import replace

import tankrig
from tankrig.live.exposures import exposures_of
from tankrig.live.fits import fit_all, fit_dose
from tankrig.live.results import diluted

exposures = exposures_of(tankrig.open_run({path!r}))
phase = exposures.plan.phase  # which phase functions the run's sequence asks for
photographs = [one for one in exposures.photographs() if one.pattern in {patterns!r}]
{free}fits = []
for dose_ml in sorted({{one.dose_ml for one in photographs}}):
    start = diluted(fits[-1].medium, fits[-1].dose_ml, dose_ml) if fits else None
    fits.append(fit_dose([one for one in photographs if one.dose_ml == dose_ml], start, phase=phase))
start = None if fits[-1].medium.phase is None else diluted(fits[-1].medium, fits[-1].dose_ml, 1.0)
series = fit_all(photographs, start, phase=phase) if len(fits) > 1 else None
"""
_FREE = 'photographs = [replace(one, offset="free") for one in photographs]  # a background that is fitted\n'


def as_python(source: Source) -> str:
    """Lines that open the run of a source and get what it shows; empty for the camera alone.

    >>> from pathlib import Path
    >>> print(as_python(Source(Kind.REPLAY, Path("runs/a"))).splitlines()[2])
    run = tankrig.open_run('runs/a')
    """
    if source.run is None:
        return ""
    if source.kind is not Kind.REFIT or source.settings is None:
        return _RUN.format(path=str(source.run))
    free = _FREE if source.settings.free_background else ""
    return _REFIT.format(path=str(source.run), patterns=source.settings.patterns, free=free)
