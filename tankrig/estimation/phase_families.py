"""Families of phase functions, as a fit searches them: coordinates in which every member is an ordinary point."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.scene.free_phase import FORWARD_DEG, SHAPES, FreePhase, shapes_at
from tankrig.scene.mie import Mie
from tankrig.scene.phase_functions import FournierForand, HenyeyGreenstein, ReynoldsMcCormick, TwoTerm, phase_function
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

DIAMETER, INDEX, SPREAD_BY = 0.1, 0.003, 1.0
"""Standard deviations of what a label says: of the diameter (of itself), of the particles' index, and of the logarithm
of the spread of the diameters."""
NARROWEST, WIDEST_SPREAD = 0.005, 0.5
"""Spread of diameters: that of the best beads, and the largest that is searched."""
USUAL_G = (0.5, 0.8, 0.93)
"""Asymmetries that searches begin from besides Henyey–Greenstein's, which other phase functions lead astray."""
DIAMETER_STEP, FURTHEST = 0.02, 2.5
"""Step between diameters that a search begins from, as a share, and standard deviations that it goes from the label's:
Mie's p at a right angle goes up and down within some per cent of the diameter (beads of .5 to 2 µm)."""
PLACES = np.cos(
    np.radians(np.exp(np.linspace(math.log(FORWARD_DEG), math.log(180.0 + FORWARD_DEG), 100)) - FORWARD_DEG)
)
"""Cosines at which phase functions are compared with free ones, as dense as the shapes want them."""
CONE_DEG = 5.0
"""What turns by less stays in its beam, and passes for light that was not scattered: how much a liquid scatters there
no image tells, only how smooth p is expected to be. Natural waters scatter half of all light so."""
RIDGE = 1e-3
"""Keeps shapes finite that a curve says nothing about."""


@dataclass(frozen=True)
class Family:
    """Phase functions that a fit searches.

    Parameters
    ----------
    name
        As `estimate` has it.
    names
        (k,) of the coordinates.
    low, high
        (k,) that are searched.
    longest_step
        (k,) further than this no linearisation is trusted.
    difference
        (k,) step of derivatives.
    usual
        (k,) how far coordinates usually are from those that are most like Henyey–Greenstein: standard deviations.
    member
        Phase function at coordinates.
    coordinates
        Those of a phase function of the family.
    like
        Coordinates of the member that is most like Henyey–Greenstein with a mean cosine.
    expected
        (k,) True for coordinates that are expected to be 0 ± 1.
    others
        Coordinates of other places where a search begins, given those of its first.
    ladder
        Values of the first coordinate between which images go up and down: a search looks at all of them.
    finer
        Whether members have finer structure than a free phase function.
    told_from_deg
        Angle from which on members are like free phase functions, where closer to straight on they have a pole.
    describe
        What a member is described by, in its own units.
    kind
        `PhaseFunction.kind` of the members; empty: the name.
    """

    name: str
    names: tuple[str, ...]
    low: Array
    high: Array
    longest_step: Array
    difference: Array
    usual: Array
    member: Callable[[Array], PhaseFunction]
    coordinates: Callable[[Any], Array]
    like: Callable[[float], Array]
    expected: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    others: Callable[[Array], Sequence[Array]] = lambda _: ()
    ladder: Array = field(default_factory=lambda: np.zeros(0))
    finer: bool = False
    told_from_deg: float = 0.0
    describe: Callable[[Any], dict[str, float]] = field(default_factory=lambda: _numbers_of)
    kind: str = ""

    @property
    def is_free(self) -> bool:
        """Whether it holds any smooth phase function."""
        return self.name == FreePhase.kind

    def has(self, phase: PhaseFunction | None) -> bool:
        """Whether a phase function is one of its kind."""
        return phase is not None and phase.kind == (self.kind or self.name)

    def phase(self, coordinates: Array) -> PhaseFunction:
        """The member at coordinates, which are moved into what is searched."""
        return self.member(np.clip(coordinates, self.low, self.high))

    def parameters(self, coordinates: Array) -> dict[str, float]:
        """What the member is described by, in its own units; nothing where its numbers mean nothing by themselves."""
        return self.describe(self.phase(coordinates))


def _numbers_of(member: PhaseFunction) -> dict[str, float]:
    if isinstance(member, FreePhase):
        return {}
    found = {one.name: getattr(member, one.name) for one in fields(member)}  # type: ignore[arg-type]
    return {name: value for name, value in found.items() if isinstance(value, float)}


def _logit(share: float) -> float:
    return math.log(share / (1.0 - share))


def _share(logit: float) -> float:
    return 1.0 / (1.0 + math.exp(-logit))


def henyey_greenstein() -> Family:
    """atanh g."""
    return Family(
        "hg", ("atanh g",), np.array([-2.0]), np.array([3.0]), np.array([0.4]), np.array([0.02]), np.ones(1),
        lambda at: HenyeyGreenstein(math.tanh(at[0])), lambda one: np.array([math.atanh(one.g)]),
        lambda g: np.array([math.atanh(min(max(g, -0.95), 0.98))]),
    )  # fmt: skip


def two_term() -> Family:
    """A forward and a backward lobe: atanh of both asymmetries, and logit of the forward one's share."""
    return Family(
        "two-term", ("atanh forward", "atanh backward", "logit share"),
        np.array([0.01, -2.0, 0.0]), np.array([3.0, -0.01, 7.0]),
        np.array([0.4, 0.4, 1.0]), np.array([0.02, 0.03, 0.05]),
        np.array([1.0, 0.4, 2.0]),
        lambda at: TwoTerm(math.tanh(at[0]), math.tanh(at[1]), _share(at[2])),
        lambda one: np.array([math.atanh(one.forward), math.atanh(one.backward), _logit(min(one.share, 0.9999))]),
        lambda g: np.array([math.atanh(min(max(g, 0.02), 0.98)), -0.4, 4.0]),
        others=lambda _: [np.array([math.atanh(g), -0.3, 2.5]) for g in USUAL_G],
    )  # fmt: skip


def reynolds_mccormick() -> Family:
    """Gegenbauer's kernel: atanh g and the logarithm of α + 1/2."""

    def like(g: float) -> Array:
        return np.array([math.atanh(min(max(g, 0.02), 0.98)), 0.0])

    return Family(
        "reynolds-mccormick", ("atanh g", "log(alpha + 1/2)"),
        np.array([0.01, -3.0]), np.array([3.0, 2.5]), np.array([0.4, 0.5]), np.array([0.02, 0.03]),
        np.array([1.0, 0.7]),
        lambda at: ReynoldsMcCormick(math.tanh(at[0]), math.exp(at[1]) - 0.5),
        lambda one: np.array([math.atanh(one.g), math.log(one.alpha + 0.5)]), like,
        others=lambda _: [np.array([math.atanh(g), 0.0]) for g in USUAL_G],
    )  # fmt: skip


def fournier_forand() -> Family:
    """Particles of natural waters: logarithm of index − 1, and logit of (slope − 3)/2."""
    return Family(
        "fournier-forand", ("log(index - 1)", "logit slope"),
        np.array([math.log(0.01), -3.0]), np.array([math.log(0.35), 3.0]), np.array([0.5, 0.5]), np.array([0.03, 0.03]),
        np.array([0.7, 1.0]),
        lambda at: FournierForand(1.0 + math.exp(at[0]), 3.0 + 2.0 * _share(at[1])),
        lambda one: np.array([math.log(one.index - 1.0), _logit(0.5 * (one.slope - 3.0))]),
        lambda g: np.array([math.log(min(max(0.35 * (1.0 - g), 0.02), 0.3)), _logit(0.3)]),
        others=lambda at: [at + np.array([0.0, 1.0]), at + np.array([0.5, -1.0])], told_from_deg=CONE_DEG,
    )  # fmt: skip


def free() -> Family:
    """Any smooth phase function: atanh of the asymmetry that it starts from, and amplitudes of shapes of ln p."""
    return Family(
        "free", ("atanh base_g", *(f"shape {k}" for k in range(1, SHAPES + 1))),
        np.array([-1.8, *[-5.0] * SHAPES]), np.array([2.8, *[5.0] * SHAPES]), np.array([0.3, *[1.5] * SHAPES]),
        np.array([0.02, *[0.1] * SHAPES]), np.ones(1 + SHAPES),
        lambda at: FreePhase(math.tanh(at[0]), tuple(at[1:].tolist())),
        lambda one: np.array([math.atanh(one.base_g), *one.amplitudes, *[0.0] * (SHAPES - len(one.amplitudes))]),
        lambda g: np.array([math.atanh(min(max(g, -0.9), 0.98)), *[0.0] * SHAPES]),
        np.array([False, *[True] * SHAPES]),
    )  # fmt: skip


def as_free(phase: PhaseFunction, base: float | None = None) -> Array:
    """Coordinates of the free phase function that is most like another one.

    Parameters
    ----------
    phase
        Any.
    base
        atanh of the asymmetry that it starts from; None: that of the mean cosine.

    Examples
    --------
    >>> found = as_free(ReynoldsMcCormick(0.7, 0.8))
    >>> near = free().phase(found)
    >>> bool(abs(math.log(near.at(0.0) / ReynoldsMcCormick(0.7, 0.8).at(0.0))) < 0.01)
    True
    """
    start = float(free().like(phase.mean_cosine)[0]) if base is None else base
    return np.concatenate([[start], amplitudes_of(phase.at(PLACES), start)])


def amplitudes_of(density: Array, base: float, from_deg: float = 0.0) -> Array:
    """(…, shapes) amplitudes of the free phase functions that are most like densities, up to a factor, at `PLACES`.

    Parameters
    ----------
    density
        (…, n) p.
    base
        atanh of the asymmetry that it starts from.
    from_deg
        Angle from which on they are to be alike.
    """
    log = np.log(np.maximum(density / phase_function(PLACES, math.tanh(base)), 1e-300))
    return np.asarray(log @ _nearest_shapes(from_deg).T)


@lru_cache(maxsize=2)
def _nearest_shapes(from_deg: float) -> Array:
    """(shapes, n) times ln p over the base's at `PLACES`, the amplitudes that are nearest."""
    counts = (math.cos(math.radians(from_deg)) + 1e-9 >= PLACES).astype(float)
    columns = np.vstack([shapes_at(PLACES), np.ones(PLACES.size)]).T * counts[:, None]
    return np.asarray(np.linalg.solve(columns.T @ columns + RIDGE * np.eye(columns.shape[1]), columns.T)[:-1])


def labelled(label: Mie) -> Family:
    """Spheres as a label says they are: their diameter to 10 %, their index to .003, the spread of sizes by a factor.

    Parameters
    ----------
    label
        What it says; a spread below `NARROWEST` is taken for that.
    """
    spread = min(max(label.spread, NARROWEST), WIDEST_SPREAD)
    room = (math.log(NARROWEST / spread), math.log(WIDEST_SPREAD / spread))

    def member(at: Array) -> Mie:
        return replace(
            label, diameter_um=label.diameter_um * math.exp(DIAMETER * float(at[0])),
            particle_index=label.particle_index + INDEX * float(at[1]),
            spread=spread * math.exp(SPREAD_BY * float(at[2])),
        )  # fmt: skip

    def coordinates(one: Mie) -> Array:
        return np.array([
            math.log(one.diameter_um / label.diameter_um) / DIAMETER,
            (one.particle_index - label.particle_index) / INDEX,
            math.log(max(one.spread, NARROWEST) / spread) / SPREAD_BY,
        ])  # fmt: skip

    return Family(
        "mie", ("diameter off", "index off", "log spread off"),
        np.array([-FURTHEST, -4.0, room[0] / SPREAD_BY]), np.array([FURTHEST, 4.0, room[1] / SPREAD_BY]),
        np.array([0.2, 1.0, 1.0]), np.array([0.02, 0.1, 0.1]), np.ones(3), member, coordinates, lambda _: np.zeros(3),
        np.ones(3, bool), ladder=_rungs(),
    )  # fmt: skip


def _rungs() -> Array:
    count = round(FURTHEST * DIAMETER / DIAMETER_STEP)
    return np.asarray(DIAMETER_STEP / DIAMETER * np.arange(-count, count + 1), float)


def fixed(phase: PhaseFunction) -> Family:
    """One phase function, which is not searched."""
    none = np.zeros(0)
    return Family(phase.kind, (), none, none, none, none, none, lambda _: phase, lambda _: none, lambda _: none)


FAMILIES: Mapping[str, Callable[[], Family]] = {
    "two-term": two_term,
    "reynolds-mccormick": reynolds_mccormick,
    "fournier-forand": fournier_forand,
    "free": free,
}
"""Those that need no label."""


def family_of(asked: "str | PhaseFunction", described: PhaseFunction | None) -> Family | None:
    """What a fit searches; None for Henyey–Greenstein.

    Parameters
    ----------
    asked
        A name; or a phase function: `Mie` is what a label says, any other is taken as it is.
    described
        The scene's phase function, which "mie" and "table" mean.

    Raises
    ------
    SceneError
        When the name is unknown, or means a phase function that the scene does not describe.
    """
    if isinstance(asked, Mie):
        return labelled(asked)
    if isinstance(asked, HenyeyGreenstein):
        return fixed(asked)
    if isinstance(asked, PhaseFunction):
        return fixed(asked)
    if asked == "hg":
        return None
    if asked in FAMILIES:
        return FAMILIES[asked]()
    if asked in ("mie", "table"):
        if described is None or described.kind != asked:
            raise SceneError(
                f'phase = "{asked}" means the one that the scene describes, which has none of that kind; '
                f'give medium.phase = {{ kind = "{asked}", … }}, or the phase function itself'
            )
        return labelled(described) if isinstance(described, Mie) else fixed(described)
    known = ", ".join(["hg", *FAMILIES, "mie", "table", "any"])
    raise SceneError(f'phase = "{asked}" is unknown; use one of {known}, or a phase function')
