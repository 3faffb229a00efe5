"""Benches from lens cap to report by commands alone, one after the other or two at a time, and how true each comes out.

python tests/bench_trials.py --seeds 101-110 --out trials

Prints a line for each bench as soon as it is done, and at the end the figures asked for of all of them, and by how much
what was calibrated is off. A folder that holds finished benches is gone on with: they are read, the others are walked,
and what was interrupted goes on.
"""

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Any

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).parents[1]))

import tankrig
from tests.bench_by_hand import typed

HOURS_S = 3.0 * 3600.0
CLOSE_SIGMA_S, CLOSE_G, CLOSE_SD, MOST_SD = 0.02, 0.02, 2.0, 3.5
SOON_S, ALL_S = 10.0, 30.0


@dataclass(frozen=True)
class Trial:
    """What came of a bench.

    Parameters
    ----------
    seed
        That it was drawn from.
    sigma_s, g
        (off, stated standard deviation): σs per ml as a share of the truth, g as it is.
    dose_s, whole_s
        Of each dose, from its last frame to the first fit that is made after it, and to that of all of its patterns by
        whole models, s; NaN where there was none while it ran.
    all_s
        From the last frame of all to the series of all doses, s; NaN likewise.
    wall_s, cpu_s
        What the commands took together.
    measured
        Of each quantity that was calibrated, by how many stated standard deviations it is off.
    error
        What ended it, if anything did.
    """

    seed: int
    sigma_s: tuple[float, float] = (float("nan"), float("nan"))
    g: tuple[float, float] = (float("nan"), float("nan"))
    dose_s: tuple[float, ...] = ()
    whole_s: tuple[float, ...] = ()
    all_s: float = float("nan")
    wall_s: float = float("nan")
    cpu_s: float = float("nan")
    measured: Mapping[str, float] = field(default_factory=dict)
    error: str = ""

    @property
    def sds(self) -> tuple[float, float]:
        """By how many stated standard deviations σs and g are off."""
        return self.sigma_s[0] / self.sigma_s[1], self.g[0] / self.g[1]

    @property
    def close(self) -> tuple[bool, bool]:
        """Whether σs and g are as near as was asked for."""
        z_s, z_g = self.sds
        return (
            abs(self.sigma_s[0]) <= CLOSE_SIGMA_S or abs(z_s) <= CLOSE_SD,
            abs(self.g[0]) <= CLOSE_G or abs(z_g) <= CLOSE_SD,
        )

    def __str__(self) -> str:
        if self.error:
            return f"{self.seed:>6}  {self.error}"
        (off_s, _), (off_g, _), (z_s, z_g), (close_s, close_g) = self.sigma_s, self.g, self.sds, self.close
        doses, whole = (" ".join(f"{seconds:.0f}" for seconds in one) for one in (self.dose_s, self.whole_s))
        return (
            f"{self.seed:>6}  σs {100 * off_s:+6.2f} % {z_s:+5.1f} sd {'  ' if close_s else '✗ '} "
            f"g {off_g:+.4f} {z_g:+5.1f} sd {'  ' if close_g else '✗ '} "
            f"doses first {doses}, whole {whole}, all {self.all_s:.0f} s after the last frame; "
            f"{self.wall_s:.0f} s, {self.cpu_s:.0f} s of CPU"
        )


def walked(seed: int, folder: Path, optics: Sequence[str] = ()) -> Trial:
    """Walk a bench, or what is left of it, and read what it found."""
    here, kept = folder / f"bench-{seed}", folder / f"bench-{seed}.json"
    if not kept.exists():
        words = ["demo", "--bench", "--out", str(here.absolute()), "--json"]
        if not here.exists():
            words += ["--seed", str(seed), *optics]
        began = time.perf_counter()
        done = typed(words, folder, HOURS_S, TANKRIG_CACHE=str((folder / "cache").absolute()))
        (folder / f"bench-{seed}.log").write_text(done.stderr, encoding="utf-8")
        if done.returncode:
            return Trial(seed, error=f"exit status {done.returncode} after {time.perf_counter() - began:.0f} s: "
                         f"{done.stderr.strip().splitlines()[-1]}")  # fmt: skip
        kept.write_text(done.stdout, encoding="utf-8")
    return _trial(seed, json.loads(kept.read_text(encoding="utf-8")), here / "run")


def _trial(seed: int, found: dict[str, Any], run: Path) -> Trial:
    if "ink_per_ml" not in found:
        return Trial(seed, error="its doses were not fitted together")
    ink, truth, sd = found["ink_per_ml"], found["truth_per_ml"], found["ink_sd"]
    dose_s, whole_s, all_s = _times(run)
    return Trial(
        seed,
        (ink["sigma_s"] / truth["sigma_s"] - 1.0, sd[1] / truth["sigma_s"]),
        (ink["g"] - truth["g"], sd[2]),
        dose_s,
        whole_s,
        all_s,
        sum(part["wall_s"] for part in found["parts"]),
        sum(part["cpu_s"] for part in found["parts"]),
        {one["what"]: (one["measured"] - one["truth"]) / one["sd"] for one in found["geometry"] if one["sd"]},
    )


def _times(path: Path) -> tuple[tuple[float, ...], tuple[float, ...], float]:
    """See `Trial`; by the journal, as long as the run lasted."""
    run = tankrig.open_run(path)
    last: dict[float, int] = {}
    for event in run.events("frame"):
        last[round(run.conditions[event["index"]].tank.volume_ul / 1000.0, 4)] = event.moment.mono_ns
    fits = [event for event in run.fits if event.get("fit") in ("dose", "series")]
    dose_s, whole_s = [], []
    for dose_ml, ended_ns in sorted(last.items()):
        after = [
            event
            for event in fits
            if event.get("fit") == "dose" and abs(event["dose_ml"] - dose_ml) < 1e-4 and event.moment.mono_ns > ended_ns
        ]
        most = max((len(event["patterns"]) for event in after), default=0)
        whole = [event for event in after if len(event["patterns"]) == most and not event.get("first")]
        for seconds, some in ((dose_s, after), (whole_s, whole)):
            first_ns = min((event.moment.mono_ns for event in some), default=float("nan"))
            seconds.append((first_ns - ended_ns) / 1e9)
    newest_ns = max(last.values())
    series = [
        event.moment.mono_ns for event in fits if event.get("fit") == "series" and event.moment.mono_ns > newest_ns
    ]
    return tuple(dose_s), tuple(whole_s), (max(series) - newest_ns) / 1e9 if series else float("nan")


def walk_all(seeds: list[int], folder: Path, processes: int, optics: Sequence[str] = ()) -> Iterator[Trial]:
    """Trials as they are done."""
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(processes) as pool:
        for done in as_completed([pool.submit(walked, seed, folder, optics) for seed in seeds]):
            yield done.result()


def summary(trials: list[Trial]) -> str:
    """The figures asked for beside those found."""
    done = [one for one in trials if not one.error]
    close = [sum(one.close[k] for one in done) for k in range(2)]
    both = sum(all(one.close) for one in done)
    worst = max((abs(z) for one in done for z in one.sds), default=float("nan"))
    soon = sum(seconds <= SOON_S for one in done for seconds in one.dose_s)
    doses = sum(len(one.dose_s) for one in done)
    at_once = sum(one.all_s <= ALL_S for one in done)
    return (
        f"{len(done)} of {len(trials)} benches came to their end; within 2 % or 2 sd (σs), .02 or 2 sd (g): "
        f"σs {close[0]}, g {close[1]}, both {both} (asked: 9 of 10); worst {worst:.1f} sd (asked: none beyond "
        f"{MOST_SD}); {soon} of {doses} doses fitted within {SOON_S:.0f} s of their last frame, all of them within "
        f"{ALL_S:.0f} s in {at_once} of {len(done)} runs"
    )


def of_calibrations(trials: list[Trial]) -> list[str]:
    """What was calibrated, pooled over benches, a line each."""
    by_name: dict[str, list[float]] = {}
    for one in trials:
        for name, off in one.measured.items():
            by_name.setdefault(name, []).append(off)
    return [
        f"{name:<28} rms {math.sqrt(fmean(z * z for z in found)):4.2f} sd, mean {fmean(found):+5.2f}, "
        f"worst {max(map(abs, found)):3.1f} ({len(found)} benches)"
        for name, found in by_name.items()
    ]


def seeds_in(text: str) -> list[int]:
    """Numbers such as 3,5,101-110.

    >>> seeds_in("3,5,7-9")
    [3, 5, 7, 8, 9]
    """
    found: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


def main() -> int:
    """Walk them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=seeds_in, required=True, help="such as 101-110")
    parser.add_argument("--out", type=Path, required=True, help="folder of the benches")
    parser.add_argument("--processes", type=int, default=1, help="benches at a time")
    parser.add_argument("--wide-lens", action="append_const", dest="optics", const="--wide-lens", help="as of demo")
    parser.add_argument("--walls", action="append_const", dest="optics", const="--walls", help="as of demo")
    parser.add_argument("--emulsion", action="append_const", dest="optics", const="--emulsion", help="as of demo")
    given = parser.parse_args()
    trials = []
    for trial in walk_all(given.seeds, given.out, given.processes, given.optics or ()):
        trials.append(trial)
        print(trial, flush=True)
    print(summary(trials))
    print(*of_calibrations(trials), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
