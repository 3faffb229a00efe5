"""What a refit rests on, as one hash: frames, calibrations, model and code; the same hash, the same fits."""

import hashlib
import json
from dataclasses import dataclass
from typing import Any, Literal

from tankrig.run.reading import Run

KEY_DIGITS = 32


@dataclass(frozen=True)
class Refitting:
    """What all runs of an archive are fitted with.

    Parameters
    ----------
    mark
        Of the code (`tankrig.archive.mark.refit_mark`).
    model
        "prepared": as the live fit does; "tank": by following light paths.
    """

    mark: str
    model: Literal["prepared", "tank"] = "prepared"


def refit_key(run: Run, refitting: Refitting) -> str:
    """The hash of all that a run's refit depends on.

    That is each frame's SHA-256, pattern and what was true when it was exposed; the calibrations in force, by their
    hashes; bench, sequence and saturation; the model and the mark of the code. Not what the run is called, where it
    lies, or what was fitted before.
    """
    lost = [[one.after_seq, list(one.frames), one.may_be_dose] for one in run.lost]
    conditions = run.conditions
    frames = [
        [
            event["index"], event["sha256"], event["pattern_hash"], event["step"],
            event["index"] in run.unsure_doses, conditions[event["index"]].line(),
        ]
        for event in run.events("frame")
    ]  # fmt: skip
    told = ("bench", "sequence", "scenes", "saturation", "calibrations")
    what = {
        "frames": frames,
        "lost": lost,
        "left_out": list(run.left_out),
        "settings": {name: run.settings[name] for name in told if name in run.settings},
        "model": refitting.model,
        "mark": refitting.mark,
    }
    return hashlib.sha256(_text(what).encode()).hexdigest()[:KEY_DIGITS]


def _text(what: Any) -> str:
    return json.dumps(what, sort_keys=True, separators=(",", ":"), default=str)
