"""Runs for other programs: Bluesky documents and NeXus, checked by what their communities check with; a fit's JSON."""

import json
from pathlib import Path
from typing import Any

import h5py
import jsonschema
import numpy as np
import pytest
import zarr
from event_model import DocumentNames, schema_validators

from tankrig.archive.documents import documents_of
from tankrig.archive.nexus import DEFINITION
from tankrig.run.reading import open_run
from ui.cli import main

STORED = Path(__file__).parent / "data" / "stored"
RUNS = sorted(file.parent for file in STORED.rglob("journal.jsonl"))


def named(run: Path) -> str:
    return str(run.relative_to(STORED))


@pytest.mark.parametrize("path", RUNS, ids=named)
def test_documents_of_every_version_of_a_run_are_what_event_model_wants(path: Path) -> None:
    run = open_run(path)
    documents = list(documents_of(run))
    for kind, document in documents:
        schema_validators[DocumentNames[kind]].validate(document)
    assert documents == list(documents_of(open_run(path))), "the same run is told alike each time"
    assert documents[0][0] == "start"
    assert (documents[-1][0] == "stop") == (run.end is not None)
    uids = [document["uid"] for _, document in documents]
    assert len(set(uids)) == len(uids)


def test_documents_lead_to_the_pixels_and_to_what_was_true_of_them() -> None:
    path = next(one for one in RUNS if open_run(one).end is not None)
    run = open_run(path)
    documents: dict[str, list[dict[str, Any]]] = {}
    for kind, document in documents_of(run):
        documents.setdefault(kind, []).append(document)
    descriptors = {one["name"]: one for one in documents["descriptor"]}
    events = [one for one in documents["event"] if one["descriptor"] == descriptors["frames"]["uid"]]
    assert [one["seq_num"] for one in events] == list(range(1, len(run.events("frame")) + 1))
    assert [one["data"]["delivered_ul"] for one in events] == run.frames.delivered_ul.values.tolist()
    (resource,) = documents["stream_resource"]
    folder = resource["uri"].removeprefix("file://localhost")
    array: Any = zarr.open_array(Path(folder) / resource["parameters"]["dataset"], mode="r")
    seen = np.concatenate(
        [array[one["indices"]["start"] : one["indices"]["stop"]] for one in documents["stream_datum"]]
    )
    np.testing.assert_array_equal(seen, run.frames.values)
    assert documents["stop"][0]["num_events"]["frames"] == len(events)


def test_a_run_as_nexus_is_what_the_definition_wants(tmp_path: Path) -> None:
    from pynxtools.dataconverter.validation import validate_hdf_group_against

    path = next(one for one in RUNS if open_run(one).end is not None)
    file = tmp_path / "run.nxs"
    assert main(["export", str(path), "--out", str(file)]) == 0
    run = open_run(path)
    with h5py.File(file) as content:
        assert validate_hdf_group_against(DEFINITION, content["entry"], str(file))
        np.testing.assert_array_equal(content["entry/data/frames"][:], run.frames.values)
        np.testing.assert_array_equal(content["entry/data/exposure_ms"][:], run.frames.exposure_ms.values)
        assert content["entry/estimate/doses/sigma_s"].shape == content["entry/estimate/doses/dose_ml"].shape
    with h5py.File(file, "r+") as content:
        del content["entry/sample/name"]
    with h5py.File(file) as content:
        assert not validate_hdf_group_against(DEFINITION, content["entry"], str(file)), "it does look"


def test_export_by_the_name_of_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(next(one for one in RUNS if open_run(one).end is not None))
    assert main(["export", path, "--out", str(tmp_path / "run.jsonl")]) == 0
    for line in (tmp_path / "run.jsonl").read_text(encoding="utf-8").splitlines():
        kind, _ = json.loads(line)
        assert kind in DocumentNames.__members__
    assert main(["export", path, "--out", str(tmp_path / "run.nc")]) == 0
    assert main(["export", path, "--out", str(tmp_path / "run.xyz")]) == 2
    assert "give .nxs" in capsys.readouterr().err


def test_what_fit_prints_is_what_its_schema_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TANKRIG_CACHE", str(tmp_path))
    reference = Path(__file__).parent / "data" / "reference"
    assert main(["fit", "--schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(schema)
    words = ["--scene", str(reference / "pub08.toml"), "--model", "single", "--out", str(tmp_path), "--json"]
    assert main(["fit", str(reference / "pub08.npz"), *words]) == 0
    told = json.loads(capsys.readouterr().out)
    jsonschema.validate(told, schema)
    assert told["format"] == schema["properties"]["format"]["const"]
    for key in schema["required"]:
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({name: value for name, value in told.items() if name != key}, schema)
    assert set(told) <= set(schema["properties"]), "what is printed is in the schema"
