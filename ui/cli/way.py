"""The way from a rig file to a fitted run: what is done and what is missing, in order, each with its command."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from drivers.check import RIG, Check, typed
from tankrig.errors import StoreError, TankrigError
from ui.calibration_way import Step, calibration_steps

if TYPE_CHECKING:
    from drivers.rig import RigFile
    from tankrig.sequence import Sequence


def rig_as_typed(rig: Path | None) -> str:
    """The option that names a rig file, for commands that are to be typed; empty where none is configured."""
    return f"--rig {quote(str(rig))}" if rig else ""


def way(
    description: "RigFile", checks: Iterable[Check], rig: Path | None, sequence_file: Path | None = None
) -> list[Step]:
    """The steps of a rig, the first first.

    Parameters
    ----------
    description
        Of the rig.
    checks
        What `drivers.health.examine` has found.
    rig
        The rig file as it was given.
    sequence_file
        Sequence that is to be run.
    """
    option = rig_as_typed(rig)
    checks, by_part = list(checks), dict[str, list[Check]]()
    for check in checks:
        by_part.setdefault(check.part, []).append(check)
    steps = [_devices(by_part.get("devices", [])), _light(by_part)]
    steps += calibration_steps(description, checks).values()
    steps += [
        _passed("exposures keep to the projector's period", by_part.get("exposure", [])),
        _passed("the rig file agrees with what was measured", by_part.get("rig file", [])),
        _ink(description),
        *_sequence(description, sequence_file),
    ]
    return [
        Step(step.what, step.done, step.finding, "" if step.done else typed(step.command, option), step.wanted)
        for step in steps
    ]


def next_step(steps: Iterable[Step]) -> Step | None:
    """The first that has to be done, else the first that is wanted; the run itself comes last."""
    left = [step for step in steps if not step.done and step.command and step.wanted]
    return next((step for step in left if step.done is False), next(iter(left), None))


def _devices(checks: list[Check]) -> Step:
    what = "the devices open and answer"
    wrong = next((check for check in checks if check.passed is False), None)
    if wrong is not None:
        return Step(what, False, f"{wrong.what}: {wrong.finding}", wrong.remedy)
    opened = [check.finding for check in checks if check.what.endswith(" opens")]
    return Step(what, True, "; ".join(opened))


def _light(by_part: dict[str, list[Check]]) -> Step:
    """Clear water shows no light, which is no fault; boards and diffuser do, when the bench is calibrated."""
    what = "the camera sees the projector's light"
    checks = by_part.get("light", [])
    wrong = next((check for check in checks if check.passed is False), None)
    if wrong is not None:
        return Step(what, False, f"{wrong.what}: {wrong.finding}", wrong.remedy)
    seen = next((check for check in checks if check.passed and check.what.startswith("the camera sees")), None)
    if seen is not None:
        return Step(what, True, seen.finding)
    measured = [kind for kind in ("projector", "radiometry") if any(one.passed for one in by_part.get(kind, []))]
    if measured:
        return Step(what, True, f"it did when the {measured[0]} was calibrated")
    finding = checks[0].finding if checks else "it was not looked for"
    return Step(
        what, None, finding, "tankrig doctor again, with ink or white paper where the light falls", wanted=False
    )


def _passed(what: str, checks: list[Check]) -> Step:
    wrong = [check for check in checks if check.passed is not True]
    if not wrong:
        return Step(what, True, "; ".join(check.finding for check in checks) or "nothing speaks against it")
    first = min(wrong, key=lambda check: check.passed is None)
    return Step(what, first.passed, first.finding, first.remedy, wanted=first.passed is False)


def _ink(description: "RigFile") -> Step:
    from drivers.rig import tank_ledger

    what = "the tank's ink is known"
    resolve = f"tankrig run --resume RUN --delivered-ul X {RIG}"
    try:
        with tank_ledger(description) as ledger:
            if ledger is None:
                return Step(what, True, "no ink has been dosed yet")
            if ledger.open_dose is not None:
                return Step(what, False, "a dose was interrupted, and only a person can say what it delivered", resolve)
            volume_ul, low_ul, high_ul = ledger.tank
            filled = f" since it was filled ({ledger.filled_utc[:10]})" if ledger.filled_utc else ""
    except StoreError as error:
        return Step(what, False, *_parted(error))
    return Step(what, True, f"{volume_ul:g} µl ({low_ul:g} to {high_ul:g}){filled}")


def _sequence(description: "RigFile", sequence_file: Path | None) -> Iterator[Step]:
    """What the run itself needs, and the command that begins it."""
    run = f"tankrig run {quote(str(sequence_file)) if sequence_file else 'SEQUENCE'} {RIG}"
    what = "the sequence can be carried out"
    if sequence_file is None:
        yield Step(what, None, "which one was not said", f"{run} --dry-run")
    else:
        from drivers.rig import calibrated_bench
        from tankrig.sequence import load_sequence
        from ui.cli.run import planned

        try:
            sequence = load_sequence(sequence_file)
            plan = planned(sequence, description)
        except TankrigError as error:
            yield Step(what, False, *_parted(error))
        else:
            told = f"{plan.frames} frames, {plan.ink_ul:g} µl of ink, {plan.seconds:.0f} s"
            bench = calibrated_bench(description)
            told = "; ".join([told, *sequence.cut_off(bench.wall, bench.tank)])
            yield Step(what, True, told, f"{run} --dry-run")
            yield _models(description, sequence, sequence_file)
    yield Step("the run is fitted", None, "it fits itself while it goes on, and ends with a report", run)


def _models(description: "RigFile", sequence: "Sequence", sequence_file: Path) -> Step:
    """Those that can be foreseen before there is any ink; a run prepares them by itself, and then waits for them."""
    from drivers.rig import calibrated_bench
    from tankrig.live.photograph_plan import PhotographPlan
    from tankrig.live.preparing import foreseen, is_kept, phases_prepared
    from ui.cli.prepare import BY_PATHS

    bench = calibrated_bench(description)
    plan = PhotographPlan.of(bench, sequence, list(sequence.drawn(bench.wall).values()))
    phases = phases_prepared(plan)
    foreseeable = foreseen(list(plan.scenes.values()), plan.doses_ml, plan.ink) if phases else []
    wanted = [(scene, box) for scenes, box in foreseeable for scene in scenes]
    kept = sum(is_kept(*one, phases or "hg") for one in wanted)
    ink = "" if plan.ink else "; ink = { … } in the sequence says which more will be wanted"
    if phases is None:
        return Step("models for the live fit are prepared", None, BY_PATHS, "", wanted=False)
    finding = f"{kept} of {len(wanted)} that can be foreseen are kept; the run prepares the others first{ink}"
    command = f"tankrig prepare --sequence {quote(str(sequence_file))} {RIG}"
    return Step("models for the live fit are prepared", kept == len(wanted) or None, finding, command, wanted=False)


def _parted(error: TankrigError) -> tuple[str, str]:
    finding, _, remedy = str(error).rpartition("; ")
    return (finding, remedy) if finding else (remedy, "")
