"""An archive refitted: each run once, whoever is killed, and what was found is the same as one run after the other."""

import json
import os
import random
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.simulated.archive import make_archive
from tankrig.archive import refit as refitting
from tankrig.archive.key import Refitting, refit_key
from tankrig.archive.mark import meaning, refit_mark
from tankrig.archive.refit import RunToRefit, beside_others, from_share, in_this_process, runs_to_refit
from tankrig.archive.results import FAILED as FAILED_FILE
from tankrig.archive.results import FITTED, LOCK, Results
from tankrig.archive.runs import runs_in
from tankrig.archive.slurm import script_text
from tankrig.archive.task import FAILED, MADE, TAKEN, THERE, OtherCodeError, refit_run
from tankrig.errors import StoreError
from tankrig.run.folder import create_run
from tankrig.run.reading import open_run
from tankrig.run.writer import RunWriter
from ui.cli import main

PROGRAM = [sys.executable, "-c", "import sys; from ui.cli import main; sys.exit(main())"]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One prepared model for all."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made") / "archive"
    make_archive(folder, 2, 3, tolerance=0.01)
    return folder


@pytest.fixture
def archive(made: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TANKRIG_CACHE", str(cache))
    shutil.copytree(made, tmp_path / "archive")
    return tmp_path / "archive"


def refitted(archive: Path, out: Path, *options: str) -> Any:
    """What a program of its own says of its refit, in which code is read from the cache and not compiled.

    A process that compiles a kernel may round its last digit otherwise than those which read what it has compiled.
    """
    command = [*PROGRAM, "refit", str(archive), "--out", str(out), "--json", *options]
    # As a person has it: whose sums take as many threads as there are, must find the same.
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    ended = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True, timeout=250)
    return json.loads(ended.stdout)


def found(results: Path) -> dict[str, Any]:
    """What was found of each run, less when and by whom."""
    return {row["run"]: {**row, "made": None} for row in Results(results).rows()}


def test_each_run_is_fitted_once_and_asking_again_does_what_is_missing(archive: Path, tmp_path: Path) -> None:
    out = tmp_path / "results"
    assert main(["refit", str(archive), "--out", str(tmp_path / "compiled")]) == 0
    assert refitted(archive, out)["made"] == 6
    first = found(out)
    assert {row["fits"][0]["model"] for row in first.values()} == {"prepared"}
    assert {len(row["fits"]) for row in first.values()} == {1}, "one dose, whose last fit counts"
    assert all("single" in row["fits"][0] for row in first.values())
    shutil.rmtree(out / "runs" / "twin-00-001")
    again = refitted(archive, out, "--workers", "2")
    assert (again["made"], again["there"]) == (1, 5)
    assert found(out) == first, "a worker finds what the other process found, to the last bit"
    for path in runs_in(archive):
        assert not open_run(path).fits, "an archive is only read"


def test_what_a_fit_rests_on_changes_its_key_and_nothing_else_does(archive: Path) -> None:
    path = archive / "twin-00-000"
    asked = Refitting(refit_mark())
    key = refit_key(open_run(path), asked)
    shutil.copytree(path, archive / "renamed")
    with RunWriter(archive / "renamed") as writer:
        writer.put("note", text="dusted")
    assert refit_key(open_run(archive / "renamed"), asked) == key
    assert refit_key(open_run(archive / "twin-00-001"), asked) != key, "other frames"
    assert refit_key(open_run(path), Refitting(refit_mark(), "tank")) != key
    assert refit_key(open_run(path), Refitting("other code")) != key
    group = json.loads((path / "zarr.json").read_text())
    group["attributes"]["tankrig"]["settings"]["calibrations"] = {"radiometry": "measured since"}
    (path / "zarr.json").write_text(json.dumps(group))
    assert refit_key(open_run(path), asked) != key


@given(st.text("ab #\n", max_size=20))
def test_words_about_code_are_not_code(words: str) -> None:
    """A release that explains more must refit nothing."""
    comment = "".join(f"# {line}\n" for line in words.split("\n"))
    source = f"def f(x):\n    {json.dumps(words)}\n    return x + 1\n"
    assert meaning(comment + source) == meaning("def f(x):\n    return x + 1\n")
    assert meaning(source) != meaning("def f(x):\n    return x + 2\n")


def test_damaged_unfinished_and_empty_runs_are_rows_with_a_sentence_and_the_others_are_fitted(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "results"
    (archive / "twin-00-000" / "frames" / "c.2.0.0").unlink()
    (archive / "twin-00-001" / "zarr.json").write_text("{")
    create_run(archive / "empty", (40, 60), "uint16", 1, {"name": "empty"})
    journal = archive / "twin-01-000" / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-1]))  # without its end
    with RunWriter(archive / "twin-01-001"):
        assert main(["refit", str(archive), "--out", str(out), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    sentences = {one["run"]: one["error"] for one in told["failed"]}
    assert sorted(sentences) == ["empty", "twin-00-000", "twin-00-001", "twin-01-001"]
    assert "frame 2 is missing" in sentences["twin-00-000"]
    assert "is being recorded" in sentences["twin-01-001"]
    rows = found(out)
    assert rows["twin-01-000"]["ending"] == "unfinished"
    assert {name for name, row in rows.items() if row.get("failed")} == set(sentences)
    shutil.copy(archive / "twin-00-002" / "frames" / "c.2.0.0", archive / "twin-00-000" / "frames")
    assert main(["refit", str(archive), "--out", str(out), "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told["made"] == 2, "what failed is tried again"
    assert "failed" not in found(out)["twin-01-001"]


@pytest.mark.long
def test_two_refits_of_one_archive_share_it(archive: Path, tmp_path: Path) -> None:
    """Each run is fitted by one of them, none is half-written, and both end when all is done."""
    out = tmp_path / "results"
    command = [*PROGRAM, "refit", str(archive), "--out", str(out), "--json"]
    both = [
        subprocess.Popen([*command, "--share", f"{index}/2"], stdout=subprocess.PIPE, text=True) for index in range(2)
    ]
    told = [json.loads(one.communicate(timeout=250)[0]) for one in both]
    assert sum(one["made"] for one in told) == 6
    assert [one["made"] + one["there"] for one in told] == [6, 6]


def test_a_run_that_another_program_is_at_is_left_for_the_end(archive: Path, tmp_path: Path) -> None:
    results = Results(tmp_path / "results")
    asked = Refitting(refit_mark())
    wanted = runs_to_refit(archive, results, asked)
    begun: list[str] = []

    def do(runs_to_refit: Any) -> Any:
        for done in in_this_process(runs_to_refit):
            begun.append(f"{done.name} {done.outcome}")
            if done.name == "twin-01-002":
                other.__exit__(None, None, None)
            yield done

    other = results.claimed("twin-00-000")
    assert other.__enter__()
    assert sorted(one.name for one in beside_others(do, wanted)) == [one.name for one in wanted]
    assert begun[0] == f"twin-00-000 {TAKEN}"
    assert begun[-1] == f"twin-00-000 {MADE}"


@given(st.integers(1, 30), st.integers(1, 8))
def test_shares_begin_apart_and_each_goes_through_the_whole_archive(count: int, shares: int) -> None:
    wanted: Any = list(range(count))
    orders = [from_share(wanted, share, shares) for share in range(shares)]
    assert all(sorted(order) == wanted for order in orders)
    assert len({order[0] for order in orders}) == min(count, shares)


def test_results_of_a_worker_with_other_code_are_not_taken(archive: Path, tmp_path: Path) -> None:
    with pytest.raises(OtherCodeError, match="runs other code"):
        refit_run(archive / "twin-00-000", "one", Results(tmp_path / "results"), Refitting("of another version"))
    assert not (tmp_path / "results").exists()


def test_a_damaged_result_is_a_row_and_results_are_never_written_over(archive: Path, tmp_path: Path) -> None:
    results = Results(tmp_path / "results")
    one = runs_to_refit(archive, results, Refitting(refit_mark()))[0]
    assert one.run().outcome == MADE
    assert one.run().outcome == THERE
    (file,) = (results.folder / "runs" / one.name).glob("*.json")
    before = file.read_bytes()
    with results.claimed(one.name):
        assert not results.put(one.name, file.stem, {"made": {"utc": "later"}})
    assert file.read_bytes() == before
    file.write_bytes(before[: len(before) // 2])
    (row,) = results.rows()
    assert "damaged" in row["failed"]


def test_bad_input_is_told_in_a_sentence(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = str(tmp_path / "results")
    (tmp_path / "nothing").mkdir()
    for words, told in (
        (["--workers", "2"], "needs --out"),
        (["--out", out, "--workers", "2", "--share", "0/2"], "two ways"),
        (["--out", out, "--share", "2/2"], "is not I/N"),
        (["--out", out, "--scheduler", "tcp://node7:8786"], "has to ask for certificates"),
        (["--out", out, "--scheduler", "tls://127.0.0.1:9", "--tls", "a", "b", "c"], "is not there"),
        (["--out", str(archive / "twin-00-000" / "zarr.json")], "is not a folder"),
    ):
        assert main(["refit", str(archive), *words]) == 2
        assert told in capsys.readouterr().err.replace("\n", " ")
    assert main(["refit", str(tmp_path / "nothing"), "--out", out]) == 2
    assert "there is no run in it" in capsys.readouterr().err
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["refit", str(archive), "--out", out, "--slurm", "--time=1:00:00"]) == 2
    assert "there is no sbatch here" in capsys.readouterr().err


def test_a_scheduler_that_does_not_answer_or_goes_away_is_told_in_a_sentence(
    archive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["refit", str(archive), "--out", str(tmp_path / "results"), "--scheduler"]
    assert main([*command, "tcp://127.0.0.1:9"]) == 1
    assert "does not answer" in capsys.readouterr().err
    address = tmp_path / "address.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    scheduler = subprocess.Popen(
        [*dask, "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(address)],
        stderr=subprocess.DEVNULL,
    )
    try:
        deadline = time.monotonic() + 60.0
        while not address.exists():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        refit = subprocess.Popen(
            [*PROGRAM, *command, json.loads(address.read_text())["address"]], stderr=subprocess.PIPE
        )
        while not _is_connected(refit):
            assert refit.poll() is None
            time.sleep(0.1)
        time.sleep(3.0)  # it waits for workers, of which there are none
        assert refit.poll() is None
    finally:
        scheduler.kill()
        scheduler.wait()
    told = refit.communicate(timeout=90)[1].decode()
    assert refit.returncode == 1, told
    assert "the scheduler has gone away" in told
    assert "Traceback" not in told


@pytest.mark.long
def test_workers_elsewhere_with_certificates_made_as_the_page_says(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[1] / "docs" / "archive.md").read_text(encoding="utf-8")
    (maker,) = [code for code in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "Security.temporary" in code]
    monkeypatch.chdir(tmp_path)
    exec(maker, {})
    certificates = ["ca.pem", "cert.pem", "key.pem"]
    assert {oct(Path(name).stat().st_mode & 0o777) for name in certificates} == {"0o600"}
    tls = [
        word
        for kind, name in zip(("ca-file", "cert", "key"), certificates, strict=True)
        for word in (f"--tls-{kind}", name)
    ]
    scheduler = [
        "--protocol",
        "tls",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
        "--scheduler-file",
        "s.json",
    ]
    dask, quiet = [sys.executable, "-m"], {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with ExitStack() as undo:
        for words in (
            ["distributed.cli.dask_scheduler", *scheduler, *tls],
            ["distributed.cli.dask_worker", "--scheduler-file", "s.json", "--nthreads", "1", "--no-dashboard", *tls],
        ):
            program = undo.enter_context(subprocess.Popen([*dask, *words], **quiet))
            undo.callback(program.terminate)
        while not Path("s.json").exists():
            time.sleep(0.1)
        address = json.loads(Path("s.json").read_text())["address"]
        words = ["refit", str(archive), "--out", "results", "--json", "--scheduler", address]
        assert main([*words, "--tls", *certificates]) == 0
        assert json.loads(capsys.readouterr().out)["made"] == 6
        assert main(words) == 2
        assert "needs certificates" in capsys.readouterr().err


def _is_connected(program: "subprocess.Popen[bytes]") -> bool:
    return any(line.status == psutil.CONN_ESTABLISHED for line in psutil.Process(program.pid).net_connections("tcp"))


def listening() -> set[Any]:
    """Addresses at which this process and its children wait for others; some of them may end meanwhile."""
    me, found = psutil.Process(), set()
    for process in (me, *me.children(recursive=True)):
        with suppress(psutil.Error):
            found |= {one.laddr for one in process.net_connections("inet") if one.status == psutil.CONN_LISTEN}
    return found


def speaks_to(address: str, secured: bool) -> bool:
    """Whether a scheduler tells somebody without a certificate anything; who comes in is greeted at once."""
    host, port = address.removeprefix("tls://").removeprefix("tcp://").split(":")
    anybody = ssl.create_default_context()
    anybody.check_hostname, anybody.verify_mode = False, ssl.CERT_NONE
    with suppress(OSError), socket.create_connection((host, int(port)), timeout=20.0) as plain:
        one = anybody.wrap_socket(plain) if secured else plain
        one.sendall(bytes(64))  # no greeting: who waits for one gives up
        return one.recv(1) != b""
    return False


def test_nobody_else_gets_in() -> None:
    """What a local cluster listens on is this machine's own address, and speaks to nobody without its certificates."""
    from tankrig.archive.farm import workers_here

    before = listening()
    with workers_here(1) as client:
        ports = listening() - before
        assert len(ports) >= 3, "of the scheduler, a nanny, its worker"
        assert {address.ip for address in ports} == {"127.0.0.1"}
        address = client.scheduler_info()["address"]
        assert address.startswith("tls://")
        assert not speaks_to(address, secured=True)
        assert not speaks_to(address, secured=False)


@pytest.mark.long
def test_the_array_job_runs_to_its_end_and_asks_to_be_queued_again(archive: Path, tmp_path: Path) -> None:
    """The script itself, by bash, with a stand-in for scontrol: what SLURM would run on a node."""
    out, log = tmp_path / "results", tmp_path / "requeued"
    command = [*PROGRAM, "refit", str(archive), "--out", str(out)]
    script = tmp_path / "refit.sbatch"
    script.write_text(script_text(command, 2, ["--time=0:10:00"], tmp_path))
    (tmp_path / "scontrol").write_text(f'#!/bin/bash\necho "$@" >> {log}\n')
    (tmp_path / "scontrol").chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tmp_path}:{os.environ['PATH']}", "SLURM_ARRAY_JOB_ID": "77", "SLURM_ARRAY_TASK_ID": "1",
    }  # fmt: skip
    assert "#SBATCH --time=0:10:00\n" in script.read_text()
    job = subprocess.Popen(["bash", str(script)], env=environment, stderr=subprocess.DEVNULL)
    while not list(out.glob(f"runs/*/{LOCK}")):
        assert job.poll() is None
        time.sleep(0.02)
    job.send_signal(signal.SIGUSR1)
    assert job.wait(timeout=60) == 0
    assert log.read_text() == "requeue 77_1\n"
    assert not list(out.rglob(FAILED_FILE)), "a run that was interrupted has not failed"
    subprocess.run(["bash", str(script)], env=environment, check=True, timeout=250)
    assert len(found(out)) == 6
    assert log.read_text() == "requeue 77_1\n"


def test_what_is_left_is_told_from_the_rate_of_late() -> None:
    clock = iter([0.0, *[60.0 * one for one in range(1, 6)], *[300.0] * 3])
    progress = refitting.Progress(10, clock=clock.__next__)
    for _ in range(5):
        progress.add(refitting.Done("a run", MADE))
    assert str(progress) == "5 of 10 runs, 1 per minute, 5 min left"
    assert RunToRefit("a", "b", "c", Refitting("")).wait


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_under_random_kills_each_run_is_fitted_exactly_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers and driver are killed every few seconds, each worker lives three minutes at most, and nothing is lost.

    TANKRIG_TWINS names an archive of twins and TANKRIG_TWINS_CACHE a cache that are kept from call to call; TWIN_SEEDS
    is how many runs of each of 20 media (250 for the whole figure).
    """
    archive = Path(os.environ.get("TANKRIG_TWINS", tmp_path / "twins"))
    monkeypatch.setenv("TANKRIG_CACHE", os.environ.get("TANKRIG_TWINS_CACHE", str(tmp_path / "cache")))
    twins = make_archive(archive, 20, int(os.environ.get("TWIN_SEEDS", "25")))
    serial, killed = tmp_path / "serial", tmp_path / "killed"
    names = [one.name for one in twins]
    asked = Refitting(refit_mark())
    refitted(archive / names[0], tmp_path / "compiled")
    begun = time.monotonic(), time.process_time()
    alone = [one for one in runs_to_refit(archive, Results(serial), asked) if one.name in set(names)]
    assert {one.outcome for one in in_this_process(alone)} == {MADE}
    print(
        f"\nserial: {len(names)} runs, {time.monotonic() - begun[0]:.0f} s, {time.process_time() - begun[1]:.0f} CPU s"
    )
    chance = random.Random(22)
    kills = {"driver": 0, "worker": 0}
    back, peak, begun_s, lost_s = [], 0, time.monotonic(), 0.0
    driver = _driver(archive, killed)
    while (status := driver.poll()) is None:
        time.sleep(chance.uniform(2.0, 6.0))
        before = _count(killed)
        everyone = _workers(driver)
        peak = max([peak, *(_memory(one) for one in everyone)])
        victim = chance.choice(everyone) if everyone and chance.random() < 0.8 else None
        if victim is not None:
            victim.kill()
        elif before:
            driver.kill()
            driver.wait()
            driver = _driver(archive, killed)
        else:
            continue
        kills["worker" if victim is not None else "driver"] += 1
        since_s = time.monotonic()
        while _count(killed) == before and driver.poll() is None and time.monotonic() < since_s + 60.0:
            time.sleep(0.05)
        back.append((victim is None, time.monotonic() - since_s))
    lost_s = time.monotonic() - begun_s
    assert status == 0
    assert {name: row for name, row in found(killed).items() if name in set(names)} == found(serial)
    fitted = Counter(json.loads(line)["run"] for line in (killed / FITTED).read_text().splitlines())
    assert fitted.most_common(1)[0][1] == 1, "a fit that came to its end is never made again"
    for folder in (killed / "runs").iterdir():
        assert len(list(folder.glob("*.json*"))) == 1, f"{folder}: holds something half-written"
    of_driver, of_worker = ([s for driver_killed, s in back if driver_killed is kind] for kind in (True, False))
    print(f"killed: {kills}, {lost_s:.0f} s; peak memory of a worker {peak / 2**20:.0f} MiB")
    for who, times in (("worker", of_worker), ("driver", of_driver)):
        if times:
            median_s = sorted(times)[len(times) // 2]
            print(f"next result after a {who}'s death: median {median_s:.1f}, worst {max(times):.1f} s")


def _driver(archive: Path, out: Path) -> "subprocess.Popen[bytes]":
    command = ["refit", str(archive), "--out", str(out), "--workers", "2", "--worker-minutes", "3"]
    return subprocess.Popen([*PROGRAM, *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _workers(driver: "subprocess.Popen[bytes]") -> list[psutil.Process]:
    """Processes that fit, which the forkserver of a driver has made."""
    found = []
    for one in psutil.Process(driver.pid).children():
        try:
            found += one.children() if "forkserver" in " ".join(one.cmdline()) else []
        except psutil.Error:
            continue
    return found


def _memory(process: psutil.Process) -> int:
    try:
        return int(process.memory_info().rss)
    except psutil.Error:
        return 0


def _count(results: Path) -> int:
    return len(list(results.glob("runs/*/*.json")))


def test_failures_do_not_stop_the_others(archive: Path, tmp_path: Path) -> None:
    (archive / "twin-00-000" / "journal.jsonl").write_bytes(b"")
    outcomes = {
        one.name: one.outcome
        for one in in_this_process(runs_to_refit(archive, Results(tmp_path / "r"), Refitting(refit_mark())))
    }
    assert outcomes.pop("twin-00-000") == FAILED
    assert set(outcomes.values()) == {MADE}
    with pytest.raises(StoreError, match="no run"):
        runs_in(tmp_path / "r")
