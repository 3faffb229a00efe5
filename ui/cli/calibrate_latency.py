"""`tankrig calibrate latency`: how long light takes from a swap to the tank."""

from pathlib import Path

import click

from ui.cli.calibrating import accept_option, described, keep, tell
from ui.cli.options import FINITE, bench_option, json_option
from ui.guide import feedback


@click.command(epilog="Example: tankrig calibrate latency --rig rig.toml")
@bench_option
@click.option("--flips", type=click.IntRange(20, 10_000), default=100, show_default=True, help="How many to watch.")
@click.option("--exposure-ms", type=FINITE, help="Of the frames; default: as long as leaves no pause between them.")
@accept_option
@json_option
def latency(rig: Path | None, flips: int, exposure_ms: float | None, accept: bool, as_json: bool) -> int:
    """Measure the time from a swap of the projector to its light, by flips between black and white.

    The camera has to see the projector's light, in the tank or on a diffuser; no ink moves. Takes about ten seconds for
    a hundred flips. The 99th percentile belongs into the rig file: latency_ms in [projector].
    """
    from drivers.rig import open_light
    from tankrig.calibration.latency import latency_calibration, measure_latency
    from tankrig.calibration.lit_camera import Look

    description = described(rig)
    with open_light(description) as (projector, camera), feedback() as shown:
        put = getattr(camera, "put", None)
        if put is not None:
            put("diffuser")
        measured = measure_latency(
            projector, camera, flips, exposure_ms, tell=lambda done: shown.look(Look("flips", done / flips))
        )
        period_ms = description.exposure_rule.period_ms or 0.0
        calibration = latency_calibration(measured, projector, description.latency_ms, period_ms)
    kept = keep(calibration, description, accept, None)
    result, sd = kept.result, kept.sd
    rows = {
        "median": f"{result['median_ms']:.2f} ± {sd['median_ms']:.2g} ms",
        "99 % within": f"{result['p99_ms']:.2f} ms",
        "from … to": f"{result['least_ms']:.2f} … {result['most_ms']:.2f} ms, {flips} flips",
        "for the rig file": f"latency_ms = {result['p99_ms']:.1f} in [projector]",
    }
    return tell(kept, rows, as_json)
