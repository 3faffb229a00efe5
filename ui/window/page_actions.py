"""What can be pressed on a page, as actions that are found by their names: buttons, boxes and tabs."""

from collections.abc import Callable, Iterator
from functools import partial

from PySide6.QtWidgets import QAbstractButton, QDialog, QTabBar, QTabWidget, QWidget

from ui.window.palette import Action

NOT_NOW = "; not possible now"


def actions_of(title: str, page: QWidget, show: Callable[[], object]) -> Iterator[Action]:
    """Everything that can be pressed on a page.

    Parameters
    ----------
    title
        Of the page, for people.
    page
        Whose buttons, boxes and tabs.
    show
        Brings the page to the front, where what an action does can be seen.
    """
    for tabs in page.findChildren(QTabWidget):
        for number in range(tabs.count()):
            yield Action(f"{title}: tab {tabs.tabText(number)}", "", partial(_turn_to, tabs, number, show))
    for button in page.findChildren(QAbstractButton):
        words = button.text().partition("  ")[0].strip().rstrip("…")
        if words and not isinstance(button.parent(), QTabBar) and not isinstance(button.window(), QDialog):
            tip = button.toolTip().partition("\n")[0]
            why = "" if button.isEnabled() else NOT_NOW
            yield Action(
                f"{title}: {words}" + (f" ({tip}{why})" if tip or why else ""), "", partial(_press, button, show)
            )


def _turn_to(tabs: QTabWidget, number: int, show: Callable[[], object]) -> None:
    show()
    tabs.setCurrentIndex(number)
    tabs.setFocus()


def _press(button: QAbstractButton, show: Callable[[], object]) -> None:
    show()
    chain: list[QWidget] = [button]
    while (above := chain[-1].parentWidget()) is not None:
        chain.append(above)
    for inside, _, tabs in zip(chain, chain[1:], chain[2:], strict=False):
        if isinstance(tabs, QTabWidget):  # it may lie on a tab that is not in front
            tabs.setCurrentWidget(inside)
    button.setFocus()
    if button.isEnabled():
        button.click()
