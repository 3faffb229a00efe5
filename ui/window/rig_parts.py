"""Small parts of the rig's owner: a run that is ordered, the journal of doses by hand, and imports made ahead."""

import logging
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tankrig.dosing.records import DoseDone, DoseIntent

if TYPE_CHECKING:
    from tankrig.sequence import Sequence

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunOrder:
    """A run that is to be carried out.

    Parameters
    ----------
    path
        Its folder.
    sequence
        What to do; None to go on with the run that is there.
    delivered_ul
        A person's word on what the tank holds, where one was asked for.
    """

    path: Path
    sequence: "Sequence | None" = None
    delivered_ul: float | None = None


class LedgerOnly:
    """Journal of doses outside of runs: the tank's ledger has them already; people find them in the log."""

    def dose_intent(self, intent: DoseIntent) -> None:
        """A dose is about to begin."""
        _log.info("dosing until the tank holds %g µl", intent.total_ul)

    def dose_done(self, done: DoseDone) -> None:
        """It is over."""
        _log.info("the tank holds %g µl", done.delivered_ul)


_importing = threading.Lock()


def import_ahead() -> None:
    """Import what a run needs, in one thread at a time: zarr cannot be imported by two at once.

    Called while nothing goes on yet, so that a run's start is quick.
    """
    with _importing:
        import tankrig.live.attached
        import tankrig.report.pictures
        import tankrig.run.start  # noqa: F401
