"""Asking for a file without holding up the window: STOP and all else work while the question is open."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog, QWidget


def ask_for_file(parent: QWidget, title: str, begin: Path, kinds: str, then: Callable[[Path], object]) -> QFileDialog:
    """Ask for a file that exists, and hand it to `then`.

    Parameters
    ----------
    parent
        Over which the question stands.
    title
        What the file is for.
    begin
        Folder to begin in.
    kinds
        As Qt has them: "Sequences (*.toml)".
    """
    dialog = _asked(parent, title, begin, kinds, then)
    dialog.setFileMode(QFileDialog.FileMode.ExistingFile)
    dialog.show()
    return dialog


def ask_where_to_save(
    parent: QWidget, title: str, proposal: Path, kinds: str, then: Callable[[Path], object]
) -> QFileDialog:
    """Ask for a file to write, and hand it to `then`; `proposal` is what it may be called."""
    dialog = _asked(parent, title, proposal.parent, kinds, then)
    dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
    dialog.setDefaultSuffix(proposal.suffix.removeprefix("."))
    dialog.selectFile(proposal.name)
    dialog.show()
    return dialog


def _asked(parent: QWidget, title: str, begin: Path, kinds: str, then: Callable[[Path], object]) -> QFileDialog:
    dialog = QFileDialog(parent, title, str(begin), kinds)
    dialog.setModal(False)
    dialog.setOption(QFileDialog.Option.DontUseNativeDialog)  # a desktop's own gets its keys past Qt, STOP's included
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    dialog.fileSelected.connect(lambda name: then(Path(name)))
    return dialog
