"""What an image gains from light that goes astray, a pattern for each cause.

Per unit of its size, unless it says otherwise, of a scene with the fitted liquid and its image.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.found_optics import of_width
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.optics import NO_HALO, PINHOLE, Blur, Face, Halo, WideLens

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Pattern = Callable[[Scene, Image], Array]
"""What an image gains."""

BLUR_PARTS, BLUR_MM2 = 0.5, 0.1
"""Width of the blur that stands for any of what is smooth, in pixels; variance of that of edges."""
LENS_MM = 10.0
"""Width of the projector's lens that stands for any."""
FLOOR, FACE_LATTICES, SEED = 0.05, 8, 7
"""Reflectance that stands for any; lattices of paths for a pattern, and their seed."""
FLOOR_LATTICES = 64
"""Lattices for a floor's pattern at one of the liquids nearby; eight tell how it is otherwise at others. Eight alone
left ± 6 % over blocks of 50 mm, at all doses alike: σs of a bench with all effects came out 1.8, .8 and .6 % too large
at three doses, by 64 .4, .6 and .2, and of the thin one was known half as well."""
WATER = Medium(0.0, 1e-6, 0.0)
"""Stands for any liquid where scenes are told apart by all else."""
MATT = Face("diffuse", FLOOR)
"""A floor of that reflectance."""
ROUGH, BATCHES = 0.05, 4
"""Tolerance and lattices of the image that a dark picture's light makes."""
WIDTH_STEP = 0.1
"""By which the logarithm of a halo's width is differenced."""
KEPT = 24
"""Patterns by light paths that are kept: up to three questions about one fit ask for the same ones, and a run's fits,
of two patterns at three doses, ask again and again."""
ALIKE_SIGMA_T, ALIKE_ALBEDO, ALIKE_G = 0.008, 0.004, 0.004
"""Steps of σt's logarithm, of albedo and of g within which liquids have one pattern of a floor: its light changes by .5
% there, and steps 2.5 times as wide had floors found 1.6 % too small. A pattern takes .3 to .5 CPU s by eight
lattices."""
NEAR_SIGMA_T, NEAR_ALBEDO, NEAR_G = 0.06, 0.03, 0.016
"""The same within which the many lattices at one liquid serve for the others: the eight differ from those at one by
.12 to .31 of their own variance where it is .4 to 3 % away in σt, and by .86 where it is 10 %."""


def halo(scene: Scene, image: Image) -> Array:
    """More light in the camera's halo, of the width that the scene says."""
    return _blurred(scene, image, scene.camera.halo.sigma_mm) - image


def veil(_: Scene, image: Image) -> Array:
    """More light in its veil."""
    return np.asarray(float(np.mean(image)) - image)


def blur(scene: Scene, image: Image) -> Array:
    """More blur, per mm² of variance, by the one that stands for any."""
    return more_blur(scene, image, BLUR_MM2) / BLUR_MM2


def more_blur(scene: Scene, image: Image, mm2: float) -> Array:
    """What an image gains when the camera blurs by a variance more.

    Order 1 has its edges within pixels, and is blurred there: blur of .3 mm moves light over an edge that pixels of
    4 mm share by another pattern, and ten times as much, as if the pixels themselves had been blurred.
    """
    camera = scene.camera
    widths = [
        None if one is None else float(np.hypot(one, np.sqrt(mm2)))
        for one in (camera.blur.sigma_mm, camera.blur.corner_mm)
    ]
    blurred = replace(scene, camera=replace(camera, blur=Blur(widths[0] or 0.0, widths[1])))
    sharp, soft = _first_order(scene), _first_order(blurred)
    return soft - sharp + mm2 * soft_blur(scene, np.asarray(image - sharp))


@lru_cache(maxsize=KEPT)
def _first_order(scene: Scene) -> Array:
    from tankrig.light.tank import low_orders

    return low_orders(scene, ROUGH, 1)


def blur_of_moved_light(scene: Scene, image: Image) -> Array:
    """Nearly the same in a tenth of the time: order 1 blurred along y by light moved to both sides, across as what is
    smooth.

    Through pinholes it is like the other by a cosine of .88 to 1.00. It is the other itself where that saves nothing:
    an orthographic camera's order 1 takes .2 CPU s at most, and where blur is described each picture is as fine.
    """
    if scene.camera.kind == "orthographic" or scene.camera.blur.widest_mm + scene.projector.blur.sigma_mm > 0.0:
        return blur(scene, image)
    aside_mm = math.sqrt(3.0 * BLUR_MM2)  # with a sixth of the light on either side, a Gaussian of that variance
    sharp = _first_order(scene)
    asides = sum(_first_order(_moved(scene, by_mm)) for by_mm in (aside_mm, -aside_mm))
    return np.asarray((asides - 2.0 * sharp) / (6.0 * BLUR_MM2) + soft_blur(scene, image - sharp))


def _moved(scene: Scene, by_mm: float) -> Scene:
    """The scene with its light moved along y."""
    light = scene.projector
    beams = tuple(replace(one, y_mm=(one.y_mm[0] + by_mm, one.y_mm[1] + by_mm)) for one in light.beams)
    position = light.position_mm
    if position is not None:
        position = (position[0], position[1] + by_mm, position[2])
    return replace(scene, projector=replace(light, beams=beams, position_mm=position))


def soft_blur(scene: Scene, image: Image) -> Array:
    """What is smooth gains by blur, per mm²."""
    sigma_mm = BLUR_PARTS * min(scene.camera.sides_mm)
    return np.asarray((_blurred(scene, image, sigma_mm) - image) / sigma_mm**2)


def wide_lens(scene: Scene, _: Image) -> Array:
    """Light that is sharp in the middle of the tank only: orders 1 and 2, which have the edges."""
    from tankrig.light.tank import low_orders

    lens = WideLens(LENS_MM, 0.5 * scene.tank.size_mm[0])
    sharp = replace(scene.projector, halo=NO_HALO, black_level=0.0)  # what is smooth stays what it is
    narrow, wide = (replace(scene, projector=replace(sharp, wide_lens=one)) for one in (PINHOLE, lens))
    return low_orders(wide, ROUGH) - low_orders(narrow, ROUGH)


def floor(scene: Scene, image: Image) -> Array:
    """Light by way of a diffuse floor, per unit of its reflectance; of a liquid that is nearly the scene's."""
    nearby = replace(scene, medium=_among(scene.medium, NEAR_SIGMA_T, NEAR_ALBEDO, NEAR_G))
    return floor_by_few(scene, image) + _more_of_floor(_Nearby.of(nearby)) / FLOOR


def floor_by_few(scene: Scene, _: Image) -> Array:
    """The same in a ninth of the time, with 6 % of noise over blocks of 50 mm."""
    here = replace(scene, medium=_among(scene.medium, ALIKE_SIGMA_T, ALIKE_ALBEDO, ALIKE_G))
    return _by_faces(here, "floor", MATT) / FLOOR


@dataclass(frozen=True)
class _Nearby:
    """A scene that equals others whose liquids are within the same steps of σt, albedo and g: of any phase function the
    first that is asked for stands for them, since a fit of one comes to the same liquid again and again."""

    scene: Scene = field(compare=False)
    others: Scene
    """With water in place of its liquid."""
    steps: tuple[int, int, int]

    @classmethod
    def of(cls, scene: Scene) -> "_Nearby":
        """A scene, told by all but its liquid, and by the steps that this is within."""
        steps = _steps(scene.medium, NEAR_SIGMA_T, NEAR_ALBEDO, NEAR_G)
        return cls(scene, replace(scene, medium=WATER), steps)


@lru_cache(maxsize=KEPT)
def _more_of_floor(nearby: _Nearby) -> Array:
    """What many lattices show of light by way of a floor that few do not: they err nearly alike at liquids nearby."""
    scene = nearby.scene
    return _by_faces(scene, "floor", MATT, FLOOR_LATTICES) - _by_faces(scene, "floor", MATT)


def _among(medium: Medium, step: float, albedo_step: float, g_step: float) -> Medium:
    """The liquid that stands for those nearby, in steps of σt's logarithm, albedo and g; of another phase function than
    Henyey–Greenstein's none does."""
    if medium.phase is not None or medium.sigma_t <= 0.0:
        return medium
    of_sigma_t, of_albedo, of_g = _steps(medium, step, albedo_step, g_step)
    sigma_t = math.exp(step * of_sigma_t)
    albedo, g = albedo_step * (of_albedo + 0.5), g_step * (of_g + 0.5)
    albedo, g = min(albedo, 1.0 - 0.5 * albedo_step), min(g, 1.0 - 0.5 * g_step)
    return Medium((1.0 - albedo) * sigma_t, albedo * sigma_t, g)


def _steps(medium: Medium, step: float, albedo_step: float, g_step: float) -> tuple[int, int, int]:
    """Numbers of the steps of σt's logarithm, albedo and g that a liquid is within."""
    logarithm = math.log(max(medium.sigma_t, 1e-300))
    return round(logarithm / step), math.floor(medium.albedo / albedo_step), math.floor(medium.g / g_step)


def panes(scene: Scene, _: Image) -> Array:
    """Light that glass with air behind it sends back at the entry wall."""
    return _by_faces(scene, "entry", replace(scene.tank.faces.entry, kind="glass"))


def black_level(scene: Scene, _: Image) -> Array:
    """Light all over the wall, per W/mm²."""
    width, height = scene.tank.size_mm[1:]
    return _lit_by(scene, (Beam((-0.5 * width, 0.5 * width), (0.0, height)),), smooth=True)


def projector_halo(scene: Scene, _: Image) -> Array:
    """More light in the projector's halo, of the width that the scene says."""
    from tankrig.light.entering import in_halo

    return _lit_by(scene, tuple(in_halo(scene, 1.0, fine=True))) - _lit_by(scene, scene.projector.beams)


def other_halo(scene: Scene, image: Image, times: float) -> Array:
    """The camera's halo spread so many times as wide as described."""
    halo = scene.camera.halo
    return np.asarray(
        halo.share * (_blurred(scene, image, times * halo.sigma_mm) - _blurred(scene, image, halo.sigma_mm))
    )


def other_projector_halo(scene: Scene, _: Image, times: float) -> Array:
    """The same of the projector's."""
    from tankrig.light.entering import in_halo

    light = scene.projector
    widths = light.halo.sigma_mm, times * light.halo.sigma_mm
    lit = (replace(scene, projector=replace(light, halo=Halo(light.halo.share, one))) for one in widths)
    as_described, other = (_lit_by(one, tuple(in_halo(one, 1.0, fine=True))) for one in lit)
    return np.asarray(light.halo.share * (other - as_described))


def other_pane(scene: Scene, _: Image, more_mm: float) -> Array:
    """What the entry pane sends back where it is thicker than described, or thinner: per mm."""
    entry, thickness_mm = scene.tank.faces.entry, pane_mm(scene)
    more_mm = max(more_mm, -thickness_mm)
    other = _by_faces(scene, "entry", replace(entry, thickness_mm=thickness_mm + more_mm))
    return np.asarray((other - _by_faces(scene, "entry", entry)) / abs(more_mm))


def pane_mm(scene: Scene) -> float:
    """Thickness of the entry pane, as described."""
    described = scene.tank.faces.entry.thickness_mm
    return scene.tank.wall_mm if described is None else described


@lru_cache(maxsize=KEPT)
def _lit_by(scene: Scene, beams: tuple[Beam, ...], smooth: bool = False) -> Array:
    """The image of other beams than a scene's; `smooth` where none of them has an edge inside the tank."""
    from tankrig.light.rays import shift_invariant
    from tankrig.light.tangent import BY_PATHS, tank_steady
    from tankrig.light.tank import tank_image

    lit = replace(scene, projector=replace(scene.projector, beams=beams, halo=NO_HALO, black_level=0.0))
    if smooth and scene.tank.faces.dark and not shift_invariant(scene):
        # Order 2 of rays all over the wall that slant took 5 to 19 of 6 to 20 CPU s, and paths show it within 3 %.
        return np.asarray(tank_steady(lit, BATCHES, tables=BY_PATHS).image, float)
    return np.asarray(tank_image(lit, ROUGH, batches=BATCHES).image, float)


def gamma(_: Scene, image: Image) -> Array:
    """Levels with an exponent a little above 1, per unit of it."""
    bright = float(np.max(image))
    share = np.maximum(np.asarray(image, float) / bright, 1e-12) if bright > 0.0 else np.ones(np.shape(image))
    return np.asarray(image * np.log(share))


def by_width(scene: Scene, image: Image, found: Mapping[str, float]) -> Array:
    """Derivative of an image by the logarithm of its halo's width, where so much of both was found."""
    widths = (of_width(scene, found["halo_width"] + step).camera.halo.sigma_mm for step in (WIDTH_STEP, -WIDTH_STEP))
    wide, narrow = (_blurred(scene, image, width) for width in widths)
    return np.asarray((scene.camera.halo.share + found.get("halo", 0.0)) * (wide - narrow) / (2.0 * WIDTH_STEP))


def _blurred(scene: Scene, image: Image, sigma_mm: float) -> Array:
    from scipy.ndimage import correlate1d, gaussian_filter1d

    found = np.asarray(image, float)
    for axis, side in enumerate(scene.camera.sides_mm):
        pixels = sigma_mm / side
        if pixels >= 1.0:
            found = np.asarray(gaussian_filter1d(found, pixels, axis=axis, mode="constant"))
        else:
            half = 0.5 * pixels**2  # weights with just that variance
            found = np.asarray(correlate1d(found, [half, 1.0 - 2.0 * half, half], axis=axis, mode="constant"))
    return found


@lru_cache(maxsize=KEPT)
def _by_faces(scene: Scene, name: str, face: Face, lattices: int = FACE_LATTICES) -> Array:
    """What one face sends back, the others as described: order 1 and more, as the camera shows it."""
    from tankrig.light.behind_lenses import more_by_faces

    faces, without = (replace(scene.tank.faces, **{name: one}) for one in (face, Face()))
    return more_by_faces(scene, faces, without, SEED, lattices)[0]
