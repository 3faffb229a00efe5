"""The tree keeps the shape that makes it readable."""

from pathlib import Path

TREE = Path(__file__).parents[1]


def test_a_file_holds_one_idea() -> None:
    """400 lines are what can still be read in one go."""
    sources = [file for package in ("tankrig", "drivers", "ui", "tests") for file in (TREE / package).rglob("*.py")]
    lengths = {str(file.relative_to(TREE)): len(file.read_text(encoding="utf-8").splitlines()) for file in sources}
    assert lengths
    assert {name: length for name, length in lengths.items() if length >= 400} == {}
