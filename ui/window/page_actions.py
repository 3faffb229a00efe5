"""What can be pressed or chosen on a page, as actions found by their names: buttons, boxes, lists and tabs."""

from collections.abc import Callable, Iterator
from functools import partial

from PySide6.QtWidgets import QAbstractButton, QComboBox, QDialog, QLabel, QTabBar, QTabWidget, QWidget

from ui.window.palette import Action

NOT_NOW = "; not possible now"


def actions_of(title: str, page: QWidget, show: Callable[[], object]) -> Iterator[Action]:
    """Everything that can be pressed, or chosen from a list that opens, on a page.

    Parameters
    ----------
    title
        Of the page, for people.
    page
        Whose buttons, boxes, lists and tabs.
    show
        Brings the page to the front, where what an action does can be seen.
    """
    for tabs in page.findChildren(QTabWidget):
        for number in range(tabs.count()):
            yield Action(f"{title}: tab {tabs.tabText(number)}", "", partial(_turn_to, tabs, number, show))
    for button in page.findChildren(QAbstractButton):
        text, _, keys = button.text().partition("  ")  # as in "Run  F5"
        words = text.strip().rstrip("…")
        if words and not isinstance(button.parent(), QTabBar) and not isinstance(button.window(), QDialog):
            tip = button.toolTip().partition("\n")[0]
            why = "" if button.isEnabled() else NOT_NOW
            yield Action(
                f"{title}: {words}" + (f" ({tip}{why})" if tip or why else ""), keys.strip(),
                partial(_press, button, show),
            )  # fmt: skip
    labels = {label.buddy(): label.text() for label in page.findChildren(QLabel) if label.buddy() is not None}
    for combo in page.findChildren(QComboBox):
        name = combo.accessibleName() or labels.get(combo, "") or combo.toolTip().partition("\n")[0]
        if name:
            now = NOT_NOW if not combo.isEnabled() else f"; now {combo.currentText()}" if combo.currentText() else ""
            yield Action(f"{title}: choose {name.rstrip(':')}{now}", "", partial(_unfold, combo, show))


def _turn_to(tabs: QTabWidget, number: int, show: Callable[[], object]) -> None:
    show()
    tabs.setCurrentIndex(number)
    tabs.setFocus()


def _press(button: QAbstractButton, show: Callable[[], object]) -> None:
    _bring_to_front(button, show)
    if button.isEnabled():
        button.click()


def _unfold(combo: QComboBox, show: Callable[[], object]) -> None:
    _bring_to_front(combo, show)
    if combo.isEnabled():
        combo.showPopup()


def _bring_to_front(widget: QWidget, show: Callable[[], object]) -> None:
    show()
    chain: list[QWidget] = [widget]
    while (above := chain[-1].parentWidget()) is not None:
        chain.append(above)
    for inside, _, tabs in zip(chain, chain[1:], chain[2:], strict=False):
        if isinstance(tabs, QTabWidget):  # it may lie on a tab that is not in front
            tabs.setCurrentWidget(inside)
    widget.setFocus()
