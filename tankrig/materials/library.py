"""The library of reference liquids: what a name means, and the names that are nearest to one that means nothing."""

import difflib
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from tankrig.checked_toml import checked, read_toml
from tankrig.errors import SceneError
from tankrig.materials.curve import Curve
from tankrig.materials.particles import Beads
from tankrig.scene.checks import CLOSED

_FILE = Path(__file__).with_name("library.toml")
_BEADS = re.compile(r"polystyrene-(\d+(?:\.\d+)?)$")
SIZES_UM = (0.2, 0.5, 1.0, 2.0)
"""Of the beads that are listed; any other diameter has a name too."""


@dataclass(frozen=True)
class Shape:
    """Where a phase function is from that is no bead's.

    Parameters
    ----------
    kind
        "rayleigh": p ∝ 1 + `asymmetry` cos² θ; "droplets": of a fat emulsion with the material's g.
    source
        Who says so.
    """

    __pydantic_config__ = CLOSED
    kind: Literal["rayleigh", "droplets"]
    source: str
    asymmetry: float = 1.0


@dataclass(frozen=True)
class Material:
    """A liquid and what is published of it.

    Parameters
    ----------
    title
        For people.
    note
        What they should know before they use it.
    name
        By which it is asked for.
    sigma_s, sigma_a, g, reduced
        Of the undiluted liquid: 1/mm, the mean cosine, and σs(1−g) in 1/mm; None where nobody says.
    phase
        Its phase function; None: Henyey–Greenstein with g, for want of a better one.
    beads
        Whose scattering is calculated, in place of all of these.
    """

    __pydantic_config__ = CLOSED
    title: str
    note: str
    name: str = ""
    sigma_s: Curve | None = None
    sigma_a: Curve | None = None
    g: Curve | None = None
    reduced: Curve | None = None
    phase: Shape | None = None
    beads: Beads | None = None

    @property
    def sources(self) -> dict[str, str]:
        """Whose each number is, by what it is."""
        if self.beads is not None:
            index, water = self.beads.index, self.beads.water_index
            found = {"n of the beads": index.source, "n of water": water.source, "label": self.beads.labels}
            return {**found, "σs, p": "calculated: Mie"}
        curves = {"σs": self.sigma_s, "σa": self.sigma_a, "g": self.g, "σs(1−g)": self.reduced}
        found = {name: one.source for name, one in curves.items() if one is not None}
        return found | ({"p": self.phase.source} if self.phase else {})

    @property
    def range_nm(self) -> tuple[float, float] | None:
        """Wavelengths at which all is known that is needed to dose it, or σs(1−g) where nobody says more; None: nothing
        is known at any."""
        needed: tuple[Curve | None, ...] = (self.sigma_s, self.sigma_a, self.g)
        if self.beads is not None:
            needed = (self.beads.index, self.beads.water_index)
        elif self.sigma_s is None:
            needed = (self.reduced,)
        ranges = [one.range_nm for one in needed if one is not None and one.range_nm is not None]
        if not ranges:
            return None
        return max(low for low, _ in ranges), min(high for _, high in ranges)

    def require_known_at(self, wavelength_nm: float) -> None:
        """Refuse a wavelength for which not all that is needed of the liquid is published.

        Raises
        ------
        SceneError
            With the wavelengths that there are.

        Examples
        --------
        >>> material("milk-whole").require_known_at(633.0)
        Traceback (most recent call last):
        tankrig.errors.SceneError: milk-whole: is published from 460 to 620 nm, not at 633 nm; give a wavelength there
        """
        if self.range_nm is None:
            return
        low, high = self.range_nm
        if not low <= wavelength_nm <= high:
            raise SceneError(
                f"{self.name}: is published from {low:g} to {high:g} nm, not at {wavelength_nm:g} nm; give a "
                "wavelength there"
            )

    def labelled(self, label: dict[str, tuple[float, float | None]]) -> "Material":
        """With what the label of one's own bottle says: value and standard deviation by "diameter_um", "solids", ….

        Raises
        ------
        SceneError
            When it is no bead, or the label says what is not asked.
        """
        if not label:
            return self
        if self.beads is None:
            raise SceneError(f'"{self.name}" has no label to be read; only beads have, such as polystyrene-1.0')
        beads = self.beads
        for key, (value, sd) in label.items():
            if key == "spread":
                beads = replace(beads, spread=value)
            elif key == "diameter_um":
                beads = replace(beads, diameter_um=value, diameter_relative_sd=_share(sd, value, 0.01))
            elif key == "solids":
                beads = replace(beads, solids=value, solids_relative_sd=_share(sd, value, 0.02))
            else:
                raise SceneError(f'"{key}" is on no label of beads; give diameter_um, solids (g/ml) or spread')
        return replace(self, beads=replace(beads, labels="label as given"))


def _share(sd: float | None, value: float, usual: float) -> float:
    return usual if sd is None else sd / value


@lru_cache(maxsize=1)
def _read() -> dict[str, Material]:
    table: dict[str, Any] = read_toml(_FILE, "the library of materials", SceneError)
    return {
        name: replace(checked(Material, one, f"{_FILE.name}: {name}", SceneError), name=name)
        for name, one in table.items()
    }


def materials() -> list[Material]:
    """All that are listed, in their order; beads of a few diameters stand for those of any."""
    found = [one for one in _read().values() if one.beads is None]
    return [*found, *(material(f"polystyrene-{size:.1f}") for size in SIZES_UM)]


def material(name: str) -> Material:
    """The material of a name.

    Raises
    ------
    SceneError
        When there is none, with the names that are nearest.

    Examples
    --------
    >>> material("intralipid-20").title, material("polystyrene-0.75").title
    ('Intralipid 20 %', 'polystyrene beads, 0.75 µm')
    >>> material("intralipid20")
    Traceback (most recent call last):
    tankrig.errors.SceneError: material "intralipid20" is unknown; did you mean "intralipid-20", ...?
    """
    library = _read()
    wanted = name.strip().lower()
    beads = _BEADS.match(wanted)
    if beads:
        family = library["polystyrene"]
        assert family.beads is not None
        diameter_um = float(beads[1])
        title = f"{family.title}, {diameter_um:g} µm"
        return replace(family, name=wanted, title=title, beads=replace(family.beads, diameter_um=diameter_um))
    if wanted in library and library[wanted].beads is None:
        return library[wanted]
    names = [one.name for one in materials()]
    near = difflib.get_close_matches(wanted, names, 3, 0.4)
    if not near:
        raise SceneError(f'material "{name}" is unknown; tankrig materials lists those that are known')
    nearest = f'"{near[0]}"' if len(near) == 1 else ", ".join(f'"{one}"' for one in near[:-1]) + f' or "{near[-1]}"'
    raise SceneError(f'material "{name}" is unknown; did you mean {nearest}?')
