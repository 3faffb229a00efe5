"""Small parts of the rig's owner: the journal of doses by hand, and imports made ahead of a run."""

import logging

from tankrig.dosing.records import DoseDone, DoseIntent

_log = logging.getLogger(__name__)


class LedgerOnly:
    """Journal of doses outside of runs: the tank's ledger has them already; people find them in the log."""

    def dose_intent(self, intent: DoseIntent) -> None:
        """A dose is about to begin."""
        _log.info("dosing until the tank holds %g µl", intent.total_ul)

    def dose_done(self, done: DoseDone) -> None:
        """It is over."""
        _log.info("the tank holds %g µl", done.delivered_ul)


def import_ahead() -> None:
    """Import what a run needs while nothing goes on yet, so that its start is quick."""
    import tankrig.live.attached
    import tankrig.report.pictures
    import tankrig.run.start  # noqa: F401
