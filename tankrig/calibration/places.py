"""What calibrations in force have found, with uncertainty and file, for whoever reads it; and what is only believed."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from tankrig.bench import Bench
from tankrig.calibration.file import Calibration
from tankrig.calibration.geometry_in_force import GEOMETRY, sd_without


@dataclass(frozen=True)
class Measured:
    """One thing that was measured.

    Parameters
    ----------
    what
        In words.
    values, sds
        Its numbers, and their standard deviations.
    unit
        Of both.
    calibration
        File that says so, the beginning of its hash, and when it was measured.
    note
        What the standard deviations leave out; empty where they leave out nothing.
    """

    what: str
    values: tuple[float, ...]
    sds: tuple[float, ...]
    unit: str
    calibration: str
    note: str = ""

    @property
    def text(self) -> str:
        """The numbers ± their standard deviations, which whoever prints this says."""
        return self.within(1.0)

    def within(self, deviations: float) -> str:
        """The numbers ± so many of their standard deviations, to two digits of that.

        Examples
        --------
        >>> Measured("water level", (112.3456,), (0.123,), "mm", "").within(1.96)
        '112.35 ± 0.24 mm'
        >>> Measured("place", (1.0, -2.25), (0.5, 0.25), "mm", "").text
        '(1.00 ± 0.50, -2.25 ± 0.25) mm'
        """
        each = [_with_sd(value, deviations * sd) for value, sd in zip(self.values, self.sds, strict=True)]
        together = each[0] if len(each) == 1 else f"({', '.join(each)})"
        return f"{together} {self.unit}".rstrip()


def measured_places(found: Mapping[str, Calibration]) -> list[Measured]:
    """What calibrations have found of a bench.

    Parameters
    ----------
    found
        In force, by kind. Geometry is told once camera, tank and projector have all been measured, since only then it
        takes the place of what is believed.
    """
    return [] if not set(GEOMETRY) <= found.keys() else list(_geometry(found))


def _geometry(found: Mapping[str, Calibration]) -> Iterator[Measured]:
    for kind, what, name, unit in (
        ("tank", "camera stands at", "camera_position_mm", "mm"),
        ("tank", "water level", "level_mm", "mm"),
        ("camera", "camera's focal lengths", ("fx", "fy"), "px"),
        ("camera", "camera's principal point", ("cx", "cy"), "px"),
        ("camera", "camera's lens blurs by", "blur_px", "px"),
        ("camera", "from the middle to the corners by", ("blur_middle_px", "blur_corner_px"), "px"),
        ("stray", "camera's halo", "halo_share", "of the light"),
        ("stray", "its standard deviation", "halo_sigma_px", "px"),
        ("stray", "camera's veil", "veil", "of the light"),
        ("projector", "projector stands at", "position_mm", "mm"),
        ("projector", "projector's focal lengths", ("fx", "fy"), "px"),
        ("projector", "projector's principal point", ("cx", "cy"), "px"),
        ("projector", "projector's lens blurs by", "blur_px", "px"),
        ("projector", "where it is sharpest by", "blur_focus_px", "px"),
        ("projector", "projector's lens is as wide as", "lens_mm", "mm"),
        ("projector", "projector is sharpest at x =", "focus_mm", "mm"),
        ("projector", "projector's halo", "halo_share", "of the light"),
    ):
        one = found.get(kind)
        if one is None:
            continue
        names = (name,) if isinstance(name, str) else name
        if all(each in one.result for each in names):
            values = _numbers([one.result[each] for each in names])
            sds = _numbers([one.sd.get(each, math.nan) for each in names])
            if len(sds) == len(values):
                yield Measured(what, values, sds, unit, named(one), sd_without(one))


def believed(bench: Bench, found: Mapping[str, Calibration]) -> list[str]:
    """Sentences on what of a bench no calibration has measured.

    Parameters
    ----------
    bench
        As it is used.
    found
        In force, by kind.
    """
    said = []
    missing = [kind for kind in GEOMETRY if kind not in found]
    if missing:
        said.append(
            f"where camera, water and projector are is only believed, since there is no calibration of the "
            f"{' or the '.join(missing)}"
        )
    if "radiometry" not in found:
        said.append(
            f"what light the projector's levels make (gamma {bench.wall.gamma:g}) is only believed, since there is no "
            f"calibration of the radiometry"
        )
    elif not missing and not found["projector"].result.get("shading"):
        said.append("the projector's light is taken to be even, since its calibration came before the radiometry's")
    if not missing and "stray" not in found:
        said.append(
            "halo and veil of the camera's lens are not known, since there is no calibration of the stray light; fits "
            "find them along"
        )
    said += [
        f"blur of the {kind}'s lens is not known, since its calibration is older"
        for kind in ("camera", "projector")
        if not missing and "blur_px" not in found[kind].result
    ]
    if not missing and "lens_mm" not in found["projector"].result:
        said.append("how the projector's blur grows with depth is not known, since its calibration is older")
    glass = f", its wall of {bench.tank.wall_mm:g} mm" if bench.tank.entry == "glass" else ""
    said.append(f"the tank's inside{glass} and the water's refractive index are the rig file's")
    return said


def named(one: Calibration) -> str:
    """File, beginning of its hash, and date."""
    return f"{one.path.name if one.path else one.kind} ({one.hash[:12]}, {one.date[:16].replace('T', ' ')} UTC)"


def _numbers(values: list[object]) -> tuple[float, ...]:
    flat: list[float] = []
    for value in values:
        flat += [float(one) for one in value] if isinstance(value, list | tuple) else [float(str(value))]
    return tuple(flat)


def _with_sd(value: float, sd: float) -> str:
    if not sd > 0.0:
        return f"{value:.6g}"
    digits = min(8, max(0, 1 - math.floor(math.log10(sd))))
    return f"{value:.{digits}f} ± {sd:.{digits}f}"
