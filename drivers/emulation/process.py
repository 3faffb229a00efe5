"""A stand-in as a process of its own, with a control socket for faults at run time."""

import argparse
import contextlib
import json
import selectors
import signal
import socket
import threading
from pathlib import Path
from typing import NoReturn, TextIO

from .board import EmulatedBoard
from .faults import Faults

EPILOG = """\
Control: connect to the socket and write one JSON object per line; each is answered by one, with the truth.
  {"faults": {"lose": 0.01, "stall_after": 100}}   set faults (all of them: firmware_notes/rig_doser.md)
  {"do": "reset"}                                  or unplug, plug, forget, quit
  {}                                               ask only
"""


def parser(module: str, description: str) -> argparse.ArgumentParser:
    """The options that every stand-in has."""
    made = argparse.ArgumentParser(
        prog=f"python -m {module}",
        description=description,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = made.add_argument
    add("--link", type=Path, required=True, help="symbolic link to make to the device")
    add("--state", type=Path, required=True, help="file that is the device's memory and the truth; made if missing")
    add("--control", type=Path, help="socket for faults at run time")
    add("--time-scale", type=float, default=1.0, help="all times are multiplied by this (default 1)")
    add("--faults", type=_faults, default={}, help="JSON object of the faults in force from the start")
    add("--seed", type=int, default=0, help="of the faults (default 0)")
    add("--linger-s", type=float, default=0.0, help="quit when no one has had the device open for so long; 0: never")
    return made


def serve(board: EmulatedBoard, args: argparse.Namespace) -> None:
    """Run until told to quit, or until nobody has wanted the device for long enough."""
    signal.signal(signal.SIGTERM, lambda *_: board.quit())
    board.command({"faults": args.faults})
    if args.control:
        threading.Thread(target=_serve, args=(board, args.control), daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        while not board.quitting:
            board.live()
            if 0 < args.linger_s < board.idle_s:
                board.quit()
    board.unplug()
    if args.control:
        args.control.unlink(missing_ok=True)


def _faults(text: str) -> dict[str, object]:
    faults: dict[str, object] = json.loads(text)
    try:
        Faults(**faults)  # type: ignore[arg-type]
    except TypeError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return faults


def _serve(board: EmulatedBoard, control: Path) -> NoReturn:
    """Answer the control socket for as long as the process lives."""
    control.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX) as server, selectors.DefaultSelector() as selector:
        server.bind(str(control))
        server.listen()
        selector.register(server, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fileobj is server:
                    connection, _ = server.accept()
                    selector.register(connection, selectors.EVENT_READ, connection.makefile("rw"))
                elif not _converse(board, key.data):
                    selector.unregister(key.fileobj)


def _converse(board: EmulatedBoard, stream: TextIO) -> bool:
    """Answer one line; False once the other side is gone."""
    with contextlib.suppress(OSError):
        if line := stream.readline():
            stream.write(json.dumps(_answer(board, line)) + "\n")
            stream.flush()
            return True
    with contextlib.suppress(OSError):
        stream.close()
    return False


def _answer(board: EmulatedBoard, line: str) -> dict[str, object]:
    try:
        return board.command(json.loads(line))
    except (ValueError, TypeError, AttributeError) as error:
        return {"error": str(error)}
