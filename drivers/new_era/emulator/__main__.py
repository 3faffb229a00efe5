"""Run a New Era pump's emulator: `python -m drivers.new_era.emulator --link PATH --state FILE`."""

import sys

from drivers.emulation.cable import PseudoTerminal
from drivers.emulation.process import parser, serve
from drivers.emulation.truth import TruthFile

from .board import NewEraBoard
from .core import Habits, Syringe


def main() -> int:
    """Run until told to quit, or until nobody has wanted the device for long enough."""
    options = parser("drivers.new_era.emulator", "A New Era NE-1000 syringe pump on a pseudo-terminal.")
    options.add_argument("--steps-per-ul", type=float, default=20.0, help="motor steps that push out 1 µl (default 20)")
    options.add_argument("--true-diameter-mm", type=float, default=12.0, help="of the syringe in it (default 12)")
    options.add_argument("--cuts-digits", action="store_true", help="its display cuts digits off instead of rounding")
    options.add_argument("--counter-survives", action="store_true", help="its counter survives the loss of power")
    options.add_argument("--power-failure", action="store_true", help="new state file: power failure mode is on")
    options.add_argument("--no-power-failure-command", action="store_true", help="it does not know PF")
    options.add_argument("--ignored-first", type=int, default=0, help="commands lost after power-up (default 0)")
    options.add_argument("--drops-damaged", action="store_true", help="damaged packets get no answer")
    options.add_argument("--checks-rates", action="store_true", help="rates beyond the motor's are refused")
    args = options.parse_args()
    try:
        state = TruthFile(args.state)
    except BlockingIOError:
        sys.stderr.write(f"{args.state}: another emulator runs on this state file\n")
        return 2
    board = NewEraBoard(
        state,
        PseudoTerminal(args.link),
        syringe=Syringe(args.steps_per_ul, args.true_diameter_mm),
        nearest=not args.cuts_digits,
        counter_survives=args.counter_survives,
        habits=Habits(
            power_failure=args.power_failure,
            knows_power_failure=not args.no_power_failure_command,
            ignored_first=args.ignored_first,
            answers_damaged=not args.drops_damaged,
            checks_rates=args.checks_rates,
        ),
        time_scale=args.time_scale,
        seed=args.seed,
    )
    serve(board, args)
    state.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
