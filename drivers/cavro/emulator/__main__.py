"""Run a Cavro pump's emulator: `python -m drivers.cavro.emulator --link PATH --state FILE`."""

import sys

from drivers.emulation.cable import PseudoTerminal
from drivers.emulation.process import parser, serve
from drivers.emulation.truth import TruthFile

from .board import CavroBoard


def main() -> int:
    """Run until told to quit, or until nobody has wanted the device for long enough."""
    options = parser("drivers.cavro.emulator", "A Cavro XCalibur syringe pump on a pseudo-terminal.")
    options.add_argument("--address", type=int, default=1, help="set with its switch (default 1)")
    options.add_argument("--ready", action="store_true", help="it has been initialised and filled already")
    args = options.parse_args()
    try:
        state = TruthFile(args.state)
    except BlockingIOError:
        sys.stderr.write(f"{args.state}: another emulator runs on this state file\n")
        return 2
    given = {"address": args.address, "ready": args.ready, "time_scale": args.time_scale, "seed": args.seed}
    serve(CavroBoard(state, PseudoTerminal(args.link), **given), args)
    state.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
