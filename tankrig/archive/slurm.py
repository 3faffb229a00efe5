"""Refit an archive on SLURM: an array of a few long jobs, each of which goes through the archive until nothing is left.

There is no scheduler of ours to die and nothing that stays on a login node: the jobs know nothing of each other but the
folder of results, where each claims a run before it fits it. Many runs go into one job, so a limit on the number of
jobs does not matter; a job whose time is up is queued again by itself, and what it left the others do meanwhile.
"""

import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tankrig.errors import StoreError, TankrigError
from tankrig.files import whole_file

RUN = "import sys; from ui.cli import main; sys.exit(main())"
"""Of Python: the command line, by the same interpreter on every node."""
SCRIPT = "refit.sbatch"
WARNED_S = 60
"""A job is told so long before its time is up, and then asks to be queued again."""


class SlurmError(TankrigError):
    """SLURM is not here, or has refused a job."""


def script_text(command: Sequence[str], jobs: int, options: Sequence[str], log: Path) -> str:
    """What `sbatch` is given.

    Parameters
    ----------
    command
        `tankrig refit …` as one of the jobs is to run it; its share is added.
    jobs
        Elements of the array.
    options
        Further ones of sbatch, such as "--time=2:00:00".
    log
        Folder of the jobs' own words.
    """
    head = [
        "--job-name=tankrig-refit", f"--array=0-{jobs - 1}", "--ntasks=1", "--cpus-per-task=1", "--requeue",
        "--open-mode=append", f"--signal=B:USR1@{WARNED_S}", f"--output={log}/%a.log", *options,
    ]  # fmt: skip
    lines = [
        "#!/bin/bash",
        *(f"#SBATCH {option}" for option in head),
        "export TANKRIG_THREADS=1 OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1",
        "# The time is nearly up: end, losing one run at most, and wait in the queue again.",
        'again() { kill -TERM "$refit"; wait "$refit"; '
        'scontrol requeue "${SLURM_ARRAY_JOB_ID}_${SLURM_ARRAY_TASK_ID}"; exit 0; }',
        "trap again USR1",
        f'{shlex.join(command)} --share "$SLURM_ARRAY_TASK_ID/{jobs}" &',
        "refit=$!",
        'wait "$refit"',
        "",
    ]
    return "\n".join(lines)


def submit(archive: Path, results: Path, model: str, jobs: int, options: str) -> str:
    """Hand a refit to SLURM; the number of the job.

    Parameters
    ----------
    archive, results
        On a disk that all nodes see under the same names.
    model
        "prepared" or "tank".
    jobs
        Elements of the array: so many work at a time.
    options
        Of sbatch, as one would type them.

    Raises
    ------
    SlurmError
        When there is no `sbatch` here, or it refuses.
    StoreError
        When the results cannot be written.
    """
    log = results.resolve() / "slurm"
    try:
        log.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{log}: cannot be made ({error.strerror}); give another folder with --out") from error
    command = [
        sys.executable, "-c", RUN, "refit", str(archive.resolve()), "--out", str(results.resolve()),
        "--model", model,
    ]  # fmt: skip
    script = results.resolve() / SCRIPT
    with whole_file(script) as unfinished:
        unfinished.write_text(script_text(command, jobs, shlex.split(options), log), encoding="utf-8")
    if shutil.which("sbatch") is None:
        raise SlurmError(f"there is no sbatch here; on a machine that has SLURM: sbatch {script}")
    asked = subprocess.run(
        ["sbatch", "--parsable", str(script)], capture_output=True, text=True, timeout=60, check=False
    )
    if asked.returncode != 0:
        raise SlurmError(f"sbatch refuses: {asked.stderr.strip() or asked.stdout.strip()}; the script is {script}")
    return asked.stdout.strip().split(";")[0]
