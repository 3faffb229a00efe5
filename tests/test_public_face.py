"""What a notebook needs is importable from `tankrig`, shows itself, and stays for a release when it goes."""

import ast
import importlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import tankrig

TREE = Path(__file__).parents[1]
EXAMPLES = TREE / "docs" / "examples"
STORED = TREE / "tests" / "data" / "stored"
FACES = ["advice", "archive", "calibration", "dosing", "estimation", "exchange", "geometry", "image", "live"]
FACES += ["materials", "pattern", "report", "run", "separation", "scene", "sequence"]
NEEDED = """
    Tank Medium Beam Projector Camera Scene load_scene lit_by
    Sequence load_sequence dry_run new_run resumed_run open_run recover refit write_report Run
    predict prepare estimate estimate_series compare_models edges_of_light blurred_pixels merged_of_run read_image
    Prediction Prepared Estimate SeriesEstimate
"""


def test_what_a_notebook_needs_is_there() -> None:
    assert not set(NEEDED.split()) - set(tankrig.__all__)
    for name in tankrig.__all__:
        assert not isinstance(getattr(tankrig, name), ModuleType), name


def test_subpackages_show_their_face() -> None:
    """In a fresh Python, since a module that was imported first could take a name's place."""
    code = f"""
import importlib
for name in {[*(f"tankrig.{name}" for name in FACES), "drivers"]}:
    face = importlib.import_module(name)
    assert face.__all__, name
    for one in face.__all__:
        assert type(getattr(face, one)).__name__ != "module", (name, one)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert ended.returncode == 0, ended.stderr


def test_a_name_that_goes_warns_and_works_for_a_release(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(tankrig.GOING, "simulate_image", "predict")
    with pytest.warns(DeprecationWarning, match=r"simulate_image goes with the next release; use tankrig.predict"):
        assert tankrig.simulate_image is tankrig.predict  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = tankrig.no_such_name  # type: ignore[attr-defined]


def test_the_device_that_had_a_scene_cameras_name_is_found_by_it_for_one_release_more() -> None:
    """Drivers of other labs name it in their annotations, and must not fail to import."""
    with pytest.warns(DeprecationWarning, match=r"tankrig.devices.Camera goes with the next release; use .*Device"):
        from tankrig.devices import Camera
    assert Camera is tankrig.devices.CameraDevice


@pytest.mark.parametrize("page", [*sorted(TREE.glob("docs/*.md")), TREE / "README.md"], ids=lambda page: page.name)
def test_docs_send_nobody_into_a_submodule(page: Path) -> None:
    """Every name that a page gives is a public name of tankrig, of one of its packages, or of the drivers."""
    text = page.read_text(encoding="utf-8")
    wrong = []
    for found in re.findall(r"(?<![\w./])(?<!python -m )((?:tankrig|drivers)(?:\.[A-Za-z_]\w*)+)", text):
        parts = found.split(".")
        if found in ("tankrig.drivers", "tankrig.health") or parts[1] in ("devices", "errors"):
            continue  # groups of entry points, and modules that are faces themselves
        holder: Any = importlib.import_module(parts[0])
        depth = 1
        if parts[0] == "tankrig" and parts[1] in [*FACES, "testing"]:
            holder, depth = importlib.import_module(".".join(parts[:2])), 2
        if len(parts) > depth and parts[depth] not in holder.__all__:
            wrong.append(found)
    assert wrong == []


def shown(value: Any) -> str:
    """What a notebook would show of a value."""
    html = value._repr_html_()
    assert isinstance(html, str)
    return html


def test_the_notebook_runs_and_its_results_show_themselves() -> None:
    """With ten times the noise of the page, to which a fit follows a hundredth of the light paths."""
    cells = json.loads((EXAMPLES / "first_look.ipynb").read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    pages = []
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        *statements, last = ast.parse("".join(cell["source"]).replace("0.002 *", "0.02 *")).body
        exec(compile(ast.Module(statements, []), "first_look.ipynb", "exec"), names)
        assert isinstance(last, ast.Expr)
        value = eval(compile(ast.Expression(last.value), "first_look.ipynb", "eval"), names)
        if hasattr(value, "_repr_html_"):
            pages.append(shown(value))
    assert len(pages) == 3
    assert "240 × 160 × 120 mm" in pages[0]
    assert "prediction of model tank" in pages[1]
    assert "sigma_s" in pages[2]
    for page in pages:
        assert 'src="data:image/png;base64,' in page
    low, high = names["estimate"].interval(0.999)["sigma_s"]
    assert low <= 0.0195 <= high


def test_a_run_shows_itself() -> None:
    run = tankrig.open_run(STORED / "2" / "finished" / "run")
    page = shown(run)
    assert "completed" in page
    assert "fitted at 0.9 ml" in page
    titles = [axes.get_title(loc="left") for axes in run.plot().axes]
    assert [title for title in titles if title] == [
        "rays, 0 µl",
        "dark, 200 µl",
        "rays, 200 µl",
        "dark, 900 µl",
        "rays, 900 µl",
    ]


def test_an_experiment_is_a_script_of_fifteen_lines(tmp_path: Path) -> None:
    text = (EXAMPLES / "experiment.py").read_text(encoding="utf-8")
    assert len([line for line in text.splitlines() if line.strip()]) <= 15
    (tmp_path / "runs" / "first.rig").mkdir(parents=True)
    shutil.copy(STORED / "2" / "finished" / "rig.toml", tmp_path / "runs" / "first.rig" / "rig.toml")
    sequence = (STORED / "2" / "finished" / "sequence.toml").read_text(encoding="utf-8")
    (tmp_path / "dilution.toml").write_text(sequence.replace("seconds = 3.0", "seconds = 0.1"))
    words = [sys.executable, str(EXAMPLES / "experiment.py")]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=280)
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert ended.stdout.count("DoseFit(dose_ml=") == 2, ended.stdout
    assert (tmp_path / "runs" / "first" / "report.html").stat().st_size > 10_000
