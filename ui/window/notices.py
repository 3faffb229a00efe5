"""What the strip across the window says of rig, runs and sequence, and how long each of it is true."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject

from tankrig.run.state import FinishReason
from ui.window.banner import Banner
from ui.window.fresh_water import WAY, asks_for_it
from ui.window.status import RigState, RigStatus
from ui.window.words import capitalised

if TYPE_CHECKING:
    from tankrig.run.runner import Outcome
    from ui.window.run_summary import RunSummary
    from ui.window.sequence_text import Problem
    from ui.window.source import Source

_log = logging.getLogger(__name__)

Do = Callable[[], object]
"""What a notice's button does."""
NOT_NOW = "not now"
"""What was refused because the rig was at work, or was not ready: no longer true once it is ready."""
SEQUENCE = "sequence"
"""What is wrong with the sequence: no longer true once something else is, or nothing."""


class Notices(QObject):
    """Says them in a strip, and withdraws them.

    Parameters
    ----------
    banner
        The strip.
    """

    def __init__(self, banner: Banner) -> None:
        super().__init__(banner)
        self._banner = banner
        self._wrong: Problem | None = None

    def tell(self, sentence: str, key: str = "", action: str = "", do: Do | None = None, level: str = "") -> None:
        """Say something that a person has to know; see `Notice`."""
        _log.warning("%s", sentence)
        self._banner.say(capitalised(sentence), level, action, do, key)

    def follow_rig(self, before: RigStatus, status: RigStatus, reopen: Do, fresh_water: Do | None) -> None:
        """Say what is wrong with the rig for as long as it is, with a button that opens it again or leads to fresh
        water; None where there is no page for that yet."""
        failed = status.state is RigState.FAILED
        water = fresh_water if asks_for_it(status.trouble) else None
        if status.troubles != before.troubles and status.trouble:
            action = "Open the rig again" if failed else WAY if water else ""
            self._banner.say(status.trouble, "bad", action, reopen if failed else water, "trouble")
        elif not status.trouble:
            self._banner.withdraw("trouble")
        if before.stopped and not status.stopped:
            self._banner.withdraw("stop")
        if status.state is RigState.IDLE and not status.busy and (before.busy or before.state is not RigState.IDLE):
            self._banner.withdraw(NOT_NOW)

    def say_stopped(self) -> None:
        """A person has pressed STOP."""
        words = "STOP: the doser is stopped; a run that went on is being aborted and can be resumed."
        self._banner.say(words, "bad", key="stop")

    def say_window_closes(self) -> None:
        """A person closes the window while a run goes on."""
        self._banner.say("The run is being ended; the window closes when all it recorded is safe.", "bad")

    def forget_last_run(self) -> None:
        """A run has begun: what was said of the rig and of the run before is no longer true."""
        self._banner.withdraw("stop", "trouble", "interrupted", "ended", "unfitted", NOT_NOW)

    def forget_run(self, path: Path) -> None:
        """A run has been deleted."""
        self._banner.withdraw(str(path))

    def say_interrupted(self, run: "RunSummary", resume: Do) -> None:
        """After a crash, or an abort, say so where the person looks first."""
        why = f" ({run.message})" if run.message else ""
        words = f"The last run, {run.path.name}, was {run.ending}{why}. What it recorded is safe; it can go on."
        self._banner.say(words, action="Resume it", do=resume, key="interrupted", about=str(run.path))

    def say_ended(self, outcome: "Outcome", report: Do, resume: Do) -> None:
        """A run is over: its report can be written, or it can be resumed."""
        path, completed = outcome.path, outcome.reason is FinishReason.COMPLETED
        why = f": {outcome.error}" if outcome.error is not None else "."
        words = f"The run {path.name} was {outcome.reason.value}{why}"
        level = "bad" if outcome.error is not None else "good" if completed else ""
        _log.info("%s", words)
        action, do = ("Write its report", report) if completed else ("Resume it", resume)
        self._banner.say(words, level, action, do, "ended", str(path))

    def say_unfitted(self, path: Path, missing: str, show: Do) -> None:
        """A run is over that was not fitted to its end."""
        words = f"Not fitted yet of {path.name}: {missing}. Open the run and press Fit anew."
        self._banner.say(words, "", "Open it", show, "unfitted", str(path))

    def say_refitted(self, source: "Source", show: Do) -> None:
        """A refit has come while something else was on screen."""
        words = f"Finished: {source.title}."
        self._banner.say(words, "good", "Show it", show, key=source.title, about=str(source.run))

    def say_of_report(self, run: Path, sentence: str, level: str) -> None:
        """What becomes of the report of a run; each sentence takes the place of the one before."""
        _log.info("%s", sentence)
        self._banner.say(sentence, level, key=f"report of {run}", about=str(run))

    def say_unsaved(self, edit: Do) -> None:
        """A sequence was opened over edits that no file has: offer them back."""
        words = "The sequence that was being edited had not been saved."
        self._banner.say(words, action="Edit it again", do=edit, key="dropped")

    def follow_sequence(self, problem: "Problem | None") -> None:
        """What was said of the sequence goes once something else is wrong with it, or nothing."""
        before, self._wrong = self._wrong, problem
        if self._wrong != before:
            self._banner.withdraw(SEQUENCE)
