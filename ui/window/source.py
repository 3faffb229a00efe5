"""What the window looks at: the camera, a recorded run as it was, or a recorded run fitted anew."""

from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from ui.window.phase_words import asked_in_words

if TYPE_CHECKING:
    from tankrig.scene.phase_table import PhaseFunction


class Kind(Enum):
    """Where numbers and pictures on screen come from."""

    LIVE = "live"
    REPLAY = "replay"
    REFIT = "refit"


@dataclass(frozen=True)
class RefitSettings:
    """What a run is fitted anew with.

    Parameters
    ----------
    patterns
        Names of those that count, in alphabetical order.
    free_background
        Whether a constant background is fitted, rather than the dark frames trusted to have taken it out.
    phase
        Which phase functions are searched, as in `tankrig.estimate`.

    Examples
    --------
    >>> RefitSettings(("rays", "sheet"), free_background=True).words
    'rays, sheet; background fitted'
    >>> RefitSettings(("rays",), phase="fournier-forand").words
    'rays; dark frames subtracted; Fournier–Forand asked for'
    """

    patterns: tuple[str, ...]
    free_background: bool = False
    phase: "str | PhaseFunction" = "hg"

    @property
    def words(self) -> str:
        """For people."""
        background = "; background fitted" if self.free_background else "; dark frames subtracted"
        asked = "" if self.phase == "hg" else f"; {asked_in_words(self.phase)} asked for"
        return ", ".join(self.patterns) + background + asked


@dataclass(frozen=True)
class Source:
    """One source: everything on screen belongs to it. Two sources are the same where all of this is equal.

    Parameters
    ----------
    kind
        Live, replay or refit.
    run
        Folder of the run; None for the camera while nothing has been recorded.
    settings
        Of a refit.
    ended
        Whether the run is over that was recorded live; the source is the same.

    Examples
    --------
    >>> Source(Kind.LIVE).title
    'LIVE: the camera'
    >>> Source(Kind.LIVE, Path("runs/a"), ended=True).title
    'LIVE: the camera, and run a, which is over'
    >>> Source(Kind.REFIT, Path("runs/a"), RefitSettings(("sheet",))).title
    'REFIT of a with sheet; dark frames subtracted'
    """

    kind: Kind
    run: Path | None = None
    settings: RefitSettings | None = None
    ended: bool = field(default=False, compare=False)

    @property
    def title(self) -> str:
        """What stands above everything that belongs to it."""
        if self.run is None:
            return "LIVE: the camera"
        if self.kind is Kind.LIVE:
            return f"LIVE: the camera, and run {self.run.name}" + (", which is over" if self.ended else "")
        if self.settings is None:
            return f"REPLAY of {self.run.name}"
        return f"REFIT of {self.run.name} with {self.settings.words}"

    @property
    def recorded(self) -> Path | None:
        """The run whose stored frames are shown; None where the camera's are."""
        return None if self.kind is Kind.LIVE else self.run


LIVE = Source(Kind.LIVE)
"""The camera, before any run."""
