"""A liquid as text for Mitsuba 3, pbrt-v4, MCX, and as a table.

Each has its own unit of length, its own way to say a phase function, and its own losses, which the text says.
"""

import json
import math
from collections.abc import Callable

import numpy as np

from tankrig.errors import SceneError
from tankrig.exchange.even_cosines import CLOSE, even_cosines, inverse_distribution
from tankrig.exchange.liquid import Liquid
from tankrig.scene.phase_functions import HenyeyGreenstein

MCX_ENTRIES = 4094
"""Even, with which MCX's own table has no gap; a share of scatterings of 0.024 % each."""


def to_mitsuba(liquid: Liquid, unit_mm: float = 1.0) -> str:
    """A scene fragment of Mitsuba 3 to be included, which defines the medium "tankrig".

    σt is per unit of the scene. `hg` has our sign of g; `tabphase` has even steps of cos θ from −1 to 1 where 1 is
    straight on, and normalises by itself.

    Parameters
    ----------
    liquid
        To be written.
    unit_mm
        Length of one unit of the scene, mm.
    """
    medium = liquid.medium
    if isinstance(medium.phase_function, HenyeyGreenstein):
        phase, lost = f'    <phase type="hg">\n      <float name="g" value="{medium.g!r}"/>\n    </phase>', []
    else:
        _, values, error = even_cosines(medium.phase_function)
        text = ", ".join(f"{value:.6g}" for value in values)
        phase = f'    <phase type="tabphase">\n      <string name="values" value="{text}"/>\n    </phase>'
        lost = [] if error <= CLOSE else [f"too steep for a table: its moments are off by {error:.2g}"]
    comments = "\n".join(f"  {line}" for line in [*liquid.lines, f"one unit of the scene is {unit_mm:g} mm", *lost])
    return (
        f'<scene version="3.0.0">\n<!--\n{comments.replace("--", "- -")}\n-->\n'
        f'  <medium type="homogeneous" id="tankrig">\n'
        f'    <float name="sigma_t" value="{medium.sigma_t * unit_mm!r}"/>\n'
        f'    <float name="albedo" value="{medium.albedo!r}"/>\n{phase}\n  </medium>\n</scene>\n'
    )


def to_pbrt(liquid: Liquid, unit_mm: float = 1.0) -> str:
    """A pbrt-v4 medium "tankrig": σa and σs per unit of the scene, the same at all wavelengths.

    pbrt knows Henyey–Greenstein only; of another phase function its mean cosine is kept, and what is lost is said.
    """
    medium = liquid.medium
    comments = [*liquid.lines, f"one unit of the scene is {unit_mm:g} mm"]
    if not isinstance(medium.phase_function, HenyeyGreenstein):
        theirs = HenyeyGreenstein(medium.g)
        ratios = [float(theirs.at(cosine) / medium.phase_function.at(cosine)) for cosine in (0.5, 0.0, -0.5, -1.0)]
        said = ", ".join(f"{ratio:.3g} at {angle}" for ratio, angle in zip(ratios, (60, 90, 120, 180), strict=True))
        comments.append(
            "lost: pbrt knows Henyey-Greenstein only, and g is kept; its p over the liquid's own, by degrees:"
        )
        comments.append(f"  {said}")
    head = "\n".join(f"# {line}" for line in comments)
    scaled = (f"[300 {value * unit_mm!r} 900 {value * unit_mm!r}]" for value in (medium.sigma_a, medium.sigma_s))
    sigma_a, sigma_s = scaled
    return (
        f'{head}\nMakeNamedMedium "tankrig" "string type" "homogeneous"\n  "spectrum sigma_a" {sigma_a}\n'
        f'  "spectrum sigma_s" {sigma_s}\n  "float g" {medium.g!r}\n'
    )


def to_mcx(liquid: Liquid, unit_mm: float = 1.0) -> str:
    """The `Domain` of an MCX input: medium 0 is what is around, 1 the liquid, in 1/mm whatever the voxels' side.

    Any phase function goes as `InverseCDF`, cos θ at even shares of the scatterings without its ends; MCX then takes
    it for every medium in place of g.

    Parameters
    ----------
    liquid
        To be written.
    unit_mm
        Side of a voxel, mm.
    """
    medium = liquid.medium
    around = {"mua": 0.0, "mus": 0.0, "g": 1.0, "n": 1.0}
    inside = {"mua": medium.sigma_a, "mus": medium.sigma_s, "g": medium.g, "n": liquid.refractive_index}
    domain: dict[str, object] = {"LengthUnit": unit_mm, "Media": [around, inside]}
    if not isinstance(medium.phase_function, HenyeyGreenstein):
        entries = inverse_distribution(medium.phase_function, MCX_ENTRIES)
        domain["InverseCDF"] = [float(f"{value:.7g}") for value in entries]
    return json.dumps({"_comment": "; ".join(liquid.lines), "Domain": domain}, ensure_ascii=False) + "\n"


def to_csv(liquid: Liquid, unit_mm: float = 1.0) -> str:
    """A table: comments with the coefficients, then θ in degrees, cos θ, p in 1/sr and β = σs p in 1/(m sr).

    β(ψ) is what ocean optics calls the volume scattering function.
    """
    if unit_mm != 1.0:
        raise SceneError("a table says its units itself, 1/mm and 1/(m sr); leave --unit-mm out")
    medium = liquid.medium
    fine = np.concatenate([np.arange(0.0, 2.0, 0.02), np.arange(2.0, 10.0, 0.1), np.arange(10.0, 180.5, 0.5)])
    cosine = np.cos(np.radians(fine))
    p = medium.phase_function.at(cosine)
    rows = [f"{a:.2f},{c:.9f},{v:.6e},{1e3 * medium.sigma_s * v:.6e}" for a, c, v in zip(fine, cosine, p, strict=True)]
    head = [f"# {line}" for line in liquid.lines]
    return "\n".join([*head, "theta_deg,cosine,p_per_sr,beta_per_m_sr", *rows]) + "\n"


FORMATS: dict[str, Callable[[Liquid, float], str]] = {
    "mitsuba": to_mitsuba, "pbrt": to_pbrt, "mcx": to_mcx, "csv": to_csv,
}  # fmt: skip
SUFFIXES = {"mitsuba": ".xml", "pbrt": ".pbrt", "mcx": ".json", "csv": ".csv"}


def exported(liquid: Liquid, to: str, unit_mm: float = 1.0) -> str:
    """The text of a liquid in one of `FORMATS`.

    Raises
    ------
    SceneError
        When the unit is none, or nobody knows the format.
    """
    if to not in FORMATS:
        raise SceneError(f'"{to}" is no program that is known; give {", ".join(FORMATS)}')
    if not (math.isfinite(unit_mm) and unit_mm > 0.0):
        raise SceneError(f"a unit of {unit_mm:g} mm is no length; give mm")
    return FORMATS[to](liquid, unit_mm)
