"""What commands show: numbers whole on one line however narrow the terminal, and what is being done, without one."""

import time

import pytest

from ui.cli import stages
from ui.cli.tables import tell_table

HEADINGS = ("model", "RMSE", "σs, 1/mm", "g", "ΔAIC", "what it says")
ROWS = [
    ("all orders, tank", "0.0012", "19.8001±0.0021", "0.70000±0.00011", "0", "agrees"),
    ("single scattering", "12.25", "(9.0000001±4.00012)", "0.1±1.0", "123456", "too uncertain to tell"),
]


@pytest.mark.parametrize("columns", [30, 45, 80, 140])
@pytest.mark.parametrize("sentences", [True, False])
def test_no_number_is_cut_or_torn_apart(
    columns: int, sentences: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A cell that ends in … is lost to whoever reads it, and a ± alone on a line is read as another number's."""
    monkeypatch.setenv("COLUMNS", str(columns))
    tell_table(HEADINGS, ROWS, sentences=sentences)
    told = capsys.readouterr().out
    assert "…" not in told
    lines = told.splitlines()
    for row in ROWS:
        for cell in row[: 5 if sentences else 6]:
            assert any(cell in line and row[0] in line for line in lines), cell
    assert max(map(len, lines)) <= max(columns, 17 + 2 + 21)


def test_without_a_terminal_what_is_done_is_a_line_each(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log without a line for minutes looks like a program that hangs; a quick command needs none."""
    monkeypatch.setattr(stages, "POLL_S", 0.005)
    with stages.stages_shown("reading"):
        pass
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(stages, "FIRST_S", 0.0)
    monkeypatch.setattr(stages, "AGAIN_S", 0.05)
    with stages.stages_shown("reading") as told:
        time.sleep(0.03)
        for left in range(20):
            told("fitting [all]", f"{left} left")
            time.sleep(0.01)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "0 s: reading"
    assert lines[1].startswith("0 s: fitting [all]; ")
    assert 3 <= len(lines) < 10  # once more while it lasts, and not with each change of what is left
