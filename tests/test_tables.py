"""Tables on a terminal: every number is whole on one line, however narrow it is."""

import pytest

from ui.cli.tables import tell_table

HEADINGS = ("model", "RMSE", "σs, 1/m", "g", "ΔAIC", "what it says")
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
