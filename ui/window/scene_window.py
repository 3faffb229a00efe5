"""A scene file opened in the window: its medium as numbers that can be changed, and the picture that they predict."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyqtgraph.parametertree import Parameter
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QDialog, QHBoxLayout, QLabel, QPushButton, QSplitter, QVBoxLayout, QWidget

from ui.window import jobs
from ui.window.on_screen import Worker
from ui.window.parameter_tree import parameter_tree
from ui.window.source_frame import SourceFrame
from ui.window.tank_plot import TankPlot
from ui.window.tone import Tone

if TYPE_CHECKING:
    from tankrig.prediction import Prediction
    from tankrig.scene import Scene

RANGES = {"sigma_a": (0.0, 10.0), "sigma_s": (0.0, 10.0), "g": (-0.99, 0.99)}
SYMBOLS = {"sigma_a": "σa", "sigma_s": "σs", "g": "g"}
TOLERANCE = 0.03
TOP = 60_000.0
_PYTHON = """from dataclasses import replace

import tankrig

scene = tankrig.load_scene({path!r})
scene = replace(scene, medium=replace(scene.medium, {values}))
prediction = tankrig.predict(scene, tolerance={tolerance:g})
"""


class SceneWindow(QDialog):
    """Predicts a scene, again whenever a coefficient is changed; does not block the main window.

    Parameters
    ----------
    parent
        The main window.
    file, scene
        What was opened.
    background
        Predicts.
    """

    told = Signal(str)

    def __init__(self, parent: QWidget, file: Path, scene: "Scene", background: Worker) -> None:
        super().__init__(parent)
        self.setWindowTitle(f"Prediction for {file.name}")
        self.setModal(False)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.file, self.scene, self._background = file, scene, background
        self.prediction: Prediction | None = None
        self._asked = self._closed = False
        self._wanted = scene
        self._lay_out()
        self._predict()

    def change(self, name: str, value: float) -> None:
        """Predict with another coefficient."""
        changed: dict[str, Any] = {name: value}
        self._wanted = replace(self._wanted, medium=replace(self._wanted.medium, **changed))
        self._says.setText("The picture is being predicted anew…")
        self._predict()

    def done(self, result: int) -> None:
        """Close; what is still to come is let go."""
        self._closed = True
        super().done(result)

    @property
    def python(self) -> str:
        """Lines that predict what is shown."""
        changed = ", ".join(
            f"{name}={getattr(self.scene.medium, name)!r}"
            for name in RANGES
            if name != "g" or self.scene.medium.phase is None
        )
        return _PYTHON.format(path=str(self.file), values=changed, tolerance=TOLERANCE)

    def _predict(self) -> None:
        """One at a time, and then the newest that is wanted."""
        if self._asked:
            return
        self._asked, scene = True, self._wanted

        def then(found: "Prediction") -> None:
            self._asked = False
            if not self._closed:
                self.scene, self.prediction = scene, found
                self._draw(found)
                if scene != self._wanted:
                    self._predict()

        def failed(sentence: str) -> None:
            self._asked = False
            if not self._closed:
                self._says.setText(sentence)
                if scene != self._wanted:
                    self._predict()

        self._background.run(
            jobs.predict_scene, scene, TOLERANCE, then=then, failed=failed, name=f"the prediction for {self.file.name}"
        )  # fmt: skip

    def _draw(self, found: "Prediction") -> None:
        peak = float(found.image.max()) or 1.0
        tone = Tone(0.0, TOP, gamma=0.5)
        counts = np.clip(found.image * (TOP / peak), 0.0, TOP).astype(np.uint16)
        self._plot.show_indices(tone.table()[counts], tone.palette())
        self._plot.place(self.scene.tank, self.scene.camera)
        missed = f" {found.missed}" if found.missed else ""
        self._says.setText(
            f"Brightest pixel {peak:.3g} W/mm²/sr; model: {found.model}; stated error {100.0 * found.error:.1f} % of "
            f"the image.{missed}"
        )

    def _lay_out(self) -> None:
        medium = self.scene.medium
        fixed = () if medium.phase is None else ("g",)
        rows = [
            {"name": SYMBOLS[name], "type": "float", "value": getattr(medium, name), "limits": limits, "decimals": 6,
             "suffix": "" if name == "g" else " /mm", "step": 0.1, "dec": True, "minStep": 1e-6,
             "readonly": name in fixed}
            for name, limits in RANGES.items()
        ]  # fmt: skip
        self.tree_root = Parameter.create(name="medium", type="group", children=rows)
        for name, symbol in SYMBOLS.items():
            self.tree_root.child(symbol).sigValueChanged.connect(
                lambda _, value, name=name: self.change(name, float(value))
            )
        tree = parameter_tree(self.tree_root)
        self._plot, self._says = TankPlot(), QLabel("The picture is being predicted…")
        self._says.setWordWrap(True)
        copy, close = QPushButton("Copy as Python"), QPushButton("Close")
        copy.clicked.connect(lambda: QGuiApplication.clipboard().setText(self.python))
        close.clicked.connect(self.close)
        split, inside, row = QSplitter(), QWidget(), QHBoxLayout()
        split.addWidget(tree)
        split.addWidget(self._plot.widget)
        split.setSizes([260, 560])
        row.addWidget(copy)
        row.addStretch(1)
        row.addWidget(close)
        column = QVBoxLayout(inside)
        column.addWidget(split, 1)
        column.addWidget(self._says)
        column.addLayout(row)
        frame = SourceFrame(inside, about="PREDICTION for")
        frame.name_rig(self.file.name)
        outside = QVBoxLayout(self)
        outside.setContentsMargins(0, 0, 0, 0)
        outside.addWidget(frame)
        self.resize(860, 560)
