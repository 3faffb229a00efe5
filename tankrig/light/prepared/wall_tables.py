"""Tables of order 2 for all light of a band of the wall, as arrays of a file and back."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.light.double import Tabulated
from tankrig.light.double.table import LitHeight, Stack, Table
from tankrig.light.rays import Geometry

FIELDS = "x_mm", "fractions", "y0_mm", "z0_mm", "values", "decays", "numbers", "geometry"


def packed_tables(tables: Sequence[Tabulated]) -> dict[str, NDArray[np.generic]]:
    """Arrays that `unpacked_tables` makes them of again; J in single precision, finer than its interpolation."""
    arrays: dict[str, NDArray[np.generic]] = {"count": np.array(len(tables))}
    for number, one in enumerate(tables):
        lit, table = one.lit, one.table
        numbers = *lit.z_mm, lit.mirrored, one.finest_mm, table.margin, table.decay, *table.inner_mm
        given: tuple[NDArray[np.generic], ...] = (
            table.x_mm, table.fractions, table.y0_mm, table.z0_mm, one.stack.values.astype(np.float32),
            one.stack.decays, np.array(numbers, float), np.array(lit.geometry, float),
        )  # fmt: skip
        arrays |= {f"{name}{number}": array for name, array in zip(FIELDS, given, strict=True)}
    return arrays


def unpacked_tables(arrays: Mapping[str, NDArray[np.generic]], liquids: int) -> list[Tabulated]:
    """The tables of so many liquids.

    Raises
    ------
    KeyError, ValueError
        When the arrays are none of those.
    """
    found = []
    for number in range(int(arrays["count"].astype(int))):
        x, fractions, y0, z0, values, decays, numbers, geometry = (
            arrays[f"{name}{number}"].astype(float) for name in FIELDS
        )
        if values.shape != (z0.size, y0.size, 2, x.size, fractions.size, liquids) or decays.shape != (liquids,):
            raise ValueError("tables of other liquids")
        low, high, mirrored, finest_mm, margin, decay, inner_low, inner_high = numbers.tolist()
        source = Geometry(*geometry.tolist())
        source = source._replace(
            light_pinhole=bool(source.light_pinhole), camera_pinhole=bool(source.camera_pinhole),
            reflected=bool(source.reflected),
        )  # fmt: skip
        table = Table(x, fractions, margin, y0, z0, np.zeros((0,) * 5), decay, bool(mirrored), (inner_low, inner_high))
        lit = LitHeight(source, (), (low, high), bool(mirrored), True)
        found.append(Tabulated(lit, finest_mm, table, Stack(values, decays)))
    return found
