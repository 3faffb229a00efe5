"""The images that a prepared model is made from: orders 1 and 2 exactly, the rest from light paths, at chosen media.

One light path at ϖ = 1 serves every albedo: the light of order n is ϖⁿ times its, so paths are recorded by order and
summed for all albedos at once.
"""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from tankrig.light.double import Tabulated
from tankrig.light.entering import edged_and_smooth, entering
from tankrig.light.leaving import CameraLens
from tankrig.light.order_one import once_seen
from tankrig.light.paths.block import LARGE, TURNS, PathLimits, Points
from tankrig.light.paths.record import cell_averages, image_of_edges
from tankrig.light.paths.trace import trace
from tankrig.light.rays import geometry_of, shift_invariant, sight_line
from tankrig.light.tank import CellGrid, twice_edged_of
from tankrig.light.water import water_for_paths
from tankrig.scene import Beam, Medium, Scene

Array = NDArray[np.float64]

HIGHEST_ORDER = 2000
BIN_GROWTH = 1.1
"""Ratio of successive orders at which a new image begins; within one, all orders count as equally bright (0.05 %)."""
FAINTEST = 3e-4
"""Share of its weight at which a path ends."""
FAINTEST_BY_WALLS, SLANTED_LATTICES = 0.1, 2
"""The same of paths by way of walls, from where on they end by chance: half the time, and no more noise than from
.0003 on. And how many lattices of them there are for one of the others where light or sight slant: a tank of glass on a
bench (σt .005/mm, g .7) has the least noise for its time with two, .0174²/2 in .03 CPU s each, beside .0162² in .04."""
FAINTEST_MARK, DEEP = 0.1, 2.0
"""Times the square of the tank's height in free paths: share of the usual mark below which some marks stand for all;
beyond a depth, in shallower water it saves nothing. A lattice takes 35 instead of 78 ms at σt .12 and .08, g .95, and
42 instead of 81 at .08, .8, with the same noise."""
THINNING = ((4.0, 8), (8.0, 16), (math.inf, 32))
"""Up to which optical depth of the tank's height every doubling of the order halves the paths, from which order on."""
FORWARD, TURNS_PER_DEPTH, MOST_TURNS = 0.87, 3.0, 3 * TURNS
"""Where light runs straight and g is above, paths may turn at one of the first so many scatterings per free path of the
tank's height, since light goes on for long before it turns: .3 of the variance at σt .05 to .12, g .95."""
DEGREES = 30
"""Polynomials along x that keep a noisy image, of an angle that runs fast at both ends.

Where sights slant, light fades within some columns of the walls that it enters and leaves by. Twenty polynomials of x
itself missed that: with pinholes and g −.35 the last column by 290 % and the image by .46 % (now 6 and .08 %), in all
training images alike.
"""

SHARE, SLANTED_SHARE = 0.1, 0.5
"""Of the tolerance that is asked for, which order 2 is computed to. Where light or sight slant it takes most of a
preparation, three times as long finely as coarsely, and what coarse tables err by is counted (decision 216)."""


def order_2_tolerance(scene: Scene, tolerance: float) -> float:
    """What order 2 is computed to for a model of so much tolerance."""
    return tolerance * (SHARE if shift_invariant(scene) else SLANTED_SHARE)


def exact_images(
    scene: Scene, liquids: Sequence[tuple[float, float]], tolerance: float, known: Sequence[Tabulated] = ()
) -> Array:
    """Orders 1 and 2 at ϖ = 1 of liquids of some σt and g, (liquids, 2, pixels); `known` as for `twice_of`.

    Order 2 of smooth light is not among it, see `PathImages.twice_smooth`.
    """
    return np.stack([first_images(scene, liquids), second_images(scene, liquids, tolerance, known)], axis=1)


def first_images(scene: Scene, liquids: Sequence[tuple[float, float]]) -> Array:
    """Order 1 of these, (liquids, pixels)."""
    return once_seen(scene, _conservative(liquids)).reshape(len(liquids), -1)


def second_images(
    scene: Scene, liquids: Sequence[tuple[float, float]], tolerance: float, known: Sequence[Tabulated] = ()
) -> Array:
    """Order 2 of these, (liquids, pixels)."""
    lens = CameraLens.of(scene)
    edged, _ = edged_and_smooth(scene if lens is None else lens.wide, fine=False)
    images = twice_edged_of(edged, _conservative(liquids), order_2_tolerance(scene, tolerance), known)
    if lens is not None:
        images = np.array([lens.of_wide(one) for one in images])
    return images.reshape(len(liquids), -1)


def _conservative(liquids: Sequence[tuple[float, float]]) -> list[Medium]:
    """Media at ϖ = 1 of some σt and g."""
    return [Medium(0.0, sigma_t, g) for sigma_t, g in liquids]


@dataclass(frozen=True)
class PathImages:
    """Images of orders ≥ 3 from light paths, for several albedos at once.

    Parameters
    ----------
    scene
        Any scene; its medium does not matter.
    albedos
        Of the images.
    """

    scene: Scene
    albedos: tuple[float, ...]

    @cached_property
    def _lens(self) -> CameraLens | None:
        return CameraLens.of(self.scene)

    @cached_property
    def lit(self) -> Scene:
        """The scene as an ideal camera sees it, and the projector's light as beams."""
        return entering(self.scene if self._lens is None else self._lens.wide, fine=False)

    @cached_property
    def _smooth(self) -> Scene | None:
        """The same with its smooth light alone; None where it has none."""
        return edged_and_smooth(self.scene if self._lens is None else self._lens.wide, fine=False)[1]

    @cached_property
    def _own(self) -> int:
        """Added to seeds: if all scenes shared their lattices' shifts, all would be off the same way."""
        return zlib.crc32(repr(replace(self.scene, source="")).encode())

    @cached_property
    def grid(self) -> CellGrid:
        """Cells that paths are recorded in."""
        return CellGrid.of(self.lit)

    @cached_property
    def along(self) -> Array:
        """(columns, degrees) orthonormal polynomials along x, see `DEGREES`."""
        columns = self.grid.columns
        middles = (np.arange(columns) + 0.5) * 2.0 / columns - 1.0
        angles = np.arcsin(middles) * 2.0 / math.pi
        return np.linalg.qr(legendre.legvander(angles, min(DEGREES, columns) - 1))[0]

    @cached_property
    def _firsts(self) -> list[int]:
        firsts = [2, 3]
        while firsts[-1] < HIGHEST_ORDER:
            firsts.append(max(firsts[-1] + 1, round(firsts[-1] * BIN_GROWTH)))
        return firsts

    @cached_property
    def _bins(self) -> NDArray[np.int64]:
        return np.searchsorted(self._firsts, np.arange(self._firsts[-1]), side="right").clip(1) - 1

    @cached_property
    def _shares(self) -> Array:
        """(albedos, bins) mean of ϖⁿ over the orders of a bin."""
        orders = np.arange(2, self._bins.size)
        powers = np.array(self.albedos)[:, None] ** orders
        return np.stack([powers[:, self._bins[2:] == one].mean(axis=1) for one in range(len(self._firsts) - 1)], axis=1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of what `sample` gives: albedos, rows, degrees in x."""
        return len(self.albedos), self.grid.rows, self.along.shape[1]

    def sample(self, medium: Medium, seed: int, lattices: range) -> Array:
        """Mean image of shifted lattices of paths by albedo, in rows of cells and polynomials along x.

        Orders ≥ 3, what walls send back, and order 2 of smooth light. Of the medium σt and the phase function matter;
        of the lattices their numbers are given, by which they are shifted.
        """
        return self.beyond_two(medium, seed, lattices) + self.twice_smooth(medium, seed, lattices)

    def beyond_two(self, medium: Medium, seed: int, lattices: range) -> Array:
        """The same without order 2 of smooth light."""
        lit = replace(self.lit, medium=replace(medium, sigma_a=0.0, sigma_s=medium.sigma_t))
        images = self._traced(lit, seed, lattices)
        if not lit.tank.faces.dark:
            images = images + self._by_walls(lit, seed + self._own, lattices) @ self.along
        return self._even(images)

    def twice_smooth(self, medium: Medium, seed: int, lattices: range) -> Array:
        """Order 2 of light that is smooth as it enters, in the same way; 0 where there is none.

        Tables of it, which light beams so wide at any height want, take many times what those of a pattern do.
        """
        if self._smooth is None:
            return np.zeros(self.shape)
        lit = replace(self._smooth, medium=replace(medium, sigma_a=0.0, sigma_s=medium.sigma_t))
        return self._even(self._traced(lit, seed, lattices, (2, 2)))

    def _even(self, images: Array) -> Array:
        return np.asarray(0.5 * (images + images[:, ::-1]) if self.grid.symmetric else images)

    def _traced(self, lit: Scene, seed: int, lattices: range, orders: tuple[int, int] = (3, HIGHEST_ORDER)) -> Array:
        """Mean of light paths' lattices, of the orders from one to another."""
        beams = [beam for beam in lit.projector.beams if beam.irradiance > 0.0]
        traced = self._traced_rectangles if self.grid.shiftable else self._traced_points
        return np.asarray(traced(lit, beams, seed + self._own, lattices, orders) @ self.along / len(lattices))

    def _by_walls(self, lit: Scene, seed: int, lattices: range) -> Array:
        """Mean over lattices of what walls and floor send back, in all orders but 1 by way of clear faces."""
        from tankrig.light.walls.paths import LATTICES, wall_images

        bins = np.concatenate([[0, 1], self._bins[2:] + 2])
        each = LATTICES if self.grid.shiftable else SLANTED_LATTICES
        images = np.mean(
            [
                wall_images(lit, self.grid, (seed, lattice), bins, HIGHEST_ORDER, FAINTEST_BY_WALLS, each)
                for lattice in lattices
            ],
            axis=0,
        )
        low = np.array(self.albedos)[:, None] ** np.arange(2)
        return np.tensordot(np.concatenate([low, self._shares], axis=1), images[: 2 + self._shares.shape[1]], 1)

    def _traced_rectangles(
        self, lit: Scene, beams: list[Beam], seed: int, lattices: range, orders: tuple[int, int]
    ) -> Array:
        """Sum over lattices where one path stands for every start on beams of one height."""
        total = np.zeros((len(self.albedos), self.grid.rows, self.grid.columns))
        transmission = sight_line(geometry_of(lit), 0.0, 0.0)[3]
        for z_mm in sorted({beam.z_mm for beam in beams}):
            edges = np.zeros((len(self._firsts) - 1, 2, self.grid.rows + 2, self.grid.columns + 2))
            self._trace(lit, [beam for beam in beams if beam.z_mm == z_mm], seed, lattices, orders, edges)
            by_albedo = np.tensordot(self._shares, edges, 1)  # before edges become images: they are many more
            image = image_of_edges(by_albedo, lit.medium.sigma_t, self.grid.cell_mm[0])
            total += image * (transmission * (z_mm[1] - z_mm[0]) / LARGE.points)
        return total

    def _traced_points(
        self, lit: Scene, beams: list[Beam], seed: int, lattices: range, orders: tuple[int, int]
    ) -> Array:
        """Sum over lattices of paths that are seen where they are."""
        cells = np.zeros((len(self._firsts) - 1, self.grid.rows, self.grid.columns))
        self._trace(lit, beams, seed, lattices, orders, cells)
        power = sum(beam.power for beam in beams)
        area = self.grid.cell_mm[0] * self.grid.cell_mm[1]
        return cell_averages(np.tensordot(self._shares, cells, 1) * (power / (LARGE.points * area)))

    def _trace(
        self, lit: Scene, beams: list[Beam], seed: int, lattices: range, orders: tuple[int, int], light: Array
    ) -> None:
        """Follow lattices of paths and add them to what `trace` fills."""
        medium, power = lit.medium, np.array([beam.power for beam in beams])
        corners = np.array([(*beam.y_mm, *beam.z_mm, beam.irradiance) for beam in beams])
        table = np.column_stack([corners, np.cumsum(power) / power.sum()])
        height = medium.sigma_t * lit.tank.size_mm[2]
        thinning = next(order for depth, order in THINNING if height < depth)
        forward = medium.g > FORWARD and self.grid.shiftable
        turns = min(max(TURNS, round(TURNS_PER_DEPTH * height)), MOST_TURNS) if forward else TURNS
        faintest_mark = FAINTEST_MARK * height**2 if height > DEEP else 0.0
        lowest, highest = orders
        limits = PathLimits(highest, FAINTEST, thinning, turns, faintest_mark, lowest)
        geometry, water = geometry_of(lit), water_for_paths(medium)._replace(albedo=1.0)
        for lattice in lattices:
            points = Points(LARGE.shifted((seed, lattice)), LARGE.points)
            trace(light, self._bins, self.grid.cell_mm, geometry, water, table, points, limits)

    def to_pixels(self, patterns: Array) -> Array:
        """Images of cells (n, rows, degrees) as the camera's pixels, (n, pixels)."""
        images = self.grid.many_to_pixels(patterns @ self.along.T)
        return np.array([(image if self._lens is None else self._lens.of_wide(image)).ravel() for image in images])

    def noise_to_pixels(self, patterns: Array) -> Array:
        """The same of noise, which need not be as sharp, (n, rows, columns)."""
        images = self.grid.noise_to_pixels(patterns @ self.along.T)
        return images if self._lens is None else np.array([self._lens.of_wide(image) for image in images])
