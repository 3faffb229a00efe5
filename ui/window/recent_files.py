"""The files and runs that were open lately, kept in the window's settings."""

from pathlib import Path
from typing import Any

from PySide6.QtCore import QSettings

MOST_RECENT = 8


class RecentFiles:
    """The last ones first.

    Parameters
    ----------
    settings
        That outlive the window.
    """

    def __init__(self, settings: QSettings) -> None:
        self._settings = settings

    def remember(self, path: Path) -> None:
        """List this first."""
        others = (str(one) for one in self.still_there() if one != path.absolute())
        self._settings.setValue("recent", [str(path.absolute()), *others][:MOST_RECENT])

    def still_there(self) -> list[Path]:
        """Those that have not been deleted since."""
        kept: Any = self._settings.value("recent") or []
        paths = [Path(str(one)) for one in ([kept] if isinstance(kept, str) else kept)]
        return [path for path in paths if path.exists()]
