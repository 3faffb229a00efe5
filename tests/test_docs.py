"""What the documentation shows works as it stands there."""

import re
from pathlib import Path

import pytest

import tankrig

TREE = Path(__file__).parents[1]
PAGES = [*TREE.glob("*.md"), *TREE.glob("docs/**/*.md"), *TREE.glob("firmware_notes/**/*.md")]


def blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a page in one language."""
    return re.findall(rf"```{language}\n(.*?)```", (TREE / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", ["README.md", "docs/scene.md"])
def test_scene_files_shown_can_be_loaded(page: str, tmp_path: Path) -> None:
    (text,) = blocks(page, "toml")
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    assert tankrig.load_scene(tmp_path / "scene.toml").camera.shape == (80, 120)


def test_the_readmes_python_runs_and_finds_the_medium(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(TREE)
    (code,) = blocks("README.md", "python")
    names: dict[str, object] = {}
    exec(compile(code, "README.md", "exec"), names)
    estimate = names["estimate"]
    assert isinstance(estimate, tankrig.Estimate)
    assert estimate.medium.sigma_s == pytest.approx(0.004, rel=0.03)


def test_links_lead_somewhere() -> None:
    links = [
        (page, target)
        for page in PAGES
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text(encoding="utf-8"))
    ]
    assert links
    assert [f"{page}: {target}" for page, target in links if not (page.parent / target).exists()] == []
