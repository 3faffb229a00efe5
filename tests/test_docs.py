"""What the pages say is there: links, files, commands and keys; and what they show can be read as what it is."""

import ast
import importlib
import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import click
import pytest
import tomlkit
import yaml

import tankrig
from drivers.registry import driver_names
from drivers.rig import SIMULATED, RigFile, load_rig_file
from ui.cli import COMMANDS
from ui.cli import tankrig as command_line

TREE = Path(__file__).parents[1]
PAGES = sorted([*TREE.glob("*.md"), *TREE.glob("docs/**/*.md"), *TREE.glob("firmware_notes/*.md")])
RECORDS = sorted(TREE.glob("docs/decisions/0*.md"))
OTHER_PROGRAMS = ("./start", "source", "pip", "pytest", "python", "python3", "mkdir", "cp", "dask")
"""Whose lines in a block for the shell are not looked at."""
SETTINGS = {
    "rig-doser": "drivers.rig_doser.settings:RigDoserSettings",
    "new-era": "drivers.new_era.settings:NewEraSettings",
    "cavro": "drivers.cavro.settings:CavroSettings",
    "hdmi-projector": "drivers.hdmi.settings:HdmiProjectorSettings",
    "lightcrafter-4500": "drivers.lightcrafter4500.settings:LightcrafterSettings",
    "v4l2-camera": "drivers.v4l2.settings:V4l2CameraSettings",
}


class Block(NamedTuple):
    """A fenced block of a page."""

    page: str
    line: int
    language: str
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks_of(page: Path) -> Iterator[Block]:
    """Fenced blocks of a page, those within lists included."""
    text = page.read_text(encoding="utf-8")
    for found in re.finditer(r"^( *)```([^\n]*)\n(.*?)^\1```", text, re.DOTALL | re.MULTILINE):
        indent, language, body = found.groups()
        line = text.count("\n", 0, found.start()) + 1
        yield Block(str(page.relative_to(TREE)), line, language.strip(), re.sub(f"(?m)^{indent}", "", body))


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


def of_language(*languages: str) -> list[Block]:
    """Blocks of one of the languages."""
    return [block for block in BLOCKS if block.language in languages]


def prose_of(page: Path) -> str:
    """A page without its fenced blocks."""
    return re.sub(r"^( *)```.*?^\1```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def inline_code(page: Path) -> list[str]:
    """What stands between backquotes in a page's prose, a line's end being a space."""
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", prose_of(page))]


def test_every_block_says_what_it_is() -> None:
    known = {"sh", "python", "toml", "yaml", "text", "markdown", "{eval-rst}", "{toctree}", "{include} README.md"}
    assert [str(block) for block in BLOCKS if block.language not in known] == []


def slug(heading: str) -> str:
    """The anchor that GitHub and the site give a heading."""
    return re.sub(r"[^\w\- ]", "", re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading).strip().lower()).replace(
        " ", "-"
    )


def test_links_lead_somewhere() -> None:
    links = [
        (page, target, anchor)
        for page in PAGES
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)", prose_of(page))
    ]
    assert len(links) > 200
    wrong = []
    for page, target, anchor in links:
        file = (page.parent / target).resolve() if target else page
        if not file.exists():
            wrong.append(f"{page}: {target}")
        elif anchor and anchor not in anchors(file):
            wrong.append(f"{page}: {target}#{anchor}")
    assert wrong == []


def anchors(page: Path) -> set[str]:
    """Of a page's headings, and those that it sets itself."""
    text = prose_of(page)
    return {slug(line) for line in re.findall(r"^#+ (.*)$", text, re.MULTILINE)} | set(
        re.findall(r'<a id="([^"]+)"', text)
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(TREE)))
def test_files_that_a_page_names_are_there(page: Path) -> None:
    if page.name == "CHANGELOG.md":
        return  # tells of files that are gone
    named = [word for code in inline_code(page) for word in code.split()]
    files = [
        word
        for word in named
        if re.fullmatch(r"(?:tankrig|drivers|ui|tests|docs|firmware_notes|\.ci)/[\w./-]+\w", word)
    ]
    assert [word for word in files if "NAME" not in word and not (TREE / word).exists()] == []


# -- commands --------------------------------------------------------------------------------------------------------


def refused(words: list[str]) -> str | None:
    """Why the command line does not know a command or one of its options; None where it does. Runs nothing."""
    command: click.Command = command_line
    context = click.Context(command, info_name="tankrig")
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        below = command.get_command(context, words[0])
        if below is None:
            return f"there is no {words[0]}"
        command, words = below, words[1:]
        context = click.Context(command, parent=context)
    try:
        command.make_parser(context).parse_args(list(words))
    except click.UsageError as error:
        return error.format_message()
    return None


def test_the_check_of_commands_can_fail() -> None:
    assert refused(["predict", "scene.toml", "--tolerance", "0.1"]) is None
    assert refused(["predict", "scene.toml", "--tolerant", "0.1"])
    assert refused(["foretell", "scene.toml"])
    assert refused(["calibrate", "camera", "--rig"])


@pytest.mark.parametrize("block", of_language("sh"), ids=str)
def test_commands_in_blocks_are_known(block: Block) -> None:
    for line in block.text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if not words or words[0] in OTHER_PROGRAMS:
            continue
        assert words[0] == "tankrig", line
        assert refused(words[1:]) is None, line


def test_commands_that_measure_select_tests_that_are_there() -> None:
    """A figure whose test was renamed could not be measured again by its command."""
    commands = {code for page in PAGES for code in inline_code(page) if re.match(r"(?:\w+=\S+ )*pytest .*tests/", code)}
    assert len(commands) > 30
    wrong = []
    for command in commands:
        words = shlex.split(command)
        files = [TREE / word for word in words if word.startswith("tests/")]
        text = "".join(file.read_text(encoding="utf-8") for file in files)
        asked = words[words.index("-k") + 1] if "-k" in words else ""
        wrong += [command for word in asked.split(" or ") if not re.search(rf"(?:def test|class Test)\w*{word}", text)]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(TREE)))
def test_commands_in_sentences_are_known(page: Path) -> None:
    wrong = []
    for code in inline_code(page):
        if not code.startswith("tankrig ") or re.search(r"[…|]|COMMAND", code):
            continue
        words = shlex.split(re.sub(r"[\[\]]", "", code))[1:]
        why = refused(words)
        if why and "requires" not in why:  # an option that is named without its value
            wrong.append(f"{code}: {why}")
    assert wrong == []


def test_all_commands_are_listed() -> None:
    listed = re.findall(
        r"^\| `([a-z-]+)` \|", (TREE / "docs" / "commands.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert listed == list(COMMANDS)


# -- files -----------------------------------------------------------------------------------------------------------


SCENE = {"tank", "medium", "projector", "camera"}
"""Tables of a scene file."""


def first_scene() -> dict[str, Any]:
    """The scene of the first hour, into which parts of a scene are put."""
    text = next(block.text for block in BLOCKS if block.page == "docs/first_hour.md" and block.language == "toml")
    return tomllib.loads(text)


def beside(block: Block, folder: Path) -> Path:
    """The block as a file, with what it refers to."""
    file = folder / "shown.toml"
    file.write_text(block.text, encoding="utf-8")
    return file


@pytest.mark.parametrize("block", of_language("toml"), ids=str)
def test_toml_that_is_shown_is_taken(block: Block, tmp_path: Path) -> None:
    """A scene is loaded, a sequence and a rig file too; parts of them are put into a whole one."""
    if block.text.startswith("{"):  # one step of a sequence, as it stands in a list
        step = tomllib.loads(f"steps = [{block.text}]")["steps"]
        sheet = {"kind": "sheet", "y_mm": [-60.0, 60.0], "z_mm": [50.0, 60.0]}
        whole = {"name": "a part", "exposure_ms": 8.6, "patterns": dict.fromkeys(("a", "b", "c", "sheet"), sheet)}
        (tmp_path / "sequence.toml").write_text(tomlkit.dumps(whole | {"steps": step}), encoding="utf-8")
        assert len(tankrig.load_sequence(tmp_path / "sequence.toml").steps) == 1
        return
    table = tomllib.loads(block.text)
    if {"tank", "medium"} <= table.keys():
        assert tankrig.load_scene(beside(block, tmp_path)).camera.shape[0] > 1
    elif "steps" in table:
        assert tankrig.load_sequence(beside(block, tmp_path)).steps
    elif "bench" in table:
        assert load_rig_file(beside(block, tmp_path)).name == table["name"]
    elif "phase" in table or (table.keys() <= SCENE and not any("driver" in part for part in table.values())):
        scene = first_scene()
        if "phase" in table:
            del scene["medium"]["g"]
        for name, part in (table if "phase" not in table else {"medium": table}).items():
            scene[name] |= part
        (tmp_path / "scene.toml").write_text(tomlkit.dumps(scene), encoding="utf-8")
        assert tankrig.load_scene(tmp_path / "scene.toml").camera.shape[0] > 1
    elif "project" in table:
        assert table["project"]["entry-points"]  # that of docs/write_a_driver.md, whose files other tests install
    else:
        part_of_a_rig_file(table, tmp_path)


def part_of_a_rig_file(table: dict[str, object], folder: Path) -> None:
    """Its tables and keys are those of a rig file, and what a driver's table says its driver takes."""
    devices = {kind: table.pop(kind) for kind in ("projector", "camera", "doser") if kind in table}
    for kind, settings in devices.items():
        assert isinstance(settings, dict)
        name = str(settings.pop("driver"))
        assert name in driver_names(), name
        module, _, settings_class = SETTINGS[name].partition(":")
        taken = getattr(importlib.import_module(module), settings_class).model_fields
        assert settings.keys() <= taken.keys(), kind
    keys = {name: value for name, value in table.items() if not isinstance(value, dict)}
    if keys.keys() <= {"flash", "burst_gap_ms", "burst_trigger", "calibration"} and keys:
        return  # keys of a device's table, shown alone; its page says which
    assert table.keys() <= {field.name for field in fields(RigFile)}
    whole = tomllib.loads(SIMULATED.read_text(encoding="utf-8")) | table
    (folder / "rig.toml").write_text(tomlkit.dumps(whole), encoding="utf-8")
    description = load_rig_file(folder / "rig.toml")
    for name, value in table.items():
        said = getattr(description, name)
        assert isinstance(value, dict)
        for key, one in value.items():
            assert (said[key] if isinstance(said, dict) else getattr(said, key)) == one


@pytest.mark.parametrize("block", of_language("yaml"), ids=str)
def test_yaml_can_be_read(block: Block) -> None:
    assert yaml.safe_load(block.text)


@pytest.mark.parametrize("block", of_language("python"), ids=str)
def test_names_that_python_imports_are_public(block: Block) -> None:
    """What a block imports from tankrig or drivers is there, and is shown by the package's face."""
    for node in ast.walk(ast.parse(block.text)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in ("tankrig", "drivers"):
            module = importlib.import_module(str(node.module))
            face = getattr(module, "__all__", dir(module))
            assert {one.name for one in node.names} <= set(face)


# -- completeness ----------------------------------------------------------------------------------------------------


def test_every_page_is_listed_once_and_stands_in_the_site() -> None:
    listed = re.findall(r"\]\(([\w/]+\.md)\)", (TREE / "docs" / "README.md").read_text(encoding="utf-8"))
    pages = {page.name for page in TREE.glob("docs/*.md")} - {
        "README.md",
        "index.md",
        "api_packages.md",
        "api_devices.md",
    }
    assert sorted(name for name in listed if "/" not in name) == sorted(pages)
    in_site = (TREE / "docs" / "index.md").read_text(encoding="utf-8")
    assert [name for name in pages if f"\n{name.removesuffix('.md')}\n" not in in_site] == []


def test_every_key_of_a_rig_file_is_explained() -> None:
    page = (TREE / "docs" / "rig_file.md").read_text(encoding="utf-8")
    assert [one.name for one in fields(RigFile) if f"`{one.name}`" not in page and f"`[{one.name}]`" not in page] == []


def test_every_package_with_a_face_is_in_the_reference() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in TREE.glob("docs/api*.md"))
    stubs = [stub for folder in ("tankrig", "drivers") for stub in (TREE / folder).glob("**/__init__.pyi")]
    faces = [".".join(stub.parent.relative_to(TREE).parts) for stub in stubs]
    assert len(faces) > 10
    assert [name for name in sorted(set(faces)) if f"automodule:: {name}\n" not in pages] == []


def test_citation_and_package_agree() -> None:
    citation = yaml.safe_load((TREE / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((TREE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert citation["keywords"] == project["keywords"]


# -- decisions -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.name)
def test_a_record_has_its_form(record: Path) -> None:
    """As CONTRIBUTING says."""
    text = record.read_text(encoding="utf-8")
    title = re.match(r"# (\d{4}): \S", text)
    assert title, "its first line is its number and what it is about"
    assert int(record.name[:4]) == int(title[1])
    assert re.search(
        r"^\*\*Status\.\*\* (In force|Proposed|Given up).*?\*\*Date\.\*\* 20\d\d-\d\d-\d\d",
        text,
        re.DOTALL | re.MULTILINE,
    )
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == ["Context", "Decision", "Consequences"]


def test_every_record_is_in_the_index_and_every_old_number_leads_to_one() -> None:
    index = (TREE / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    assert [record.name for record in RECORDS if f"]({record.name})" not in index] == []
    rows = dict(re.findall(r'^\| <a id="decision-(\d+)"></a>\1 \| (.*) \|$', index, re.MULTILINE))
    assert [int(number) for number in rows] == list(range(1, 177))
    gone = [number for number, row in rows.items() if "never used" not in row and "](0" not in row]
    assert gone == []


def test_decisions_that_are_named_anywhere_exist() -> None:
    """By number of a record, or by an old number that the index leads on."""
    index = (TREE / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    known = {int(record.name[:4]) for record in RECORDS} | {
        int(old) for old in re.findall(r'id="decision-(\d+)"', index)
    }
    files = [
        file for folder in ("tankrig", "drivers", "ui", "tests", "docs") for file in TREE.glob(f"{folder}/**/*.py")
    ]
    named = [
        (str(file.relative_to(TREE)), int(number))
        for file in [*files, *PAGES]
        for number in re.findall(r"[Dd]ecision \[?(\d+)", file.read_text(encoding="utf-8"))
    ]
    assert [(file, number) for file, number in named if number not in known] == []
