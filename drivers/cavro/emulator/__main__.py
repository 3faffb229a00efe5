"""Run a Cavro pump's emulator: `python -m drivers.cavro.emulator --link PATH --state FILE`."""

import sys

from drivers.emulation.cable import PseudoTerminal
from drivers.emulation.process import parser, serve
from drivers.emulation.truth import TruthFile

from .board import CavroBoard
from .core import MODELS, Habits


def main() -> int:
    """Run until told to quit, or until nobody has wanted the device for long enough."""
    options = parser("drivers.cavro.emulator", "A Cavro XCalibur or XLP syringe pump on a pseudo-terminal.")
    options.add_argument("--model", choices=MODELS, default="xcalibur", help="which pump (default xcalibur)")
    options.add_argument("--speeds-interact", action="store_true", help="start and cutoff never exceed the top speed")
    options.add_argument("--speed-rounding", type=int, default=0, help="added to reported speeds (default 0)")
    options.add_argument("--repeat-flag-decides", action="store_true", help="a known number is obeyed unless flagged")
    options.add_argument("--overload-stays", action="store_true", help="Q does not clear an overload")
    options.add_argument("--address", type=int, default=1, help="set with its switch (default 1)")
    options.add_argument("--ready", action="store_true", help="it has been initialised and filled already")
    args = options.parse_args()
    try:
        state = TruthFile(args.state)
    except BlockingIOError:
        sys.stderr.write(f"{args.state}: another emulator runs on this state file\n")
        return 2
    habits = Habits(
        MODELS[args.model],
        args.speeds_interact,
        args.speed_rounding,
        args.repeat_flag_decides,
        args.overload_stays,
    )
    given = {"address": args.address, "ready": args.ready, "time_scale": args.time_scale, "seed": args.seed}
    serve(CavroBoard(state, PseudoTerminal(args.link), habits=habits, **given), args)
    state.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
