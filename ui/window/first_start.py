"""What stands where a sequence would, before there is one: the three ways to begin."""

from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFrame, QLabel, QPushButton, QVBoxLayout, QWidget

CONNECT = (
    "A rig is described in a small text file: which drivers, where the devices are, how much ink is allowed.<ol>"
    "<li><b>tankrig devices</b> lists what is connected, with the lines for that file.</li>"
    "<li><b>tankrig doctor rig.toml</b> checks the file step by step and says what is missing.</li>"
    "<li>Open it here; the Calibration page then leads through what has to be measured.</li></ol>"
)


EXAMPLE = Path(__file__).with_name("dilution.toml")


class FirstStart(QWidget):
    """Three large buttons, each with what it does."""

    try_asked = Signal()
    """The example, on the rig that there is."""
    rig_asked = Signal()
    run_asked = Signal()
    build_asked = Signal()
    """An empty sequence, to be built step by step."""

    def __init__(self, simulated: bool) -> None:
        super().__init__()
        where = "on the simulated rig; nothing real moves" if simulated else "on this rig, once it has been checked"
        ways = (
            ("Try it", f"The dilution example {where}: five doses of ink, photographed and fitted. "
             "It is checked first, and the next press of Run (F5) carries it out.", self.try_asked),
            ("Connect my rig", CONNECT, self.rig_asked),
            ("Open a run", "Look at what was recorded: pictures, fits, a report.", self.run_asked),
            ("Build a sequence", "Step by step, from nothing.", self.build_asked),
        )  # fmt: skip
        self.buttons: dict[str, QPushButton] = {}
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 8, 0, 8)
        for title, words, asked in ways:
            card = QFrame()
            card.setObjectName("card")
            button, label = QPushButton(title), QLabel(words)
            button.clicked.connect(asked)
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.RichText)
            inside = QVBoxLayout(card)
            inside.addWidget(button, 0, Qt.AlignmentFlag.AlignLeft)
            inside.addWidget(label)
            column.addWidget(card)
            self.buttons[title] = button
        self.buttons["Try it"].setObjectName("primary")
        column.addStretch(1)
