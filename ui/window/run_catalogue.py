"""The runs of a folder, and the one that is selected: by what it is, never by where it stands in a list."""

from pathlib import Path

from PySide6.QtCore import QObject, Signal

from ui.window.run_summary import RunSummary, summaries


class RunCatalogue(QObject):
    """The runs of a folder as far as a filter lets them through, and at most one that is selected.

    A run that is not visible is not selected: what is done with "the selected run" is done with one that a person sees.

    Parameters
    ----------
    folder
        Of the runs.
    """

    changed = Signal()

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.folder = folder
        self.runs: tuple[RunSummary, ...] = ()
        self._words: tuple[str, ...] = ()
        self._selected: Path | None = None

    @property
    def visible(self) -> tuple[RunSummary, ...]:
        """Runs that the filter lets through, the newest first."""
        return tuple(one for one in self.runs if all(word in one.searched for word in self._words))

    @property
    def selected(self) -> RunSummary | None:
        """The run that is selected, as it was when the folder was last looked at."""
        return next((one for one in self.runs if one.path == self._selected), None)

    def find(self, path: Path) -> RunSummary | None:
        """A run by its folder."""
        return next((one for one in self.runs if one.path == path), None)

    def refresh(self) -> None:
        """Look at the folder again; where nothing is selected yet, the newest run is."""
        first = not self.runs
        self.runs = summaries(self.folder)
        if first and self.visible:
            self._selected = self.visible[0].path
        self._settle()

    def sift(self, words: str) -> None:
        """Let through only runs that have all of these words."""
        self._words = tuple(words.lower().split())
        self._settle()

    def select(self, path: Path | None) -> None:
        """Select a run that is visible; None: none."""
        if path != self._selected:
            self._selected = path
            self._settle()

    def _settle(self) -> None:
        if self._selected not in {one.path for one in self.visible}:
            self._selected = None
        self.changed.emit()
