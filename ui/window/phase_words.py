"""Phase functions in plain words: families, what describes them, and what a fit was asked to search."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tankrig.scene.phase_table import PhaseFunction

FAMILIES = {
    "hg": "Henyey–Greenstein",
    "henyey-greenstein": "Henyey–Greenstein",
    "two-term": "two lobes of Henyey–Greenstein",
    "reynolds-mccormick": "Reynolds–McCormick",
    "fournier-forand": "Fournier–Forand",
    "free": "free form",
    "mie": "Mie's spheres",
    "spheres": "spheres of any size",
    "polydisperse": "particles of many sizes",
    "shaped": "spheres, or nearly",
    "table": "tabulated",
    "mixture": "mixture",
    "any": "any phase function",
}
"""By kind, and by the names that a sequence may ask for."""
PARAMETERS = {
    "hg": {"g": "Henyey–Greenstein's own g"},
    "two-term": {"forward": "g of the forward lobe", "backward": "g of the backward lobe", "share": "forward share"},
    "reynolds-mccormick": {"g": "Reynolds–McCormick's own g", "alpha": "α"},
    "fournier-forand": {"index": "index of the particles over water's", "slope": "slope of the sizes"},
    "mie": {
        "diameter_um": "diameter of the spheres (µm)", "particle_index": "index of the spheres",
        "water_index": "index of the water", "wavelength_nm": "wavelength in vacuum (nm)",
        "spread": "spread of the diameters", "band_nm": "band (nm)",
    },
    "spheres": {
        "diameter_in_wavelengths": "diameter of the spheres (wavelengths in vacuum)",
        "index_over_water": "index of the spheres over water's",
        "spread": "spread of the diameters",
    },
}  # fmt: skip
"""What a fit finds of a family, by kind and by its name there."""


def found_in_words(kind: str, families: Mapping[str, float]) -> str:
    """The family that a fit has found, or those that share its answer.

    >>> found_in_words("two-term", {"two-term": 1.0})
    'two lobes of Henyey–Greenstein'
    >>> found_in_words("mixture", {"free": 0.3, "hg": 0.7})
    'Henyey–Greenstein 70 %, free form 30 %'
    """
    if len(families) < 2:
        return FAMILIES.get(kind, kind)
    shares = sorted(families.items(), key=lambda one: -one[1])
    return ", ".join(f"{FAMILIES.get(name, name)} {100.0 * share:.2g} %" for name, share in shares)


def asked_in_words(phase: "str | PhaseFunction") -> str:
    """What a fit is asked to search; a phase function stands for itself, and Mie's for what a label says.

    >>> from tankrig.scene.phase_functions import HenyeyGreenstein
    >>> asked_in_words("reynolds-mccormick"), asked_in_words(HenyeyGreenstein(0.7))
    ('Reynolds–McCormick', 'Henyey–Greenstein as given')
    """
    if isinstance(phase, str):
        return FAMILIES.get(phase, phase)
    return FAMILIES.get(phase.kind, phase.kind) + (" as labelled" if phase.kind == "mie" else " as given")
