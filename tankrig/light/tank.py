"""The finite tank: orders 1 and 2 exact, all further orders by as many light paths as the tolerance asks for."""

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from tankrig.light.columns import MOST_PARTS
from tankrig.light.compiled_beside import paths_compiled_beside
from tankrig.light.double import (
    GLANCE_FROM,
    ROUGH_ERRORS,
    Tabulated,
    double_scattering_of,
    may_be_rough,
    table_error,
)
from tankrig.light.entering import edged_and_smooth, entering, is_plain, through_lens
from tankrig.light.high_orders import LOST_USUALLY, MOST_ORDERS, Allowance, Tail, beyond_orders, high_orders
from tankrig.light.leaving import CameraLens
from tankrig.light.moments.plan import FINE, MomentPlan, moment_plan
from tankrig.light.order_one import once, once_seen, once_sent_back, once_through
from tankrig.light.paths.cells import CellGrid
from tankrig.light.paths.lattices import traced
from tankrig.light.paths.smoothing import smoothed
from tankrig.light.rays import shift_invariant
from tankrig.light.surface import in_larger_pixels, in_own_pixels, lookup_error, many_to_camera, on_surface
from tankrig.prediction import ORDER_CLASSES, Prediction, Skipped
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction
from tankrig.threads import one_blas_thread

Array = NDArray[np.float64]

__all__ = ["CellGrid", "tank_image", "traced"]

SMOOTH_CELLS = 24
"""Across the tank, that order 2 of smooth light is looked up on: it is .2 % of itself off on a bench (a halo of 28 mm,
with and without a dark picture's light; 1 to 2 % with 12 or 16), where cells for beams take 17 to 48 CPU s, these 3."""
ROUGH_PART = 0.35
"""Of the tolerance, that rough tables of order 2 may take: it leaves paths a fifteenth less, and saves up to half of
the time where liquids are thin."""
LARGER_MM, LARGER_ERROR = 1.0, 0.005
"""Pixels that order 2 is computed in where a plain camera with a viewpoint has smaller ones, and what that errs by: .2
to .5 % of order 2 in six scenes, 1.7 in a dense one, where it is little, in an eighth of the time at .25 mm."""
GLANCED = 1.05
"""What the share of order 2 that a glance tells is multiplied by, to be no less than it is."""
SHALLOWER = 0.55
"""Share of the usual depth from which on slanted light is solved for if it turns out to want many paths."""
DOUBTED = 1.25
"""What the bound of a solution for moments is multiplied by: .09/.997/.8 errs by .9 % where it says .68."""


@one_blas_thread()
def tank_image(
    scene: Scene,
    tolerance: float = 0.01,
    max_order: int | None = None,
    seed: int = 0,
    batches: int | None = None,
    budget_s: float | None = None,
    progress: Callable[[float], object] | None = None,
) -> Prediction:
    """Image of the finite tank, as its walls, its projector's and its camera's lens make it.

    Parameters
    ----------
    scene
        Any scene.
    tolerance
        Relative L2 error of the image to stay below.
    max_order
        Sum orders 1 … max_order only.
    seed
        Of the paths' lattice.
    batches
        A fixed number of shifted lattices instead of what the tolerance asks for: the image is then a smooth
        function of the medium.
    budget_s
        Seconds after which no more paths are begun, whatever the error; None for as long as it takes.
    progress
        Called with the share of the work that is done, 0 … 1; an exception that it raises ends the work.

    Returns
    -------
    Prediction
        With images of the classes 1, 2, 3, "4-20" and ">20", dark where they were not asked for.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> scene = Scene(Tank(), Medium(0.0002, 0.0198, 0.5), light, Camera("orthographic", (80, 120), 2.0))
    >>> image = tank_image(scene, tolerance=0.05)
    >>> [round(float(image.orders[order].sum() / image.image.sum()), 2) for order in (1, 2)]
    [0.14, 0.24]
    """
    lens = CameraLens.of(scene)
    if lens is None:
        return _ideal_image(scene, None, tolerance, max_order, seed, batches, budget_s, progress)
    (ideal,), (first,) = once_through(lens, [scene.medium])
    found = _ideal_image(lens.wide, ideal, tolerance, max_order, seed, batches, budget_s, progress)
    orders = {
        key: lens.of_wide(np.asarray(one, float) - (ideal if key == 1 else 0.0)) for key, one in found.orders.items()
    }
    orders[1] = orders[1] + first  # which the lens has blurred finely
    stderr = None if found.stderr is None else np.sqrt(lens.variance_of_wide(np.square(found.stderr, dtype=float)))
    image = np.sum(list(orders.values()), axis=0)
    return replace(found, image=image, orders=MappingProxyType(orders), stderr=stderr)


def twice(scene: Scene, tolerance: float) -> Array:
    """Order 2 likewise."""
    return np.asarray(twice_of(scene, [scene.medium], tolerance)[0])


def twice_of(
    scene: Scene, media: Sequence[Medium], tolerance: float, known: Sequence[Tabulated] = (),
    others: Sequence[PhaseFunction] = (),
) -> Array:  # fmt: skip
    """The same of several liquids, (media, rows, columns), for little more than what does depend on the liquid.

    `known` are tables of these liquids, and `others` phase functions that one liquid is turned towards, see
    `double_scattering_of`.
    """
    edged, smooth = edged_and_smooth(scene, fine=False)
    images = twice_edged_of(edged, media, tolerance, known, others)
    if smooth is None:
        return images
    # Where light is little its tables may be as much coarser: on a bench .4 % of it took 60 % of the time of fine ones.
    faint, bright = (sum(beam.power for beam in entering(one, fine=False).projector.beams) for one in (smooth, edged))
    share = faint / ((faint + bright) or 1.0)
    return images + twice_smooth_of(smooth, media, min(tolerance / (share or 1.0), max(ROUGH_ERRORS)), others)


def twice_edged_of(
    scene: Scene, media: Sequence[Medium], tolerance: float, known: Sequence[Tabulated] = (),
    others: Sequence[PhaseFunction] = (),
) -> Array:  # fmt: skip
    """The same of light that is not smooth, see `edged_and_smooth`."""
    if is_plain(scene):
        return double_scattering_of(scene, media, tolerance, known, others)
    parts = through_lens(entering(scene, fine=False), fine=False)
    return np.asarray(sum(share * double_scattering_of(one, media, tolerance, known, others) for share, one in parts))


def twice_smooth_of(
    scene: Scene, media: Sequence[Medium], tolerance: float, others: Sequence[PhaseFunction] = ()
) -> Array:
    """Order 2 of smooth light, which a calibrated camera looks up on coarse cells of the surface."""
    plain = on_surface(scene, scene.tank.size_mm[1] / SMOOTH_CELLS)
    images = double_scattering_of(plain, media, tolerance, others=others, little=True)
    if scene.camera.kind != "calibrated":
        return images
    return many_to_camera(scene, images, (plain.camera.pixel_mm, plain.camera.pixel_mm))


def low_orders(scene: Scene, tolerance: float, highest: int = 2) -> Array:
    """Orders 1 and 2, or the first alone, as the camera's lens shows them; without light by diffuse faces."""
    lens = CameraLens.of(scene)
    if lens is None:
        return once(scene) if highest == 1 else once(scene) + twice(scene, tolerance)
    first: Array = once_seen(scene, [scene.medium])[0]
    return first if highest == 1 else first + lens.of_wide(twice(lens.wide, tolerance))


def by_faces(described: Scene, seed: int, lattices: int) -> Array:
    """What walls and floor add to the image of an ideal camera, by so many lattices of paths; four are smoothed."""
    return by_faces_within(described, seed, lattices)[0]


def by_faces_within(described: Scene, seed: int, lattices: int) -> tuple[Array, Array]:
    """The same, and its standard error by pixel; 0 where one lattice does not tell."""
    image, stderr = paths_by_faces(described, seed, lattices)
    return once_sent_back(described) + image, stderr


def paths_by_faces(
    described: Scene, seed: int, lattices: int, diffuse_only: bool = False
) -> tuple[Array, Array]:  # fmt: skip
    """The same without order 1 by way of clear faces, which diffuse ones do not change; or of diffuse faces alone."""
    from tankrig.light.walls.paths import wall_images

    faces = described.tank.faces
    if faces.dark or (diffuse_only and all(one.kind != "diffuse" for one in faces.all)):
        return np.zeros(described.camera.shape), np.zeros(described.camera.shape)
    scene = entering(described, fine=False)
    grid = CellGrid.of(scene)
    bins = np.zeros(MOST_ORDERS_OF_A_PATTERN + 1, np.int64)
    batches = np.array(
        [
            wall_images(scene, grid, (seed, batch), bins, MOST_ORDERS_OF_A_PATTERN, 1e-3, 1, diffuse_only)[0]
            for batch in range(lattices)
        ]
    )  # fmt: skip
    found = smoothed(grid.folded(batches), seen=grid.seen, steady=True)
    stderr = np.sqrt(grid.variance_to_pixels((1.0 + LOST_USUALLY) * found.variance))
    return np.asarray(grid.to_pixels(grid.unfolded(found.image[None])[0])), np.asarray(stderr)


MOST_ORDERS_OF_A_PATTERN = 200


def _ideal_image(
    described: Scene, first: Array | None, tolerance: float, max_order: int | None, seed: int, batches: int | None,
    budget_s: float | None, progress: Callable[[float], object] | None,
) -> Prediction:  # fmt: skip
    """What an ideal camera sees; `first` is order 1 where it is known already."""
    highest = max_order or 1_000_000
    allowance = Allowance.of(budget_s, progress)
    reflecting = not described.tank.faces.dark
    followed = (highest >= 3 or reflecting) and described.medium.sigma_s > 0.0
    orders: dict[int | str, Array] = {}
    with paths_compiled_beside(described) if followed else nullcontext():
        orders[1] = once(described) if first is None else first
        off = 0.0
        if highest >= 2:
            if batches is None:
                orders[2], off = _as_rough_as_its_share(described, orders[1], tolerance)
            else:  # liquids next to each other want the same tables
                orders[2], off = twice(described, tolerance), table_error(described, tolerance)
    scene = entering(described, fine=False)
    zero = np.zeros(scene.camera.shape)
    stderr, skipped = zero, [Skipped("light that leaves the tank through its black walls", 0.0)]
    tables = math.hypot(off, lookup_error(scene)) if highest >= 2 else 0.0
    if scene.medium.sigma_t * scene.camera.pixel_mm > MOST_PARTS and scene.camera.kind != "orthographic":
        skipped.append(Skipped(f"how light of order 1 fades within pixels of more than {MOST_PARTS} free paths", 1.0))
    known = sum(orders.values(), zero)
    if followed:
        tail = None if max_order or batches or reflecting else _tail(scene, tolerance, seed)
        high = high_orders(scene, known, tolerance, max_order, seed, batches, tail, allowance)
        tail = high.tail
        orders |= high.by_class
        for order in range(1, min(highest, 2) + 1):
            orders[order] = orders[order] + high.by_walls[order - 1]
        stderr = high.stderr
        if tail is not None:
            skipped.append(Skipped(f"{tail.coarse}: what paths don't mend of it is in stderr", 0.0))
        if highest > MOST_ORDERS and (unseen := beyond_orders(scene)) > 0.0:
            skipped.append(Skipped(f"orders above {MOST_ORDERS}", unseen))
    whole = {key: orders.get(key, zero) for key in ORDER_CLASSES}
    image = np.sum(list(whole.values()), axis=0)
    lit = any(beam.power > 0.0 for beam in scene.projector.beams)
    if lit and scene.medium.sigma_s > 0.0 and not image.any():
        skipped.append(Skipped("all light: none of the paths reached the camera", 1.0))
    if tables > 0.0:
        skipped.append(Skipped("tables that order 2 is looked up in", tables * relative_norm(known, image)))
    return Prediction(image, "tank", MappingProxyType(whole), stderr, tuple(skipped))


def _as_rough_as_its_share(scene: Scene, first: Array, tolerance: float) -> tuple[Array, float]:
    """Order 2, and what its tables err by, relative L2 of orders 1 and 2.

    Where there is little of it, as a glance tells, rough tables do: they may take `ROUGH_PART` of the tolerance.
    """
    larger, along = in_larger_pixels(scene, LARGER_MM) if tolerance >= FINE else (scene, 1)
    apart = LARGER_ERROR if along > 1 else 0.0

    def second(tolerance: float) -> Array:
        return np.maximum(in_own_pixels(twice(larger, tolerance), along), 0.0)

    if may_be_rough(scene, tolerance):
        glance = second(GLANCE_FROM)
        share = GLANCED * relative_norm(glance, first + glance)
        for roughness, error in ROUGH_ERRORS.items():
            if error * share <= ROUGH_PART * tolerance:
                image = second(roughness)
                return image, math.hypot(error, apart) * relative_norm(image, first + image)
    image = second(tolerance)
    return image, math.hypot(table_error(scene, tolerance), apart * relative_norm(image, first + image))


def _tail(scene: Scene, tolerance: float, seed: int) -> Tail | Callable[[], Tail] | None:
    """The high orders solved for at once, where that is worth its time; what solves for them, where it may be."""
    plan = moment_plan(scene, tolerance)
    if plan is not None:
        return _solved(scene, plan, seed)
    plan = None if shift_invariant(scene) or tolerance < FINE else moment_plan(scene, tolerance, SHALLOWER)
    return None if plan is None else partial(_solved, scene, plan, seed)


def _solved(scene: Scene, plan: MomentPlan, seed: int) -> Tail:
    from tankrig.light.moments.dense import dense_orders

    grid = CellGrid.of(scene)
    dense = dense_orders(scene, plan, seed + OTHER_SHIFTS, surface=((grid.rows, grid.columns), grid.cell_mm))
    coarse = f"above order {plan.above}, degrees beyond {plan.degree} and cells below {plan.side_mm:.1f} mm"
    return Tail(plan.above, dense.to_20, dense.beyond_20, DOUBTED * plan.bound, coarse)


OTHER_SHIFTS = 2**20
"""Added to the seed for the paths of a solution's source, which shall know nothing of those that correct it."""


def relative_norm(part: Array, whole: Array) -> float:
    """L2 norm of a part over that of the whole, however faint both are; 0 where all is dark.

    Examples
    --------
    >>> relative_norm(np.array([3e-200, 0.0]), np.array([0.0, 6e-200]))
    0.5
    """
    peak = float(np.abs(whole).max(initial=0.0))
    return float(np.linalg.norm(part / peak) / np.linalg.norm(whole / peak)) if peak > 0.0 else 0.0
