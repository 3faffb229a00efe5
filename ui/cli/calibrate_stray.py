"""`tankrig calibrate stray`: what the camera's lens spreads beside what is bright, by a white card on a light trap."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ui.cli.boards import opened
from ui.cli.calibrating import accept_option, described, keep, tell
from ui.cli.options import FINITE, bench_option, json_option
from ui.guide import ask, picture, somebody

if TYPE_CHECKING:
    from tankrig.devices import Camera

_TRAP = (
    "Lay a light trap before the camera, larger than its picture: black velvet, or a box lined with it. Light it from "
    "aside with a steady lamp; the projector's light must not fall on it."
)
_REQUESTS = {
    "card": "Lay a white card on the trap, a tenth of the picture large, elsewhere than before.",
    "trap": "Take the card away, and leave the trap as it is.",
}
_SECONDS_A_PICTURE = 15.0


@click.command(epilog="Example: tankrig calibrate stray --rig rig.toml --cards 6")
@bench_option
@click.option("--cards", type=click.IntRange(3, 50), default=4, show_default=True, help="Places of the card.")
@click.option("--frames", type=click.IntRange(1, 100), default=8, show_default=True, help="Frames of each picture.")
@click.option("--exposure-ms", type=FINITE, help="Of the frames; default: what suits the card.")
@accept_option
@json_option
def stray(rig: Path | None, cards: int, frames: int, exposure_ms: float | None, accept: bool, as_json: bool) -> int:
    """Measure the camera's halo and veil: the light that its lens spreads far beside what is bright.

    Wants the radiometry calibrated, and a white card that is laid on a light trap at several places, in the light of a
    lamp. What the trap sends back is subtracted. Models have the halo and the veil from then on; a halo of 2 % that a
    fit does not know makes σs 2 % too large and looks like noise. No ink moves.
    """
    from contextlib import suppress

    import numpy as np

    from tankrig.calibration.file import in_force
    from tankrig.calibration.geometry_in_force import require
    from tankrig.calibration.pictures import Pictures
    from tankrig.calibration.radiometry import Radiometry
    from tankrig.calibration.stray_light import find_stray
    from tankrig.errors import DeviceError
    from tankrig.figures.stray_figure import write_stray_figure

    description = described(rig)
    force = in_force(Path(description.calibration_folder), description.calibration, ("radiometry",))
    linear = require(force, "radiometry")
    radiometry = Radiometry.of(linear)
    click.echo(f"takes about {(cards + 2) * _SECONDS_A_PICTURE / 60.0:.0f} minutes on the bench", err=True)
    with opened(description, "camera") as (camera,):
        linear.require_for(camera.name, camera.shape)
        put = _asker(camera)
        pictures = Pictures(camera, exposure_ms)

        def seen(what: str, number: int) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
            put(what, number)
            if what == "card" and number == 0:
                pictures.suit()
            taken = [pictures.take() for _ in range(frames)]
            picture(f"{what} {number + 1}", taken[0], camera.saturation)
            light = np.mean([radiometry.light(one, pictures.settings) for one in taken], axis=0)
            return radiometry.mended(np.asarray(light, float))

        try:
            lit = [seen("card", 0)]
            traps = [seen("trap", 0)]
            lit += [seen("card", number) for number in range(1, cards)]
            traps.append(seen("trap", 1))
        finally:
            with suppress(DeviceError):  # a camera that is gone sees no trap
                put("nothing", 0)
        name = camera.name
    found = find_stray(lit, traps)
    kept = keep(
        found.calibration(name, {"radiometry": linear.hash}), description, accept,
        lambda path: write_stray_figure(path, name, found),
    )  # fmt: skip
    rows = {
        "halo": f"{100 * found.share:.2f} ± {100 * found.sd[0]:.2g} % of the light, standard deviation "
        f"{found.sigma_px:.0f} ± {found.sd[1]:.2g} px",
        "veil": f"{100 * found.veil:.2f} ± {100 * found.sd[2]:.2g} % of the light",
        "unlike these": f"{found.misfit:.1%} of the light beside the card",
    }
    return tell(kept, rows, as_json)


def _asker(camera: "Camera") -> Callable[[str, int], None]:
    """Have the card laid down or taken away; a simulated camera does it by itself."""
    hold: Callable[[str, int], None] | None = getattr(camera, "hold", None)
    if hold is not None:
        return hold
    if not somebody():
        raise click.UsageError("somebody has to lay the card on the trap; run this on a terminal")

    def request(what: str, number: int) -> None:
        if what == "nothing":
            return
        ask(f"{_TRAP} {_REQUESTS['card']}" if (what, number) == ("card", 0) else _REQUESTS[what])

    return request
