"""Dark and light: one small set of colours each, from which palette and style sheet are made."""

from dataclasses import dataclass
from pathlib import Path

import pyqtgraph as pg
from PySide6.QtGui import QColor, QGuiApplication, QPalette
from PySide6.QtWidgets import QApplication, QWidget


@dataclass(frozen=True)
class Theme:
    """The colours of a theme, as #rrggbb."""

    name: str
    window: str
    base: str
    raised: str
    text: str
    faint: str
    line: str
    accent: str
    on_accent: str
    good: str
    warning: str
    bar: str
    bad: str
    live: str
    replay: str
    refit: str
    """Frames of what belongs to a source."""
    on_source: str
    focus: str
    stop_edge: str
    outline: str
    """Of what can be pressed or filled in."""


DARK = Theme(
    "dark", window="#1d2126", base="#15181c", raised="#2b3138", text="#e8eaed", faint="#a4adb8", line="#434b55",
    accent="#4c9fe8", on_accent="#081320", good="#58c08a", warning="#eab44a", bar="#2a659c", bad="#ff7b6e",
    live="#3f9e6e", replay="#c9822b", refit="#a77be0",
    on_source="#081320", focus="#ffd166", stop_edge="#ff8a80",
    outline="#75808c",
)  # fmt: skip
LIGHT = Theme(
    "light", window="#f1f3f5", base="#ffffff", raised="#e2e6ea", text="#1a1d21", faint="#566170", line="#b9c1ca",
    accent="#0b62b4", on_accent="#ffffff", good="#16703f", warning="#8f5a00", bar="#a9cdf0", bad="#b3261e",
    live="#16703f", replay="#9a5200", refit="#6a3fb0", on_source="#ffffff", focus="#8a3ffc", stop_edge="#7d0f0c",
    outline="#6f7a86",
)  # fmt: skip
THEMES = {theme.name: theme for theme in (DARK, LIGHT)}
CURVES = ("#4c9fe8", "#e8833a", "#58c08a", "#c77dd6")
"""Of lines and points, told apart on both grounds."""


def current() -> Theme:
    """The theme that is applied."""
    return THEMES.get(str(QApplication.instance().property("theme")), DARK)  # type: ignore[union-attr]


def apply(name: str) -> Theme:
    """Give the whole application a theme; plots made from now on have it, too."""
    theme = THEMES.get(name, DARK)
    app = QApplication.instance()
    assert isinstance(app, QApplication)
    if app.property("theme") == theme.name:
        return theme
    if app.property("theme") is None:
        app.setStyle("Fusion")  # once: another style under widgets with a style sheet brings Qt down
    app.setProperty("theme", theme.name)
    app.setPalette(_palette(theme))
    app.setStyleSheet(_sheet(theme))
    pg.setConfigOptions(background=theme.base, foreground=theme.text, antialias=True, imageAxisOrder="row-major")
    return theme


def set_role(widget: QWidget, role: str, name: str = "role") -> None:
    """Give a widget a role that the style sheet knows; styled anew only when that has changed."""
    if widget.property(name) != role:
        widget.setProperty(name, role)
        widget.style().unpolish(widget)
        widget.style().polish(widget)


def of_system() -> str:
    """The name of the theme that the desktop asks for."""
    from PySide6.QtCore import Qt

    light = QGuiApplication.styleHints().colorScheme() is Qt.ColorScheme.Light
    return LIGHT.name if light else DARK.name


def _palette(theme: Theme) -> QPalette:
    palette, role = QPalette(), QPalette.ColorRole
    colours = {
        role.Window: theme.window, role.WindowText: theme.text, role.Base: theme.base, role.AlternateBase: theme.window,
        role.Text: theme.text, role.Button: theme.raised, role.ButtonText: theme.text, role.BrightText: theme.bad,
        role.ToolTipBase: theme.raised, role.ToolTipText: theme.text, role.Highlight: theme.accent,
        role.HighlightedText: theme.on_accent, role.Link: theme.accent, role.PlaceholderText: theme.faint,
        role.Light: theme.raised, role.Midlight: theme.raised, role.Mid: theme.line, role.Dark: theme.line,
        role.Shadow: theme.base,
    }  # fmt: skip
    for which, colour in colours.items():
        palette.setColor(which, QColor(colour))
    for which in (role.Text, role.ButtonText, role.WindowText):
        palette.setColor(QPalette.ColorGroup.Disabled, which, QColor(theme.faint))
    return palette


def _sheet(theme: Theme) -> str:
    return f"""
    * {{ font-size: 10.5pt; }}
    QToolTip {{ color: {theme.text}; background: {theme.raised}; border: 1px solid {theme.line}; padding: 4px; }}
    QPushButton, QToolButton {{
        min-height: 30px; padding: 2px 12px; border: 1px solid {theme.outline}; border-radius: 6px;
        background: {theme.raised}; }}
    QPushButton:hover, QToolButton:hover {{ border-color: {theme.accent}; }}
    QPushButton:focus, QToolButton:focus {{ border: 2px solid {theme.accent}; }}
    QPushButton:pressed, QPushButton:checked, QToolButton:checked {{
        background: {theme.accent}; color: {theme.on_accent}; }}
    QPushButton:disabled, QToolButton:disabled {{ color: {theme.faint}; background: {theme.window}; }}
    QPushButton#primary {{ background: {theme.accent}; color: {theme.on_accent}; font-weight: 600; }}
    QPushButton#primary:disabled {{ background: {theme.raised}; color: {theme.faint}; }}
    QPushButton#stop {{
        background: #c8201c; color: white; font-size: 15pt; font-weight: 800; border: 2px solid {theme.stop_edge};
        border-radius: 8px; min-height: 42px; min-width: 150px; }}
    QPushButton#stop:hover {{ background: #e02a25; }}
    QPushButton#stop:pressed {{ background: #8f1411; }}
    QLineEdit, QComboBox, QSpinBox, QDoubleSpinBox, QPlainTextEdit, QTreeView, QTableView, QListView {{
        background: {theme.base}; border: 1px solid {theme.outline}; border-radius: 4px; }}
    QLineEdit, QComboBox, QSpinBox, QDoubleSpinBox {{ min-height: 28px; padding: 0 6px; }}
    QComboBox {{ combobox-popup: 0; }}
    QLineEdit:focus, QComboBox:focus, QPlainTextEdit:focus, QTreeView:focus, QTableView:focus {{
        border: 1px solid {theme.accent}; }}
    QLineEdit[wrong="true"], QPlainTextEdit[wrong="true"] {{ border: 2px solid {theme.bad}; }}
    QComboBox QAbstractItemView {{ background: {theme.base}; color: {theme.text};
        selection-background-color: {theme.accent}; selection-color: {theme.on_accent}; outline: none; }}
    QComboBox QAbstractItemView::item {{ min-height: 26px; padding: 2px 6px; }}
    QComboBox QAbstractItemView::item:selected {{ background: {theme.accent}; color: {theme.on_accent}; }}
    QListView::item:selected, QTreeView::item:selected, QTableView::item:selected {{
        background: {theme.accent}; color: {theme.on_accent}; }}
    QTabBar::tab {{ min-height: 30px; padding: 2px 4px; background: {theme.window}; color: {theme.faint};
        border: none; border-bottom: 3px solid transparent; }}
    QTabBar::tab:selected {{ color: {theme.text}; border-bottom: 3px solid {theme.accent}; }}
    QMainWindow > QTabBar {{ font-size: 9.5pt; }}
    QTabWidget::pane {{ border: none; border-top: 1px solid {theme.line}; }}
    QDockWidget {{ font-weight: 600; color: {theme.text}; }}
    QDockWidget::title {{ background: {theme.window}; padding: 4px 8px; border-bottom: 1px solid {theme.line}; }}
    QHeaderView::section {{ background: {theme.window}; color: {theme.faint}; border: none;
        border-bottom: 1px solid {theme.line}; padding: 4px 6px; }}
    QProgressBar {{ border: 1px solid {theme.line}; border-radius: 5px; background: {theme.base}; text-align: center;
        min-height: 14px; color: {theme.text}; }}
    QProgressBar::chunk {{ background: {theme.bar}; border-radius: 4px; }}
    QProgressBar[level="high"]::chunk {{ background: {theme.warning}; }}
    QToolBar {{ border: none; border-bottom: 1px solid {theme.line}; spacing: 6px; padding: 0px 4px; }}
    QStatusBar {{ border-top: 1px solid {theme.line}; }}
    QStatusBar QLabel {{ padding: 2px 6px; }}
    QMenu {{ background: {theme.base}; border: 1px solid {theme.line}; padding: 4px; }}
    QMenu::item {{ padding: 6px 24px; }}
    QMenu::item:selected {{ background: {theme.accent}; color: {theme.on_accent}; }}
    QMainWindow::separator {{ background: {theme.line}; width: 4px; height: 4px; }}
    QSplitter::handle {{ background: {theme.line}; }}
    QCheckBox, QRadioButton {{ min-height: 28px; spacing: 8px; }}
    QTreeView::item, QListView::item {{ min-height: 26px; }}
    QCheckBox::indicator, QListView::indicator {{
        width: 16px; height: 16px; border: 2px solid {theme.faint}; border-radius: 4px;
        background: {theme.base}; }}
    QCheckBox::indicator:checked, QListView::indicator:checked {{
        background: {theme.accent}; border-color: {theme.accent};
        image: url("{_icon("tick-" + theme.name)}"); }}
    QCheckBox::indicator:disabled {{ border-color: {theme.line}; }}
    QLabel[role="faint"] {{ color: {theme.faint}; }}
    QLabel[role="big"] {{ font-size: 17pt; font-weight: 600; }}
    QLabel[role="heading"] {{ font-size: 12pt; font-weight: 600; }}
    QLabel[role="wrong"] {{ color: {theme.bad}; }}
    QLabel[role="good"] {{ color: {theme.good}; }}
    QLabel#badge {{ background: {theme.warning}; color: {theme.base}; border-radius: 6px; padding: 4px 10px;
        font-weight: 700; }}
    QLabel#badge[real="true"] {{ background: {theme.raised}; color: {theme.text}; }}
    QLabel#over {{ background: {theme.base}; color: {theme.text}; border: 2px solid {theme.warning}; border-radius: 6px;
        padding: 6px 12px; font-weight: 600; }}
    QFrame#banner {{ background: {theme.raised}; border: 2px solid {theme.warning}; border-radius: 6px; }}
    QFrame#banner[level="bad"] {{ border-color: {theme.bad}; }}
    QFrame#banner[level="good"] {{ border-color: {theme.good}; }}
    QFrame#banner[level="none"] {{ border-color: transparent; background: transparent; }}
    QFrame#source {{ border: 2px solid {theme.line}; border-radius: 4px; }}
    QLabel#sourceTitle {{ padding: 1px 8px; font-weight: 600; background: {theme.raised}; color: {theme.text}; }}
    {_sources(theme)}
    QFrame#card {{ background: {theme.base}; border: 1px solid {theme.line}; border-radius: 8px; }}
    """


def _icon(name: str) -> str:
    return (Path(__file__).parent / "icons" / f"{name}.svg").as_posix()


def _sources(theme: Theme) -> str:
    """Frame and title of each kind of source."""
    return "".join(
        f"""
    QFrame#source[source="{kind}"] {{ border-color: {colour}; }}
    QLabel#sourceTitle[source="{kind}"] {{ background: {colour}; color: {theme.on_source}; }}"""
        for kind, colour in (("live", theme.live), ("replay", theme.replay), ("refit", theme.refit))
    )


def paint_plots(widget: QWidget) -> None:
    """Give plots that are there already the colours of the theme."""
    theme = current()
    for plot in widget.findChildren(pg.PlotWidget):
        plot.setBackground(theme.base)
        item = plot.getPlotItem()
        for name in ("left", "bottom", "right", "top"):
            axis = item.getAxis(name)
            axis.setPen(theme.line)
            axis.setTextPen(theme.text)
        item.titleLabel.setText(item.titleLabel.text, color=theme.text)
