"""Phase functions of any kind as plain fields, and back: what a run's journal keeps of a fit."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from tankrig.errors import SceneError
from tankrig.scene.free_phase import FreePhase, Shaped
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import (
    FournierForand,
    HenyeyGreenstein,
    Mixture,
    ReynoldsMcCormick,
    Tabulated,
    TwoTerm,
)
from tankrig.scene.phase_table import PhaseFunction

_KINDS: dict[str, Callable[..., PhaseFunction]] = {
    "henyey-greenstein": HenyeyGreenstein, "two-term": TwoTerm, "reynolds-mccormick": ReynoldsMcCormick,
    "fournier-forand": FournierForand, "mie": Mie, "table": Tabulated, "free": FreePhase, "mixture": Mixture,
    "shaped": Shaped,
}  # fmt: skip


def phase_fields(phase: PhaseFunction) -> dict[str, Any]:
    """Kind and numbers, of which `phase_from_fields` makes it again.

    Examples
    --------
    >>> phase_fields(TwoTerm(0.9, -0.3, 0.95))
    {'kind': 'two-term', 'forward': 0.9, 'backward': -0.3, 'share': 0.95}
    """
    numbers = {one.name: getattr(phase, one.name) for one in fields(phase) if one.name != "kind"}  # type: ignore[arg-type]
    return {"kind": phase.kind} | {name: _plain(value) for name, value in numbers.items()}


def phase_from_fields(table: Mapping[str, Any]) -> PhaseFunction:
    """The phase function of some fields.

    Raises
    ------
    SceneError
        When its kind is unknown to this version, or its numbers cannot be.

    Examples
    --------
    >>> phase_from_fields({"kind": "mixture", "parts": [{"kind": "henyey-greenstein", "g": 0.5}], "shares": [1.0]})
    Mixture(parts=(HenyeyGreenstein(g=0.5),), shares=(1.0,))
    """
    numbers = {name: _solid(value) for name, value in table.items() if name != "kind"}
    kind = _KINDS.get(str(table.get("kind")))
    if kind is None:
        raise SceneError(
            f'phase of kind "{table.get("kind")}" is unknown to this version; known are {", ".join(_KINDS)}'
        )
    try:
        return kind(**numbers)
    except TypeError as error:
        raise SceneError(f'phase of kind "{table["kind"]}" lacks a number or has one too many: {error}') from error


def _plain(value: Any) -> Any:
    if isinstance(value, PhaseFunction):
        return phase_fields(value)
    return [_plain(one) for one in value] if isinstance(value, tuple) else value


def _solid(value: Any) -> Any:
    if isinstance(value, Mapping):
        return phase_from_fields(value)
    return tuple(_solid(one) for one in value) if isinstance(value, list | tuple) else value
