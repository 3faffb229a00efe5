"""Light that went astray: halo, veil and blur of lenses, a floor that reflects, a dark picture that is none.

Each changes the image by a pattern of its own, times its size: nearly so even where the size is not small, for light
that goes astray twice is faint. So sizes are fitted along linearly, and a cause is told by its pattern.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.estimation.found_optics import LEAST_PANE, of_width
from tankrig.estimation.parameters import FURTHEST_OFF, Block, Values
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.optics import MOST_HALO, MOST_VEIL, NO_HALO, PINHOLE, Blur, Face, Halo, WideLens

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Pattern = Callable[[Scene, Image], Array]
"""What an image gains per unit of a size: of a scene with the fitted liquid, and its image."""

ASTRAY = {
    "halo": 0.01, "veil": 0.01, "blur_mm2": 0.1,
    "floor": 0.05, "pane": 1.0, "black_level": 0.001, "projector_halo": 0.02, "halo_width": 0.5,
}  # fmt: skip
"""What may go astray, and by how much on a common bench: shares of the light in the camera's halo and veil, variance by
which its picture is blurred more than described; diffuse reflectance of the floor, what the entry pane's outer side
sends back as a share of what glass does, W/mm² on the wall, share of the light in the projector's halo; natural
logarithm of the camera's halo's width over what the scene says, which is fitted along wherever a halo is."""
BLUR_PARTS, BLUR_MM2 = 0.5, 0.1
"""Width of the blur that stands for any of what is smooth, in pixels; variance of that of edges."""
BENDING = 0.2
"""Share of itself by which a blur is changed to see how that changes the image."""
LENS_MM = 10.0
"""Width of the projector's lens that stands for any."""
FLOOR, FACE_LATTICES, SEED = 0.05, 8, 7
"""Reflectance that stands for any; lattices of paths for a pattern, and their seed."""
ROUGH, BATCHES = 0.05, 4
"""Tolerance and lattices of the image that a dark picture's light makes."""
WIDTH_STEP, MOST_WIDER = 0.1, 1.25
"""By which the logarithm of a halo's width is differenced, and how far it is believed to be off."""
OTHER_WIDTH, OTHER_MM = 2.0, 3.0
"""How many times as wide, or as narrow, a halo is that stands for all of another width; how much thicker, or thinner, a
pane is that stands for all of another thickness. Halves and thirds of these look alike."""
KEPT = 4
"""Patterns by light paths that are kept: up to three questions about one fit ask for the same ones."""


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
    return soft - sharp + mm2 * _soft(scene, np.asarray(image - sharp))


@lru_cache(maxsize=KEPT)
def _first_order(scene: Scene) -> Array:
    from tankrig.light.tank import low_orders

    return low_orders(scene, ROUGH, 1)


def _soft(scene: Scene, image: Image) -> Array:
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


def floor(scene: Scene, _: Image) -> Array:
    """Light by way of a diffuse floor, per unit of its reflectance."""
    return _by_faces(scene, "floor", Face("diffuse", FLOOR)) / FLOOR


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
    from tankrig.light.tangent import BY_PATHS, tank_tangent
    from tankrig.light.tank import tank_image

    lit = replace(scene, projector=replace(scene.projector, beams=beams, halo=NO_HALO, black_level=0.0))
    if smooth and scene.tank.faces.dark and not shift_invariant(scene):
        # Order 2 of rays all over the wall that slant took 5 to 19 of 6 to 20 CPU s, and paths show it within 3 %.
        return np.asarray(tank_tangent(lit, BATCHES, tables=BY_PATHS).prediction.image, float)
    return np.asarray(tank_image(lit, ROUGH, batches=BATCHES).image, float)


def gamma(_: Scene, image: Image) -> Array:
    """Levels with an exponent a little above 1, per unit of it."""
    bright = float(np.max(image))
    share = np.maximum(np.asarray(image, float) / bright, 1e-12) if bright > 0.0 else np.ones(np.shape(image))
    return np.asarray(image * np.log(share))


PATTERNS: dict[str, Pattern] = {
    "halo": halo, "veil": veil, "blur_mm2": blur,
    "floor": floor, "pane": panes, "black_level": black_level, "projector_halo": projector_halo,
}  # fmt: skip


@dataclass(frozen=True)
class Sign:
    """A cause of structure in a residual that is told by its own pattern.

    Parameters
    ----------
    pattern
        What an image gains per unit of its size.
    along
        Name in `ASTRAY` of what it is fitted along as; empty where it is not.
    most
        Size that it has at most; what is larger has another cause.
    least
        Size that it has at least where there is any: glass that reflects hardly any light is none.
    described
        Whether a scene has it: then it may be less than described, too.
    slow
        Whether it takes longer than a fit of a prepared model.
    quick
        A pattern that does for such a fit; None where it is not slow, or where none does.
    asked
        Whether it is looked for in a scene: what a scene describes is no cause, and no halo has another width where
        there is none.
    of_found
        Whether it is of what was fitted along as well as of what was described.
    of_image
        Whether it is made of the image, whose noise it then has.
    """

    pattern: Pattern
    along: str = ""
    most: float = np.inf
    least: float = 0.0
    described: Callable[[Scene], bool] = lambda _: False
    slow: bool = False
    quick: Pattern | None = None
    asked: Callable[[Scene], bool] = lambda _: True
    of_found: bool = False
    of_image: bool = False

    def sizes(self, scene: Scene) -> tuple[float, float]:
        """From and to what it is believed; a floor does not swallow light that is not there."""
        return (-self.most if self.described(scene) else self.least), self.most


def _may_be_wide(scene: Scene) -> bool:
    return scene.projector.kind != "collimated" and scene.projector.wide_lens.diameter_mm == 0.0


def _camera_has_halo(scene: Scene) -> bool:
    return scene.camera.halo.share > 0.0


def _projector_has_halo(scene: Scene) -> bool:
    return scene.projector.halo.share > 0.0


def _has_pane(scene: Scene) -> bool:
    return scene.tank.faces.entry.kind == "glass"


MOST_TIMES, MOST_MM = 2.0, 20.0
"""How far off a halo's width is believed, in steps from it to `OTHER_WIDTH` times it, and a pane's thickness."""
SIGNS: dict[str, Sign] = {
    "a halo of the camera's lens": Sign(
        halo, "halo", MOST_HALO, described=lambda scene: scene.camera.halo.share > 0.0, of_image=True
    ),
    "a veil of the camera's lens": Sign(
        veil, "veil", MOST_VEIL, described=lambda scene: scene.camera.veil > 0.0, of_image=True
    ),
    "blur that the scene does not describe": Sign(
        blur,
        "blur_mm2",
        described=lambda scene: scene.camera.blur.widest_mm + scene.projector.blur.sigma_mm > 0.0,
        quick=_soft,
        of_image=True,
    ),
    "a wide lens of the projector, sharp at one distance only": Sign(wide_lens, slow=True, asked=_may_be_wide),
    "light that the floor reflects": Sign(floor, "floor", 1.0, asked=lambda scene: scene.tank.faces.floor.dark),
    "light that the entry pane's outer side reflects": Sign(
        panes, "pane", least=LEAST_PANE, slow=True, asked=lambda scene: scene.tank.faces.entry.dark
    ),
    "light of dark parts of the projector's picture": Sign(
        black_level, "black_level", described=lambda scene: scene.projector.black_level > 0.0, slow=True
    ),
    "counts that are not in proportion to the light": Sign(gamma, most=1.0, described=lambda _: True, of_image=True),
    "a wider halo of the camera's lens": Sign(
        partial(other_halo, times=OTHER_WIDTH), "halo_width", MOST_TIMES, asked=_camera_has_halo, of_found=True,
        of_image=True,
    ),
    "a narrower halo of the camera's lens": Sign(
        partial(other_halo, times=1.0 / OTHER_WIDTH), "halo_width", MOST_TIMES, asked=_camera_has_halo, of_found=True,
        of_image=True,
    ),
    "a wider halo of the projector's lens": Sign(
        partial(other_projector_halo, times=OTHER_WIDTH), most=MOST_TIMES, slow=True, asked=_projector_has_halo,
        of_found=True,
    ),
    "a narrower halo of the projector's lens": Sign(
        partial(other_projector_halo, times=1.0 / OTHER_WIDTH), most=MOST_TIMES, slow=True, asked=_projector_has_halo,
        of_found=True,
    ),
    "a thicker entry pane": Sign(
        partial(other_pane, more_mm=OTHER_MM), most=MOST_MM, slow=True, asked=_has_pane, of_found=True
    ),
    "a thinner entry pane": Sign(
        partial(other_pane, more_mm=-OTHER_MM), most=MOST_MM, slow=True,
        asked=lambda scene: _has_pane(scene) and pane_mm(scene) > 0.0, of_found=True,
    ),
}  # fmt: skip
"""Causes of structure in a residual, as the verdict names them."""


def causes(
    scene: Scene, image: Image, quick: bool = False, found: Scene | None = None
) -> dict[str, Callable[[], list[Array]]]:
    """Name of each cause and what it changes, for `tankrig.estimation.residual.likely_cause`.

    Parameters
    ----------
    scene
        With the fitted liquid. What it says of faces and of a wide lens is no cause any more.
    image
        (rows, columns) that the model gives of it.
    quick
        Leave out what takes longer than a fit of a prepared model.
    found
        The scene with what was fitted along, see `as_found`; None where nothing was.
    """
    found = scene if found is None else found

    def changes(pattern: Pattern, of: Scene) -> list[Array]:
        return [pattern(of, image)]

    return {
        name: partial(
            changes, sign.quick if quick and sign.quick is not None else sign.pattern, found if sign.of_found else scene
        )
        for name, sign in SIGNS.items()
        if sign.asked(found) and not (quick and sign.slow)
    }


@dataclass(frozen=True)
class Astray:
    """What may go astray in a scene.

    Parameters
    ----------
    scene
        As described.
    sd
        Standard deviation of each size, by its name in `ASTRAY`.
    patterns
        (terms, rows, columns) what one standard deviation adds; None before `at`.
    beside
        (rows, columns) what is added besides, as patterns bend with their size.
    """

    scene: Scene
    sd: Mapping[str, float]
    patterns: Array | None = None
    beside: Array | float = 0.0

    def __post_init__(self) -> None:
        for name, sd in self.sd.items():
            require_sd(name, sd)
        if "halo" in self.sd and "halo_width" not in self.sd:
            object.__setattr__(self, "sd", {**self.sd, "halo_width": ASTRAY["halo_width"]})

    def at(self, medium: Medium, image: Image, sizes: Array) -> "Astray":
        """The same with the patterns of a liquid and its image, at sizes in standard deviations."""
        scene, beside = replace(self.scene, medium=medium), np.zeros(image.shape)
        found = {name: float(size) * sd for (name, sd), size in zip(self.sd.items(), sizes, strict=True)}
        wider = of_width(scene, found.get("halo_width", 0.0))
        patterns = []
        for name, sd in self.sd.items():
            mm2 = found[name]
            if name == "halo_width":
                slope = _by_width(scene, image, found)
                described = other_halo(scene, image, np.exp(found[name]))
                beside = beside + described - found[name] * slope
                patterns.append(sd * slope)
            elif name == "blur_mm2" and mm2 > BENDING * BLUR_MM2:
                here = more_blur(scene, image, mm2)
                slope = (more_blur(scene, image, (1.0 + BENDING) * mm2) - here) / (BENDING * mm2)
                beside = beside + here - mm2 * slope
                patterns.append(sd * slope)
            else:
                patterns.append(sd * PATTERNS[name](wider, image))
        return replace(self, patterns=np.stack(patterns), beside=beside)


@dataclass(frozen=True)
class AstrayBlock(Block):
    """Sizes of what goes astray, in standard deviations from what is described.

    Sizes are of lenses and tank, so they are the same in all images.

    Parameters
    ----------
    astray
        Of each image, with patterns.
    weight
        (k,) as for `tankrig.estimation.set_up.SetUpBlock`.
    """

    astray: tuple[Astray, ...]
    weight: Array
    name: ClassVar[str] = "astray"

    @property
    def sd(self) -> Mapping[str, float]:
        """Standard deviation of each size before anything was seen."""
        return self.astray[0].sd

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sizes."""
        return tuple(self.sd)

    @property
    def low(self) -> Array:
        """As far as is believed."""
        return -self.high

    @property
    def high(self) -> Array:
        """As far as is believed."""
        return np.array([MOST_WIDER / sd if name == "halo_width" else FURTHEST_OFF for name, sd in self.sd.items()])

    @property
    def prior_weight(self) -> Array:
        """As given."""
        return self.weight

    def added_in(self, view: int, values: Values, liquid: Medium) -> Image:
        """Sizes times patterns, as they bend."""
        return np.asarray(np.tensordot(values[self.name], self._patterns(view), 1) + self.astray[view].beside)

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """The patterns of the first image."""
        return self._patterns(0)

    def changes_in(self, view: int, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """Those of a view."""
        return self._patterns(view)

    def _patterns(self, view: int) -> Array:
        patterns = self.astray[view].patterns
        assert patterns is not None
        return patterns


def unmeasured(scene: Scene) -> dict[str, float]:
    """What may go astray on a calibrated bench and nobody has measured, with usual standard deviations.

    Halo and veil are known once `tankrig calibrate stray` has found any. No calibration measures the floor: it reflects
    some per cent unless its scene says otherwise, which no residual need show and σa, σs and g follow. Of a camera that
    is only described nothing is expected that its scene does not say.
    """
    camera, names = scene.camera, []
    if camera.kind != "calibrated":
        return {}
    if camera.halo.share == 0.0 and camera.veil == 0.0:
        names += ["halo", "veil"]
    if scene.tank.faces.floor.dark:
        names += ["floor"]
    return {name: ASTRAY[name] for name in names}


def require_sd(name: str, sd: object) -> None:
    """Complain about what is no standard deviation of what may go astray.

    Raises
    ------
    SceneError
        In one sentence.
    """
    if not (isinstance(sd, float | int) and np.isfinite(sd) and sd > 0.0):
        raise SceneError(f"nuisance {name} = {sd!r} is no standard deviation; give a positive number")


def _by_width(scene: Scene, image: Image, found: Mapping[str, float]) -> Array:
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
def _by_faces(scene: Scene, name: str, face: Face) -> Array:
    """What one face sends back, the others as described: order 1 and more, as the camera shows it."""
    from tankrig.light.behind_lenses import more_by_faces

    faces, without = (replace(scene.tank.faces, **{name: one}) for one in (face, Face()))
    return more_by_faces(scene, faces, without, SEED, FACE_LATTICES)[0]
