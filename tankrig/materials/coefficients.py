"""A material at one wavelength: its coefficients and phase function, and what each uncertainty does to them."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.materials.library import Material
from tankrig.materials.particles import droplets
from tankrig.scene.description import Medium
from tankrig.scene.phase_functions import HenyeyGreenstein, Tabulated
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

DROPLETS_SD = 0.1
"""Relative uncertainty of a calculated emulsion's p beside that of its g: none of ours, sizes are not measured."""


@dataclass(frozen=True)
class Uncertain:
    """A number with its standard deviation, by what that is made of.

    Parameters
    ----------
    value
        The number.
    parts
        By how much it changes when each cause is off by its own standard deviation.
    """

    value: float
    parts: Mapping[str, float]

    @property
    def sd(self) -> float:
        """All of them together, taken as independent."""
        return math.hypot(*self.parts.values())

    @property
    def share(self) -> float:
        """The standard deviation over the value."""
        return self.sd / abs(self.value) if self.value else math.inf


@dataclass(frozen=True)
class Optics:
    """A material, undiluted, at one wavelength.

    Parameters
    ----------
    material
        What it is.
    wavelength_nm
        In vacuum.
    medium
        σa, σs in 1/mm and the phase function.
    varied
        The same with one cause off by its standard deviation, by the cause; to either side where that differs.
    shape_sd
        Relative uncertainty of the phase function's values that is in none of these.
    """

    material: Material
    wavelength_nm: float
    medium: Medium
    varied: Mapping[str, tuple[Medium, ...]]
    shape_sd: float = 0.0

    def of(self, number: Callable[[Medium], float]) -> Uncertain:
        """A number of the liquid, such as its σs, with what each cause does to it."""
        value = number(self.medium)
        changes = {cause: [number(one) - value for one in media] for cause, media in self.varied.items()}
        return Uncertain(value, {cause: max(each, key=abs) for cause, each in changes.items()})

    @property
    def searched(self) -> str | PhaseFunction:
        """Phase functions that a fit of it should search, as `tankrig.estimate` has them.

        Beads are spheres of about the label's size. Nobody has measured the droplets of an emulsion: any smooth phase
        function may be its own.
        """
        return self.medium.phase_function if self.material.beads is not None else "free"

    @cached_property
    def sigma_s(self) -> Uncertain:
        """Scattering coefficient, 1/mm."""
        return self.of(lambda one: one.sigma_s)

    @cached_property
    def g(self) -> Uncertain:
        """Mean cosine."""
        return self.of(lambda one: one.g)

    @cached_property
    def reduced(self) -> Uncertain:
        """σs(1−g), 1/mm."""
        return self.of(lambda one: one.sigma_s * (1.0 - one.g))

    @cached_property
    def sideways(self) -> Uncertain:
        """σs·p(90°), 1/mm/sr: what the camera sees of light that scatters once."""
        return self.with_shape(self.of(sideways))

    def density(self, cosine: Array) -> tuple[Array, Array]:
        """p in 1/sr at cosines, and its standard deviation."""
        p = self.medium.phase_function.at(cosine)
        variance = (self.shape_sd * p) ** 2
        for media in self.varied.values():
            variance = variance + np.max([(one.phase_function.at(cosine) - p) ** 2 for one in media], axis=0)
        return p, np.sqrt(variance)

    def with_shape(self, number: Uncertain) -> Uncertain:
        """A number in proportion to p somewhere, its uncertainty with that of the phase function's shape."""
        if not self.shape_sd:
            return number
        return Uncertain(number.value, {**number.parts, "sizes": self.shape_sd * number.value})


def sideways(medium: Medium) -> float:
    """σs·p(90°) of a liquid, 1/mm/sr."""
    return medium.sigma_s * float(medium.phase_function.at(0.0))


def optics(material: Material, wavelength_nm: float, band_nm: float = 0.0) -> Optics:
    """What a material is at a wavelength.

    Parameters
    ----------
    material
        Of the library.
    wavelength_nm
        Of the light, in vacuum.
    band_nm
        Full width at half maximum of its band, over which σs p of beads is averaged. What laws say of other liquids
        changes by less than .1 % over 20 nm.

    Raises
    ------
    SceneError
        When nobody has published it there.
    """
    name = material.name
    material.require_known_at(wavelength_nm)
    try:
        if material.beads is not None:
            beads = material.beads
            liquid = beads.liquid(wavelength_nm, band_nm=band_nm)
            return Optics(material, wavelength_nm, liquid, beads.varied(wavelength_nm, band_nm))
        if material.sigma_s is None:
            raise SceneError(f"nobody's σs is listed ({material.note})")
        sigma_s, sd = material.sigma_s.at(wavelength_nm), material.sigma_s.uncertainty(wavelength_nm)
        sigma_a = 0.0 if material.sigma_a is None else material.sigma_a.at(wavelength_nm)
        phase = _phase(material, wavelength_nm, 0.0)
        varied = {"σs of the source": (Medium(sigma_a, sigma_s + sd, phase=phase),)}
        if material.g is not None:
            off = material.g.uncertainty(wavelength_nm)
            varied["g of the source"] = (Medium(sigma_a, sigma_s, phase=_phase(material, wavelength_nm, off)),)
        droplet = material.phase is not None and material.phase.kind == "droplets"
        medium = Medium(sigma_a, sigma_s, phase=phase)
        return Optics(material, wavelength_nm, medium, varied, DROPLETS_SD if droplet else 0.0)
    except SceneError as error:
        raise SceneError(f"{name}: {error}") from error


def _phase(material: Material, wavelength_nm: float, off: float) -> PhaseFunction:
    """Of a material that is not of beads, its g off by so much, towards where there is room."""
    if material.phase is not None and material.phase.kind == "rayleigh":
        cosine = np.linspace(-1.0, 1.0, 201)
        values = 1.0 + material.phase.asymmetry * cosine**2
        values /= 2.0 * math.pi * np.trapezoid(values, cosine)
        return Tabulated(tuple(cosine.tolist()), tuple(values.tolist()))
    assert material.g is not None
    g = material.g.at(wavelength_nm)
    g += off if g + off < 0.9 else -off
    return HenyeyGreenstein(g) if material.phase is None else droplets(g, wavelength_nm)
