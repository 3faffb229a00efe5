"""Whether a scene's high orders are solved for, and on what cells, with how many degrees, from which order on."""

import math
from dataclasses import dataclass

from tankrig.light.rays import shift_invariant
from tankrig.scene import Scene

SHARE, FINE, FINE_SHARE = 0.42, 0.005, 0.32
"""Share of the tolerance that the cells' size and the degrees that are left out may use up together; below `FINE`, the
latter, where paths take longer to tell what they are off by."""
OF_CELLS, OF_FEW = 0.05, 0.001
"""What solutions are off by, as a share of the image: times the cube of the cells' sides in free paths; and with
`FEWEST_CELLS` along the tank's shortest side, whose cells are wider than beams, times the cube of their sides, too. Of
eleven scenes with sides of .38 to .48 free paths: .022 to .067, where .05 is taken."""
OF_DEGREES = (0.15, 0.065, 0.05, 0.025, 0.012, 0.009, 0.007)
"""The same times the first moment that is left out, by degree. Of twelve scenes beside solutions with two degrees more:
.042 to .066 for degrees 1 and 2, .014 to .024 for 3, .008 for 4. Nobody has measured those for 0, 5 and 6."""
FEWEST_CELLS, MOST_LEFT = 15, 16
MOST_CELLS = (80, 60, 52, 44, 40, 34, 28)
"""Cells along the tank's shortest side, at most by degree: so many take some 20 s of one core and 800 MiB."""
NOISE_SHARE, SLANTED_NOISE_SHARE = 0.3, 0.28
"""Share of the tolerance that the source's noise may use up, and where light slants, and paths that correct it cost ten
times as much. Of six such scenes .2 takes 1.07, .36 1.24 times the time."""
SHALLOWEST = ((0.3, 5.0), (0.8, 7.0), (1.0, 5.5))
"""Least depth of the water in free paths, up to a |g|."""
STEEPEST, STEEPEST_SLANTED = 0.935, 0.87
"""g up to which scenes are solved for; where light slants paths of low orders have most of the noise beyond."""
BACKWARD = -0.1
"""g below which light that runs straight, and fine images, are left to paths: solutions are off by more than is known
of them, .9 % at .068/.998/−.35 with sides of .4 free paths, .4 % at .093/.997/−.32 with .23."""
CHANGES_CELL, CHANGES_BATCHES = 0.8, (6, 6, 6, 12, 48)
"""The same sides where changes of the image are wanted and not the image, and lattices that make each half of the
source then, by degree: the more light goes on forwards, the more noise."""
SLANTED_BATCHES = 24
"""The same, at least, where light slants, and a path stands for one start."""


@dataclass(frozen=True)
class MomentPlan:
    """How the orders above some are solved for.

    Parameters
    ----------
    above
        Highest order that is left to paths.
    degree
        Highest degree of the moments.
    side_mm
        Of the cells, about.
    batches
        Lattices of paths that make the source.
    bound
        On the error, relative L2 of the whole image.
    """

    above: int
    degree: int
    side_mm: float
    batches: int
    bound: float


def moment_plan(scene: Scene, tolerance: float, shallowest: float = 1.0) -> MomentPlan | None:
    """The plan for a scene, or None where paths serve it better.

    Solved for are scenes that paths would take seconds for: deep in free paths and in transport free paths. Backward
    scattering is left to paths where light and sight run straight, for that costs them little.

    Parameters
    ----------
    scene
        Any scene.
    tolerance
        Relative L2 error of the image to stay below.
    shallowest
        Of the depths in `SHALLOWEST`, the share from which on a solution is worth its time.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> camera = Camera("orthographic", (80, 120), 2.0)
    >>> moment_plan(Scene(Tank(), Medium(0.0001, 0.0999, 0.5), light, camera), 0.01).degree
    3
    >>> moment_plan(Scene(Tank(), Medium(0.0001, 0.0099, 0.5), light, camera), 0.01) is None
    True
    """
    medium, g = scene.medium, abs(scene.medium.g)
    shortest = min(scene.tank.size_mm)
    straight = shift_invariant(scene)
    cheapest = _cheapest(scene, (SHARE if tolerance >= FINE else FINE_SHARE) * tolerance)
    if cheapest is None or not _worth_it(scene, tolerance, shallowest):
        return None
    degree, side = cheapest
    above = 3 if degree == 0 else 5  # fewer scatterings leave beams narrower than cells
    beyond = float(medium.phase_function.moments(degree + 1)[-1])
    while above < MOST_LEFT and abs(beyond) ** above > 0.004:
        above += 1
    noise = (0.02 * (g / 0.85) ** 4 if straight else 0.012 + 0.045 * g**2) * medium.albedo**above  # of one lattice
    share = NOISE_SHARE if straight else SLANTED_NOISE_SHARE
    batches = max(4, math.ceil((noise / (share * tolerance)) ** 2))
    angular = math.hypot(0.6 * abs(beyond) ** above, OF_DEGREES[degree] * abs(beyond))
    spatial = _by_side(scene, beyond) * side**3
    # Light that fades away from the beams like exp(−κr) is spread over cells: 2 % at σt = .2, ϖ = .9, g = .2.
    fading = 3.0 * medium.sigma_a * (medium.sigma_a + medium.sigma_s * (1.0 - medium.g))
    spatial += 0.008 * (0.5 * fading * side * shortest) ** 2
    bound = math.hypot(angular, spatial, noise / math.sqrt(batches))
    return MomentPlan(above, degree, side, batches, bound) if bound <= 0.75 * tolerance else None


def _worth_it(scene: Scene, tolerance: float, shallowest: float) -> bool:
    """Whether a solution costs less than the light paths that it spares."""
    medium, straight = scene.medium, shift_invariant(scene)
    if not -0.5 < medium.g < (STEEPEST if straight else STEEPEST_SLANTED):
        return False
    if medium.g < BACKWARD and (straight or tolerance < FINE):
        return False
    depth = medium.sigma_t * min(scene.tank.size_mm)
    # The finer the image, the more lattices of slanted light it spares.
    finer = shallowest * (1.0 if straight else min(1.0, (tolerance / 0.01) ** 0.45))
    least = next(free_paths for steepest, free_paths in SHALLOWEST if abs(medium.g) < steepest)
    return depth >= finer * least and depth * (1.0 - medium.g) >= finer * 0.85


def _cheapest(scene: Scene, off: float) -> tuple[int, float] | None:
    """Degree and side of the cells in mm that together err by no more than `off`, with the fewest unknowns."""
    shortest = min(scene.tank.size_mm)
    lowest = 1 if scene.tank.surface == "fresnel" else 0  # what it sends back depends on the direction
    moments = scene.medium.phase_function.moments(len(OF_DEGREES))
    found: list[tuple[float, int, float]] = []
    for degree in range(lowest, len(OF_DEGREES)):
        beyond = float(moments[degree + 1])
        left = off**2 - (OF_DEGREES[degree] * beyond) ** 2
        if left > 0.0:
            side = min((math.sqrt(left) / _by_side(scene, beyond)) ** (1.0 / 3.0), shortest / FEWEST_CELLS)
            if side >= shortest / MOST_CELLS[degree]:
                found.append(((degree + 1) ** 2 / side**3, degree, side))
    return min(found)[1:] if found else None


def _by_side(scene: Scene, beyond: float) -> float:
    """What solutions err by for the cells' size, over the cube of their sides in mm."""
    medium = scene.medium
    scaled = medium.sigma_t - beyond * medium.sigma_s
    return float(OF_CELLS * scaled**3 + OF_FEW * (FEWEST_CELLS / min(scene.tank.size_mm)) ** 3)


def plan_of_changes(scene: Scene) -> MomentPlan | None:
    """The plan for how the image changes with the medium, near one medium; None where paths tell that well.

    A few per cent of error do, but it must have no noise: in dense water σa, σs and g change the image nearly alike,
    and what noise adds to their derivatives looks as if it told them apart.

    Parameters
    ----------
    scene
        Any scene.

    Examples
    --------
    >>> from tankrig.scene import Beam, Camera, Medium, Projector, Tank
    >>> light = Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),))
    >>> camera = Camera("orthographic", (80, 120), 2.0)
    >>> plan_of_changes(Scene(Tank(), Medium(0.0001, 0.0999, -0.3), light, camera)).degree
    2
    """
    medium, g = scene.medium, abs(scene.medium.g)
    shortest = min(scene.tank.size_mm)
    depth = medium.sigma_t * shortest
    if depth < 4.0 or depth * (1.0 - medium.g) < 0.5:
        return None
    degree, above = 2 if g < 0.4 else 3 if g < 0.8 else 4, 5
    beyond = abs(float(medium.phase_function.moments(degree + 1)[-1]))
    while above < 14 and beyond**above > 0.004:  # the derivative by g errs by five times `above` as much
        above += 1
    if beyond**above > 0.004:
        return None
    scaled = medium.sigma_t - beyond * medium.sigma_s
    side = shortest / min(max(shortest * scaled / CHANGES_CELL, FEWEST_CELLS), MOST_CELLS[degree])
    bound = math.hypot(0.6 * beyond**above, 0.001 + 0.03 * (side * scaled) ** 3)
    batches = CHANGES_BATCHES[degree] if shift_invariant(scene) else max(CHANGES_BATCHES[degree], SLANTED_BATCHES)
    return MomentPlan(above, degree, side, batches, bound)
