"""What has happened, kept on disk from the first moment: a rig that fails at once has its reason there."""

import logging
import sys
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from io import TextIOWrapper

PARTS = ("tankrig", "drivers", "ui")
"""Whose loggers are listened to."""
NAME, MOST_BYTES = "window.log", 700_000


class KeptLog:
    """Writes what tankrig's parts log into a folder, as `window.log`; the last two megabytes of it.

    Where the disk cannot be written nothing is kept, for the window works without.

    Parameters
    ----------
    folder
        Made with the first line where it is not there: a window that could not be opened leaves none behind.
    """

    def __init__(self, folder: Path) -> None:
        self._handler = _Written(folder / NAME)
        self._handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        self._handler.setLevel(logging.INFO)
        for part in PARTS:
            logging.getLogger(part).addHandler(self._handler)
            logging.getLogger(part).setLevel(logging.INFO)

    def close(self) -> None:
        """Listen no more."""
        for part in PARTS:
            logging.getLogger(part).removeHandler(self._handler)
        self._handler.close()


class _Written(RotatingFileHandler):
    """A file that is made, with its folder, when there is something to be written."""

    def __init__(self, file: Path) -> None:
        super().__init__(file, maxBytes=MOST_BYTES, backupCount=2, encoding="utf-8", delay=True)

    def _open(self) -> "TextIOWrapper":
        Path(self.baseFilename).parent.mkdir(parents=True, exist_ok=True)
        return super()._open()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: ARG002, N802 - logging's own
        """Say once that nothing is kept, in place of a traceback with each line."""
        for part in PARTS:
            logging.getLogger(part).removeHandler(self)
        _, error, _ = sys.exc_info()
        why = error.strerror if isinstance(error, OSError) else error
        logging.getLogger(__name__).warning("%s: the log cannot be kept there (%s)", self.baseFilename, why)
