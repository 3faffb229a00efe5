"""The command line: what it writes, and that whatever goes wrong is one sentence and the right exit status."""

import errno
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import MappingProxyType

import click
import numpy as np
import pytest

import tankrig
import ui.cli
from tankrig.prediction import Skipped
from ui.cli import COMMANDS, main

SCENE = Path(__file__).parent / "data" / "reference" / "pub02.toml"


def one_sentence(capsys: pytest.CaptureFixture[str]) -> str:
    """What stands on stderr, which must be one line, with nothing on stdout."""
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("tankrig: ")
    assert captured.err.endswith("\n")
    assert captured.err.count("\n") == 1
    return captured.err


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"Example: tankrig {name}" in text
    assert re.search(r"\n  \S.*\.\n", text), "says in a sentence what it does"


def test_help_lists_the_commands_and_version_is_the_installed_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name in COMMANDS:
        assert re.search(rf"^  {name} +\w", text, re.MULTILINE)
    assert main(["--version"]) == 0
    assert re.fullmatch(r"tankrig \d+\.\d+\.\d+\n", capsys.readouterr().out)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["predcit"], "No such command 'predcit'; did you mean 'predict'? (see tankrig --help)"),
        (["fti", "x"], "No such command 'fti'; did you mean 'fit'? (see tankrig --help)"),
        (["materials", "shw"], "No such command 'shw'; did you mean 'show'? (see tankrig materials --help)"),
        (["quantify"], "No such command 'quantify'; see tankrig --help"),
        (["export-medium", "x.json"], "Missing option '--to'. Choose from: mitsuba, pbrt, mcx, csv; see"),
        (["materials", "show", "foo"], 'material "foo" is unknown; tankrig materials lists those that are known'),
        (["predict", "{scene}", "--tolerence", "1"], "did you mean '--tolerance'? (see"),
        (["predict"], "Missing argument 'SCENE'; see tankrig predict --help"),
        (["predict", "nowhere.toml"], "nowhere.toml: cannot be read (No such file or directory); give"),
        (["predict", "{scene}", "--toleranse", "0.1"], "No such option '--toleranse'"),
        (["predict", "{scene}", "--tolerance", "0"], "'--tolerance': 0.0 is not in the range"),
        (["predict", "{scene}", "--tolerance", "nan"], "nan"),
        (["predict", "{scene}", "--max-order", "0"], "'--max-order': 0 is not in the range"),
        (["predict", "{scene}", "--model", "singel"], "singel"),
        (["predict", "{scene}", "--out", "{file}/below"], "{file} is not a folder; give another place"),
        (["predict", "{wrong}"], "wrong.toml: medium.g = 2.0 is outside"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_bad_input_is_one_sentence_status_2_and_nothing_written(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    places = {"scene": SCENE, "file": tmp_path / "a_file", "wrong": tmp_path / "wrong.toml"}
    places["file"].touch()
    places["wrong"].write_text(re.sub(r"g = .*", "g = 2", SCENE.read_text()))
    before = sorted(tmp_path.rglob("*"))
    assert main([argument.format(**places) for argument in arguments]) == 2
    assert said.format(**places) in one_sentence(capsys)
    assert sorted(tmp_path.rglob("*")) == before


def failing_with(error: BaseException) -> Callable[..., None]:
    """Stand-in for `tankrig.predict` that raises `error`."""

    def fail(*_: object) -> None:
        raise error

    return fail


def disk_full() -> tankrig.StoreError:
    """What writing to a full disk raises."""
    error = tankrig.StoreError("the disk is full; make room")
    error.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    return error


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (tankrig.SceneError("a scene; mend it"), 2, "a scene; mend it"),
        (tankrig.ImageError("an image; mend it"), 2, "an image; mend it"),
        (tankrig.SequenceError("a sequence; mend it"), 2, "a sequence; mend it"),
        (tankrig.StoreError("a folder; give another"), 2, "a folder; give another"),
        (tankrig.CacheError("a folder; give another"), 2, "a folder; give another"),
        (disk_full(), 1, "the disk is full; make room"),
        (tankrig.DeviceError("the pump says nothing; look"), 1, "the pump says nothing; look"),
        (tankrig.UndecidedError("was the dose given? say --delivered-ul"), 3, "was the dose given? say --delivered-ul"),
        (click.Abort(), 1, "stopped on request"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_each_error_has_its_exit_status(
    error: BaseException,
    status: int,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(tankrig, "predict", failing_with(error))
    assert main(["predict", str(SCENE), "--out", str(tmp_path / "out")]) == status
    assert one_sentence(capsys) == f"tankrig: {said}\n"
    assert not (tmp_path / "out").exists()


def test_ctrl_c_ends_with_a_word_and_nothing_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tankrig, "predict", failing_with(KeyboardInterrupt()))
    assert main(["predict", str(SCENE), "--out", str(tmp_path / "out")]) == 1
    assert "stopped on request" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_unexpected_error_says_where_its_traceback_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr(tankrig, "predict", failing_with(ZeroDivisionError("of no meaning")))
    assert main(["predict", str(SCENE), "--out", str(tmp_path / "out")]) == 1
    sentence = one_sentence(capsys)
    assert "failed unexpectedly (ZeroDivisionError: of no meaning)" in sentence
    (kept,) = tmp_path.glob("tankrig-*.txt")
    assert str(kept) in sentence
    assert "Traceback (most recent call last)" in kept.read_text()

    monkeypatch.setenv("TANKRIG_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["predict", str(SCENE), "--out", str(tmp_path / "out")])


def test_predict_writes_arrays_and_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["predict", str(SCENE), "--model", "single", "--out", str(tmp_path / "new" / "folder")]) == 0
    told = capsys.readouterr()
    assert "model    single" in told.out
    folder = tmp_path / "new" / "folder"
    assert sorted(file.name for file in folder.iterdir()) == ["pub02.npz", "pub02.png"]
    assert (folder / "pub02.png").read_bytes().startswith(b"\x89PNG")
    with np.load(folder / "pub02.npz") as data, np.load(SCENE.with_suffix(".npz")) as reference:
        np.testing.assert_allclose(data["total"], reference["order1"], rtol=0.01, atol=1e-3 * reference["order1"].max())
        np.testing.assert_allclose(data["x_mm"], reference["x_mm"])
        np.testing.assert_allclose(data["y_mm"], reference["y_mm"])
        metadata = json.loads(str(data["metadata"]))
    assert metadata["model"] == "single"
    assert metadata["scene"]["medium"] == {"sigma_a": 0.0002, "sigma_s": 0.0018, "g": 0.0}


def test_coefficients_that_look_like_per_metre_are_doubted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Minutes passed without a word, and the image was nearly dark."""
    scene = tmp_path / "scene.toml"
    for sigma_s, doubted in (("1.8", True), ("0.0018", False)):
        scene.write_text(SCENE.read_text(encoding="utf-8").replace("0.0018", sigma_s), encoding="utf-8")
        assert main(["predict", str(scene), "--model", "single", "--out", str(tmp_path)]) == 0
        assert ("per mm, not per metre" in capsys.readouterr().err) == doubted


def test_predict_with_json_prints_one_line_of_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "image.npz"
    assert main(["predict", str(SCENE), "--model", "single", "--out", str(file), "--json"]) == 0
    line = capsys.readouterr().out
    assert line.count("\n") == 1
    record = json.loads(line, parse_constant=pytest.fail)  # Infinity and NaN are not JSON
    assert record["arrays"] == str(file)
    with np.load(file) as data:
        assert record["peak"] == pytest.approx(float(data["total"].max()))


def test_an_image_without_light_says_so_and_why_it_is_not_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It blamed a budget of 120 s that it had not used, by a name that the command does not have."""
    what = "all light: none of the paths reached the camera"
    dark = tankrig.Prediction(
        np.zeros((80, 120)), "tank", MappingProxyType({}), np.zeros((80, 120)),
        (Skipped("orders above 30000", 1.0), Skipped(what, 1.0), Skipped("tables", 0.0)),
    )  # fmt: skip
    monkeypatch.setattr("tankrig.light.tank.tank_image", lambda *_, **__: dark)
    assert main(["predict", str(SCENE), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert f"more than --tolerance 0.01 (left out: {what})" in told
    assert "though the liquid is lit and scatters" in told
    assert "budget" not in told
    assert "tables" not in told  # by at most 0


def floats_in(command: click.Command, words: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Arguments that name each of a command's options of one float or several, and of its subcommands'."""
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from floats_in(below, (*words, name))
    for one in command.params:
        kinds = one.type.types if isinstance(one.type, click.Tuple) else [one.type]
        if isinstance(one, click.Option) and all(isinstance(kind, click.types.FloatParamType) for kind in kinds):
            yield (*words, one.opts[0], *[str(len(kinds))])


FLOATS = sorted(set(floats_in(ui.cli.tankrig, ())))


def test_many_options_are_floats() -> None:
    assert len(FLOATS) > 40
    assert ("materials", "plan", "--tank-ml", "1") in FLOATS
    assert ("prepare", "--sigma-t", "2") in FLOATS


@pytest.mark.parametrize("given", ["nan", "inf", "-inf"])
def test_no_option_takes_a_number_that_is_none(given: str, capsys: pytest.CaptureFixture[str]) -> None:
    for *words, count in FLOATS:
        assert main([*words, *[given] * int(count)]) == 2, words
        said = one_sentence(capsys)
        assert f"'{words[-1]}'" in said
        assert f"{given!r} is not a finite number" in said
