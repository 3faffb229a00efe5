"""The ink: what the tank holds, what the budgets allow, one dose by hand, and the way out when nobody knows."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QTimer, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from tankrig.dosing.limits import too_much_already
from ui.window.fields import SURE_MS, CheckedField, NumberField, number, with_name
from ui.window.flow import Flow
from ui.window.fresh_water import BUTTON, said_here
from ui.window.pump_rate import PumpRate, pump_rate
from ui.window.status import RigState, RigStatus
from ui.window.words import capitalised, volume

if TYPE_CHECKING:
    from drivers.rig import RigFile

EMPTY = "What the tank holds, and what its budgets leave, will stand here once the rig is open."
DOSE = "dose until the tank holds this much in all"
PRIME = "fill the tube; the tank holds what it held, and the ledger says so"
SET_RATE = "open the rig again with this rate; runs that begin in this window have it, too"
"""What buttons do."""
FIXED = "the pump's own firmware, or its driver, sets how fast it delivers"
HANG_IT = "hang the tube in a waste vessel, and tick that it does"
MOST_UL = 1e6
"""Of any tank, while the rig is not known."""
UNKNOWN = (
    "<b>It is not known how much ink the tank holds.</b> A dose was begun and nobody saw it end, the doser moved "
    "without tankrig, or the run, the tank's ledger and the doser do not say the same. Nothing moves until a person "
    "decides. Safe ways out:<ol>"
    "<li><b>Read the syringe</b>, or weigh what is left of the ink, and enter below what the tank holds <b>in all</b> "
    "since it was filled.</li>"
    "<li><b>Empty the tank</b>, fill it with fresh water, and begin a new ledger with the button at the bottom.</li>"
    "<li><b>Change nothing</b>: close the window; what was recorded is safe, and the question "
    "will be asked again.</li></ol>"
)


class DoserPage(QWidget):
    """Shows and asks; the rig's owner acts."""

    dose_asked = Signal(float)
    """Total that the tank is to hold, µl."""
    aside_asked = Signal(float)
    """Volume to be delivered into a waste vessel, µl."""
    rate_asked = Signal(float)
    """Rate that the pump is to have while the window is open, µl/s."""
    resolve_asked = Signal(float)
    clear_asked = Signal()
    refill_asked = Signal()
    give_up_asked = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._rig: RigFile | None = None
        self._pump: PumpRate | None = None
        self._sure, self._status = False, RigStatus()
        self._held, self._concentration = QLabel("–"), QLabel(EMPTY)
        self._concentration.setWordWrap(True)
        self._held.setProperty("role", "big")
        self._concentration.setProperty("role", "faint")
        column = QVBoxLayout(self)
        column.setContentsMargins(14, 10, 14, 10)
        column.setSpacing(10)
        column.addWidget(self._held)
        column.addWidget(self._concentration)
        column.addLayout(self._budgets())
        column.addWidget(self._dose_card())
        column.addWidget(self._prime_card())
        column.addWidget(self._rate_card())
        column.addWidget(self._stopped_card())
        column.addWidget(self._unknown_card())
        column.addStretch(1)
        column.addLayout(self._refill_row())

    def set_rig(self, rig: "RigFile") -> None:
        """Whose budgets, tank and pump."""
        self._rig = rig
        self._pump = pump_rate(rig.doser)
        if self._pump is None:
            self._rate.set_text("")
            self._rate_says.setText(f"{capitalised(FIXED)}.")
        else:
            self._rate.set_text(f"{self._pump.ul_per_s:.6g}")
            self._rate_says.setText(f"{self._pump.span}; the rig file's own rate comes back with the next window.")
        self._able()

    def follow(self, status: RigStatus) -> None:
        """Show where the ink stands."""
        self._unknown.setVisible(status.undecided is not None)
        self._question.setText(status.undecided or "")
        self._give_up.setVisible(status.state is RigState.ASKING)
        idle = status.state is RigState.IDLE and not status.dosing
        self._stopped.setVisible(status.stopped and idle and status.undecided is None)
        self._status = status
        for field in (self._target, self._volume):
            field.look_again()  # what is allowed follows what the tank holds
        self._able()
        self._refill.setEnabled(status.state in (RigState.IDLE, RigState.FAILED) and not status.dosing)
        if self._rig is None or status.tank is None or status.remaining is None:
            if status.state is RigState.FAILED:
                self._know_nothing()
            return
        tank, limits = status.tank, self._rig.limits
        spread = tank.high_ul - tank.low_ul
        between = f", between {volume(tank.low_ul)} and {volume(tank.high_ul)}" if spread > 1e-6 else ""
        target = f" → {volume(status.target_ul)}" if status.target_ul is not None else ""
        self._held.setText(f"{volume(tank.volume_ul)} of ink in the tank{target}")
        litres = float(_product(self._rig.bench.tank.size_mm)) / 1e6
        self._concentration.setText(
            f"{tank.volume_ul / 1000.0 / litres:.4g} ml per litre, in {litres:.3g} l of water{between}"
        )
        for bar, left, most in (
            (self._tank_bar, status.remaining.tank_ul, limits.tank_ul),
            (self._run_bar, status.remaining.run_ul, limits.run_ul),
            (self._dose_bar, status.remaining.dose_ul, limits.dose_ul),
        ):
            used = most - left
            bar.setValue(round(1000.0 * min(1.0, max(0.0, used / most))))
            bar.setFormat(f"{volume(left)} left of {volume(most)}")
            high = used > 0.8 * most
            if bar.property("level") != ("high" if high else ""):
                bar.setProperty("level", "high" if high else "")
                bar.style().polish(bar)

    def _know_nothing(self) -> None:
        """The rig cannot be used: what it said before need not be true any more."""
        self._held.setText("What the tank holds is not known now")
        self._concentration.setText("The rig cannot be used; the line at the top says why.")
        for bar in (self._tank_bar, self._run_bar, self._dose_bar):
            bar.setValue(0)
            bar.setFormat("–")

    # -- what a person does --------------------------------------------------------------------------------------------

    def show_fresh_water(self) -> None:
        """The button for a tank that was filled anew has the keyboard, and is seen where the page scrolls."""
        self._refill.setFocus()

    def _ask_dose(self) -> None:
        value = self._target.value
        if value is None:
            self._target.say_wrong()
            return
        self.dose_asked.emit(float(value))

    def _ask_prime(self) -> None:
        value = self._volume.value
        if value is not None and self._hangs.isChecked():
            self._hangs.setChecked(False)  # asked for anew before each time
            self.aside_asked.emit(float(value))

    def _able(self) -> None:
        """What is free to be asked for, with what stands in the fields; what is not says why as its tooltip."""
        wait, fixed = self._status.no_dose, self._pump is None
        self._rate.setEnabled(not wait and not fixed)
        _allow(self._dose, DOSE, wait or (self._target.wrong if self._target.edit.text() else ""))
        _allow(self._set_rate, SET_RATE, wait or (FIXED if fixed else self._rate.wrong))
        _allow(self._prime, PRIME, wait or self._volume.wrong or ("" if self._hangs.isChecked() else HANG_IT))

    def _read_target(self, text: str) -> tuple[float | None, str]:
        """What the tank of this rig may hold."""
        most_ul = self._rig.limits.tank_ul if self._rig is not None else MOST_UL
        value = number(text)
        if value is not None and 0.0 <= value <= most_ul:
            refusal = self._refusal(value)
            return (None, refusal) if refusal else (value, "")
        given = f"the tank may not hold {text}" if text.strip() else "say how much the tank shall hold"
        return None, f"{given}; give 0 to {most_ul:g} µl in all"

    def _refusal(self, total_ul: float) -> str:
        """Why the doser would refuse to dose until the tank holds so much, now; empty where it would not."""
        rig, status = self._rig, self._status
        if rig is None or status.tank is None or status.no_dose:
            return ""
        more = too_much_already(total_ul, status.tank, status.increment_ul)
        return said_here(more or rig.limits.refusal(total_ul, status.tank, status.used_ul) or "")

    def _read_volume(self, text: str) -> tuple[float | None, str]:
        """What may go beside the tank at once."""
        value = number(text)
        if value is None:
            return None, f"{text or 'nothing'} is no volume; give a number of µl"
        refusal = self._rig.limits.refusal_aside(value) if self._rig is not None else None
        return (None, refusal) if refusal else (value, "")

    def _read_rate(self, text: str) -> tuple[float | None, str]:
        """A rate that the pump of this rig takes."""
        if self._pump is None:
            return None, ""
        value = number(text)
        if value is None or not self._pump.least_ul_per_s <= value <= self._pump.most_ul_per_s:
            return None, f"{text or 'nothing'} is no rate of this pump; give {self._pump.span}"
        return value, ""

    def _ask_rate(self) -> None:
        value = self._rate.value
        if value is not None and self._set_rate.isEnabled():
            self.rate_asked.emit(float(value))

    def _ask_resolve(self) -> None:
        value = self._truth.value
        if value is None:
            self._truth.say_wrong()
            return
        self.resolve_asked.emit(float(value))

    def _ask_refill(self) -> None:
        """Asked twice, for it forgets what the tank holds; a press long after is a first one."""
        if not self._sure:
            self._sure = True
            self._refill.setText("Press again: the tank is empty of ink and filled anew")
            QTimer.singleShot(SURE_MS, self, self._ask_again)
            return
        self._ask_again()
        self.refill_asked.emit()

    def _ask_again(self) -> None:
        self._sure = False
        self._refill.setText(BUTTON)

    # -- layout --------------------------------------------------------------------------------------------------------

    def _budgets(self) -> QGridLayout:
        grid = QGridLayout()
        self._tank_bar, self._run_bar, self._dose_bar = QProgressBar(), QProgressBar(), QProgressBar()
        for row, (words, bar, tip) in enumerate((
            ("tank", self._tank_bar, "budget of one filling of the tank"),
            ("run", self._run_bar, "budget of one run; doses by hand count as a run of their own"),
            ("one dose", self._dose_bar, "what one dose may have now"),
        )):  # fmt: skip
            bar.setRange(0, 1000)
            bar.setFormat("–")
            bar.setToolTip(tip)
            label = QLabel(words)
            label.setBuddy(bar)
            grid.addWidget(label, row, 0)
            grid.addWidget(bar, row, 1)
        grid.setColumnStretch(1, 1)
        return grid

    def _dose_card(self) -> QFrame:
        card, row = QFrame(), QHBoxLayout()
        card.setObjectName("card")
        self._target = CheckedField(
            self._read_target, "µl in all", "ink that the tank shall hold in all, never to be added"
        )
        self._target.edit.setObjectName("dose-target")
        self._target.edit.setMinimumWidth(64)
        self._target.edit.setMaximumWidth(110)
        self._target.edit.setPlaceholderText("total")
        self._dose = QPushButton("Dose")
        self._dose.clicked.connect(self._ask_dose)
        self._target.edit.returnPressed.connect(self._dose.click)
        name = QLabel("Dose until the tank holds")
        name.setBuddy(self._target)
        row.addWidget(name)
        row.addWidget(self._target, 1)
        row.addWidget(self._dose)
        card.setLayout(row)
        return card

    def _prime_card(self) -> QFrame:
        card, row = QFrame(), Flow()
        card.setObjectName("card")
        self._volume = CheckedField(self._read_volume, "µl", "ink for the waste vessel, no more than one dose may have")
        self._volume.edit.setObjectName("prime-volume")
        self._volume.edit.setMinimumWidth(64)
        self._volume.edit.setMaximumWidth(110)
        self._volume.set_text("50")
        self._hangs, self._prime = QCheckBox("the tube hangs in a waste vessel"), QPushButton("Prime")
        self._hangs.setToolTip("what is delivered then is not counted as in the tank")
        self._volume.changed.connect(self._able)
        self._target.changed.connect(self._able)
        self._hangs.toggled.connect(lambda _: self._able())
        self._prime.clicked.connect(self._ask_prime)
        for widget in (with_name("Prime the tube with", self._volume), self._hangs, self._prime):
            row.addWidget(widget)
        column = QVBoxLayout(card)
        column.addLayout(row)
        return card

    def _rate_card(self) -> QFrame:
        card, row = QFrame(), Flow()
        card.setObjectName("card")
        self._rate = CheckedField(self._read_rate, "µl/s", "how fast the pump delivers")
        self._rate.edit.setObjectName("pump-rate")
        self._rate.edit.setMaximumWidth(110)
        self._set_rate, self._rate_says = QPushButton("Set the rate"), QLabel()
        self._rate_says.setProperty("role", "faint")
        self._rate_says.setWordWrap(True)
        self._rate.changed.connect(self._able)
        self._rate.edit.returnPressed.connect(self._ask_rate)
        self._set_rate.clicked.connect(self._ask_rate)
        for widget in (with_name("The pump delivers", self._rate), self._set_rate):
            row.addWidget(widget)
        column = QVBoxLayout(card)
        column.addLayout(row)
        column.addWidget(self._rate_says)
        return card

    def _stopped_card(self) -> QFrame:
        self._stopped, row = QFrame(), QHBoxLayout()
        self._stopped.setObjectName("card")
        words = QLabel("<b>The doser is stopped.</b> Nothing moves until the stop is cleared, or a run is started.")
        words.setWordWrap(True)
        clear = QPushButton("Clear the stop")
        clear.setToolTip("let the doser move again; it does not move by itself")
        clear.clicked.connect(self.clear_asked)
        row.addWidget(words, 1)
        row.addWidget(clear)
        self._stopped.setLayout(row)
        self._stopped.hide()
        return self._stopped

    def _unknown_card(self) -> QFrame:
        self._unknown, column, row = QFrame(), QVBoxLayout(), QHBoxLayout()
        self._unknown.setObjectName("card")
        words, self._question = QLabel(UNKNOWN), QLabel()
        self._question.setProperty("role", "wrong")
        for label in (words, self._question):
            label.setWordWrap(True)
        self._truth = NumberField(
            "µl in all", 0.0, MOST_UL, "ink that the tank holds in all, as a person has found out"
        )
        self._truth.edit.setObjectName("truth")
        decide = QPushButton("That is what it holds")
        decide.clicked.connect(self._ask_resolve)
        self._give_up = QPushButton("Not now")
        self._give_up.setToolTip("leave the run as it is; it can be resumed later")
        self._give_up.clicked.connect(self.give_up_asked)
        name = QLabel("The tank holds")
        name.setBuddy(self._truth)
        row.addWidget(name)
        row.addWidget(self._truth, 1)
        row.addWidget(decide)
        row.addWidget(self._give_up)
        column.addWidget(words)
        column.addWidget(self._question)
        column.addLayout(row)
        self._unknown.setLayout(column)
        self._unknown.hide()
        return self._unknown

    def _refill_row(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self._refill = QPushButton(BUTTON)
        self._refill.setToolTip("the tank was emptied and filled anew: set its ledger aside and begin another")
        self._refill.clicked.connect(self._ask_refill)
        row.addStretch(1)
        row.addWidget(self._refill)
        return row


def _allow(button: QPushButton, does: str, refusal: str) -> None:
    """Have a button pressed only while nothing refuses it; its tooltip says what it does, or why not now."""
    button.setEnabled(not refusal)
    button.setToolTip(refusal or does)


def _product(sides: tuple[float, float, float]) -> float:
    return sides[0] * sides[1] * sides[2]
