"""How far a function is that works in the background's process."""

from typing import Any

_telling: Any = None


def tell_to(telling: Any) -> None:
    """Have what `done` says sent through this end of a pipe, from now on in this process."""
    global _telling
    _telling = telling


def done(share: float) -> None:
    """So much of the function under way is done, 0 … 1; nothing happens outside of the background's process."""
    if _telling is not None:
        _telling.send(float(share))
