"""The check of licences finds what may not be required, and what nobody knows."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / ".ci" / "licences.py"


def install(site: Path, name: str, *facts: str) -> None:
    """What pip leaves of a package, as far as its metadata goes."""
    info = site / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1.0", *facts]) + "\n")


def checked(site: Path, *packages: tuple[str, ...]) -> subprocess.CompletedProcess:
    """The script, where tankrig requires `packages`."""
    needs = [f"Requires-Dist: {name}" for name, *_ in packages]
    install(site, "tankrig", "License-Expression: BSD-3-Clause", *needs)
    for name, *facts in packages:
        if facts:
            install(site, name, *facts)
    command = [sys.executable, str(SCRIPT)]
    return subprocess.run(command, env={"PYTHONPATH": str(site)}, capture_output=True, text=True, timeout=60.0)


@pytest.mark.parametrize(
    "fact",
    [
        "License-Expression: GPL-2.0-only",
        "License: GPLv3+",
        "Classifier: License :: OSI Approved :: GNU General Public License v3 (GPLv3)",
        "Classifier: License :: OSI Approved :: GNU Affero General Public License v3",
        "License: GNU GPL v2",
    ],
)
def test_a_gpl_dependency_fails_however_its_metadata_says_so(tmp_path, fact):
    done = checked(tmp_path, ("some-driver", fact))
    assert done.returncode == 1
    assert "licences: some-driver: is " in done.stderr


def test_a_gpl_dependency_of_a_dependency_fails_too(tmp_path):
    install(tmp_path, "deeper", "License: AGPL-3.0")
    done = checked(tmp_path, ("harmless", "License: MIT", "Requires-Dist: deeper"))
    assert done.returncode == 1
    assert "licences: deeper: is AGPL-3.0" in done.stderr


@pytest.mark.parametrize(
    "fact",
    [
        "License-Expression: LGPL-3.0-only OR GPL-3.0-only",
        "License: GNU Lesser General Public License v3",
        "Classifier: License :: OSI Approved :: GNU Library or Lesser General Public License (LGPL)",
        "License-Expression: BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1",
        "Classifier: License :: OSI Approved :: Mozilla Public License 2.0 (MPL 2.0)",
    ],
)
def test_what_a_bsd_package_may_require_passes(tmp_path, fact):
    done = checked(tmp_path, ("some-library", fact))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("fact", ["License: UNKNOWN", "Summary: says nothing"])
def test_a_licence_that_nobody_knows_fails(tmp_path, fact):
    done = checked(tmp_path, ("some-library", fact))
    assert done.returncode == 1
    assert "some-library: its metadata says no licence; look it up and list it in KNOWN" in done.stderr
