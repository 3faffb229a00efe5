"""What has happened, kept on disk from the first moment: a rig that fails at once has its reason there."""

import logging
from logging.handlers import RotatingFileHandler
from pathlib import Path

PARTS = ("tankrig", "drivers", "ui")
"""Whose loggers are listened to."""
NAME, MOST_BYTES = "window.log", 700_000


class KeptLog:
    """Writes what tankrig's parts log into a folder, as `window.log`; the last two megabytes of it.

    Where the disk cannot be written nothing is kept, for the window works without.

    Parameters
    ----------
    folder
        Made where it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self._handler: logging.Handler = logging.NullHandler()
        file = folder / NAME
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._handler = RotatingFileHandler(file, maxBytes=MOST_BYTES, backupCount=2, encoding="utf-8")
        except OSError as error:
            logging.getLogger(__name__).warning("%s: the log cannot be kept there (%s)", file, error.strerror)
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
