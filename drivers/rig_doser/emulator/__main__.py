"""Run the rig doser's emulator: `python -m drivers.rig_doser.emulator --link PATH --state FILE`."""

import argparse
import sys

from drivers.emulation.cable import PseudoTerminal
from drivers.emulation.process import parser, serve

from .board import RigDoserBoard
from .firmware import PROTOCOLS
from .memory import Commissioning, StateFile


def _arguments() -> argparse.Namespace:
    made = parser("drivers.rig_doser.emulator", "The rig's own doser on a pseudo-terminal: real but for the motor.")
    new = Commissioning()
    add = made.add_argument
    add("--rate", type=float, default=2000.0, help="highest speed, steps/s (default 2000)")
    add("--acceleration", type=float, default=8000.0, help="steps/s² (default 8000)")
    add("--protocol", type=int, choices=PROTOCOLS, default=1, help="version that its firmware speaks (default 1)")
    add("--serial", default=new.serial, help="commissioning of a new state file (8 characters)")
    add("--dose-cap", type=int, default=new.dose_cap, help="commissioning: most steps in one dose")
    add("--life-cap", type=int, default=new.life_cap, help="commissioning: most steps ever")
    args = made.parse_args()
    if len(args.serial.encode()) != 8 or not args.serial.isalnum() or not args.serial.isascii():
        made.error(f"--serial {args.serial}: a serial number has 8 letters and digits")
    return args


def main() -> int:
    """Run until told to quit, or until nobody has wanted the device for long enough."""
    args = _arguments()
    try:
        state = StateFile(args.state, Commissioning(args.serial, args.dose_cap, args.life_cap))
    except BlockingIOError:
        sys.stderr.write(f"{args.state}: another emulator runs on this state file\n")
        return 2
    motor = {"rate": args.rate, "acceleration": args.acceleration, "protocol": args.protocol}
    serve(RigDoserBoard(state, PseudoTerminal(args.link), **motor, time_scale=args.time_scale, seed=args.seed), args)
    state.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
