"""Light beside the beams' own: of the projector's halo and dark, and by way of the floor and the entry pane.

It adds to an image in proportion to a size, and its own image follows the liquid: a black level that is a fifth of the
light moves a fit into another valley where it is looked for in one liquid's image only. But it is smooth and mostly a
few per cent, so that few paths do, and one liquid's image and derivatives do for others nearby.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.astray import AstrayBlock, require_sd
from tankrig.estimation.astray_patterns import FLOOR
from tankrig.estimation.followed import Followed, Model, Solved
from tankrig.estimation.parameters import FURTHEST_OFF, Block, Values
from tankrig.prediction import Prediction
from tankrig.scene import Beam, Medium, Scene
from tankrig.scene.optics import ALL_BLACK, NO_HALO, PINHOLE, SHARP, Face, Faces

Array = NDArray[np.float64]
Image = NDArray[np.floating]
Told = tuple[Array, Array, Array]
"""(rows, columns) image of a liquid, (3, rows, columns) its derivatives by σa, σs and g, and its standard error."""

BESIDE = ("projector_halo", "black_level", "floor", "pane")
"""Names in `ASTRAY` of light that is fitted along from the first look on."""
NEAR, ROUGHLY_NEAR = 0.04, 0.1
"""How far from a liquid its image is expanded to others, in log σs, σa times the tank's length and g over 1 − g²: of
what is fitted, and of what a search looks at."""
MOST_BENT = 1.0
"""Logarithm of a pixel's change by an expansion, at most."""
KNOWN = 12
"""Liquids whose images are kept."""
ROUGH_LATTICES, SLOPE_LATTICES, LATTICES = 4, 6, 24
"""Lattices of paths: small ones in what a search looks at and for derivatives, large ones in what is fitted. Two, whose
noise is not told from light where rays slant, were 20 to 100 % of a halo off, and four 2 to 10 % at the same price."""
ROUGH_BY_FACES, BY_FACES = 12, 40
"""The same, large ones all, for light by way of faces; derivatives are as rough as the image looked at. By one, four
clear walls were 3 % of the image off, and moved σs by 6 %."""
FAINT_ROUGH = 4
"""Lattices of light by way of a faint face in what is looked at: one shows more noise than light."""
TOLERANCE, SEED = 0.05, 17
STEPS = (0.02, 0.03, 0.03)
"""By which light by faces is differenced: of σa times the tank's length, of σs, and of 1 − g²."""


@dataclass(frozen=True, eq=False)
class Expanded:
    """An image without negative pixels that is computed for a few liquids, and expanded about these to others.

    The logarithm of each pixel is taken to be linear: how light fades is, and how it goes with σs nearly.

    Parameters
    ----------
    told
        From a liquid to its image and derivatives.
    length_mm
        Longest side of the tank.
    near
        How far images are expanded, see `NEAR`.
    """

    told: Callable[[Medium], Told]
    length_mm: float
    near: float
    known: list[tuple[Medium, Told]] = field(default_factory=list)

    def image(self, liquid: Medium) -> Array:
        """(rows, columns) of a liquid."""
        at, (image, slopes, _) = self._about(liquid)
        change = np.tensordot(np.array(liquid.coefficients) - at.coefficients, slopes, 1)
        share = np.divide(change, image, out=np.zeros_like(image), where=image > 1e-9 * image.max(initial=0.0))
        return np.asarray(image * np.exp(np.clip(share, -MOST_BENT, MOST_BENT)))

    def slopes(self, liquid: Medium) -> Array:
        """(3, rows, columns) derivatives by σa, σs and g."""
        return self._about(liquid)[1][1]

    def stderr(self, liquid: Medium) -> Array:
        """(rows, columns) standard error of the image."""
        return self._about(liquid)[1][2]

    def _about(self, liquid: Medium) -> tuple[Medium, Told]:
        plain = Medium(*liquid.coefficients)
        off = [self._off(plain, at) for at, _ in self.known]
        if off and min(off) <= self.near:
            return self.known[int(np.argmin(off))]
        self.known.append((plain, self.told(plain)))
        del self.known[:-KNOWN]
        return self.known[-1]

    def _off(self, one: Medium, other: Medium) -> float:
        turned = abs(one.g - other.g) / ((1.0 - other.g) * (1.0 + other.g))
        absorbed = self.length_mm * abs(one.sigma_a - other.sigma_a)
        return max(abs(float(np.log(one.sigma_s / other.sigma_s))), absorbed, turned)


@dataclass(frozen=True, eq=False)
class Beside:
    """Light of one cause, per unit of its size: images that are added up, each times a number.

    Parameters
    ----------
    parts
        Number and image.
    """

    parts: tuple[tuple[float, Expanded], ...]

    def image(self, liquid: Medium) -> Array:
        """(rows, columns) of a liquid."""
        return np.asarray(sum(times * part.image(liquid) for times, part in self.parts))

    def slopes(self, liquid: Medium) -> Array:
        """(3, rows, columns) derivatives by σa, σs and g."""
        return np.asarray(sum(times * part.slopes(liquid) for times, part in self.parts))

    def stderr(self, liquid: Medium) -> Array:
        """(rows, columns) standard error of the image."""
        return np.asarray(np.sqrt(sum((times * part.stderr(liquid)) ** 2 for times, part in self.parts)))


def light_beside(scene: Scene, name: str, rough: bool = False) -> Beside:
    """Light of a cause beside what a scene describes, per unit of its size.

    Parameters
    ----------
    scene
        Its medium does not matter.
    name
        Of `BESIDE`: a share of the light in the projector's halo, W/mm² of a dark picture, the floor's diffuse
        reflectance, and what the entry pane's outer side sends back as a share of what glass does.
    rough
        Whether it is only looked at.
    """
    light, camera = scene.projector, replace(scene.camera, blur=SHARP, halo=NO_HALO, veil=0.0)
    plain = replace(scene, camera=camera, projector=replace(light, halo=NO_HALO, black_level=0.0))
    if name == "black_level":
        return Beside(((1.0, _entered(plain, (all_over(scene),), rough)),))
    if name == "projector_halo":
        lost = _entered(plain, light.beams, rough)
        return Beside(((1.0, _entered(plain, in_its_halo(scene, rough), rough)), (-1.0, lost)))
    described = scene.tank.faces
    if name == "floor":
        few = FAINT_ROUGH if rough else BY_FACES
        return Beside(((1.0 / FLOOR, _sent_back(scene, "floor", Face("diffuse", FLOOR), rough, few)),))
    pane = replace(described.entry, kind="glass")
    return Beside(((1.0, _sent_back(scene, "entry", pane, rough, ROUGH_BY_FACES if rough else BY_FACES)),))


def described_beside(scene: Scene, rough: bool = False) -> tuple[Scene, Beside]:
    """A scene without the light beside that it describes, and that light.

    Parameters
    ----------
    scene
        Its medium does not matter.
    rough
        Whether the light is only looked at.
    """
    light, tank = scene.projector, scene.tank
    share = light.halo.share
    beams = tuple(replace(beam, irradiance=(1.0 - share) * beam.irradiance) for beam in light.beams)
    bare = replace(light, beams=beams, halo=NO_HALO, black_level=0.0)
    parts: list[tuple[float, Expanded]] = []
    if share > 0.0:
        parts.append((share, _entered(replace(scene, projector=bare), in_its_halo(scene, rough), rough)))
    if light.black_level > 0.0:
        parts.append((light.black_level, _entered(replace(scene, projector=bare), (all_over(scene),), rough)))
    if not tank.faces.dark:
        few = ROUGH_BY_FACES if any(tank.faces.clear) else FAINT_ROUGH
        parts.append((1.0, _by_way_of(scene, tank.faces, ALL_BLACK, rough, few if rough else BY_FACES)))
    return replace(scene, tank=replace(tank, faces=ALL_BLACK), projector=bare), Beside(tuple(parts))


def all_over(scene: Scene) -> Beam:
    """A beam of irradiance 1 all over the wall that light enters through."""
    _, width, height = scene.tank.size_mm
    return Beam((-0.5 * width, 0.5 * width), (0.0, height))


def in_its_halo(scene: Scene, rough: bool) -> tuple[Beam, ...]:
    """All light of a projector as its halo spreads it."""
    from tankrig.light.entering import in_halo

    return tuple(in_halo(scene, 1.0, fine=not rough))


def _entered(scene: Scene, beams: Sequence[Beam], rough: bool) -> Expanded:
    """The image of light that enters as other beams than a scene's, and meets dark walls."""
    from tankrig.light.paths.block import SMALL
    from tankrig.light.tangent import BY_PATHS, tank_tangent
    from tankrig.light.tank import tank_image

    light = replace(scene.projector, beams=tuple(beams), wide_lens=PINHOLE, blur=SHARP)
    lit = replace(scene, projector=light, tank=replace(scene.tank, faces=ALL_BLACK))

    def told(liquid: Medium) -> Told:
        one = replace(lit, medium=liquid)
        found = tank_tangent(one, ROUGH_LATTICES if rough else SLOPE_LATTICES, SEED, None, SMALL, tables=BY_PATHS)
        image = found.prediction if rough else tank_image(one, TOLERANCE, seed=SEED, batches=LATTICES)
        stderr = np.zeros(lit.camera.shape) if image.stderr is None else np.asarray(image.stderr, float)
        return np.asarray(image.image, float), found.slopes, stderr

    return Expanded(told, max(scene.tank.size_mm), ROUGHLY_NEAR if rough else NEAR)


def _sent_back(scene: Scene, name: str, face: Face, rough: bool, lattices: int) -> Expanded:
    """The image of light by way of one face that is not described, alone or by the others besides."""
    faces = scene.tank.faces
    return _by_way_of(scene, replace(faces, **{name: face}), replace(faces, **{name: Face()}), rough, lattices)


def _by_way_of(scene: Scene, with_it: Faces, without: Faces, rough: bool, lattices: int) -> Expanded:
    """The image of light by way of faces, less that by way of others."""
    from tankrig.light.behind_lenses import more_by_faces

    length_mm = max(scene.tank.size_mm)
    few = min(lattices, ROUGH_BY_FACES if any(with_it.clear) else FAINT_ROUGH)

    def image(liquid: Medium) -> Array:
        return more_by_faces(replace(scene, medium=liquid), with_it, without, SEED, few)[0]

    def told(liquid: Medium) -> Told:
        here, stderr = image(liquid), np.zeros(scene.camera.shape)
        steps = {
            "sigma_a": STEPS[0] / length_mm,
            "sigma_s": STEPS[1] * liquid.sigma_s,
            "g": STEPS[2] * (1.0 - liquid.g**2) * (-1.0 if liquid.g > 0.0 else 1.0),
        }
        ahead = [replace(liquid, **{one: getattr(liquid, one) + step}) for one, step in steps.items()]
        slopes = [(image(one) - here) / step for one, step in zip(ahead, steps.values(), strict=True)]
        if lattices > few:
            here, stderr = more_by_faces(replace(scene, medium=liquid), with_it, without, SEED, lattices)
        return here, np.stack(slopes), stderr

    return Expanded(told, length_mm, ROUGHLY_NEAR if rough else NEAR)


@dataclass(frozen=True, eq=False)
class WithBeside:
    """A model of the light of a scene's beams, with the light beside it that the scene describes.

    Parameters
    ----------
    main
        Of the beams' own, with derivatives along its paths.
    light
        The other.
    """

    main: Followed | Solved
    light: Beside

    def __call__(self, medium: Medium) -> Prediction:
        """The beams' own light and that beside it."""
        return with_light(self.main(medium), self.light, medium)

    def slopes(self, medium: Medium) -> Array:
        """(3, rows, columns) derivatives by σa, σs and g."""
        return np.asarray(self.main.slopes(medium) + self.light.slopes(medium))

    def slopes_noise(self, medium: Medium) -> Array:
        """(n, 3, rows, columns) patterns of their noise, without the little that the other light has."""
        return np.asarray(self.main.slopes_noise(medium))


def is_solved(model: Model) -> bool:
    """Whether high orders of its beams' own light are solved for."""
    return isinstance(model.main if isinstance(model, WithBeside) else model, Solved)


def with_light(main: Prediction, light: Beside, medium: Medium) -> Prediction:
    """A prediction with the image of light beside added, and its error."""
    known = 0.0 if main.stderr is None else np.asarray(main.stderr, float)
    stderr = np.hypot(known, light.stderr(medium))
    return replace(main, image=main.image + light.image(medium), orders=MappingProxyType({}), stderr=stderr)


@dataclass(frozen=True)
class BesideBlock(Block):
    """Sizes of light beside the beams' own, in standard deviations from what is described.

    Parameters
    ----------
    scene
        Of all images.
    sd
        Standard deviation of each size, by its name in `BESIDE`.
    lights
        Of each size.
    weight
        (k,) as for `tankrig.estimation.set_up.SetUpBlock`.
    """

    scene: Scene
    sd: Mapping[str, float]
    lights: tuple[Beside, ...]
    weight: Array
    name: ClassVar[str] = "beside"

    @classmethod
    def of(cls, scene: Scene, sd: Mapping[str, float]) -> "BesideBlock":
        """The block of a scene's images, with the standard deviation of each size."""
        lights = tuple(light_beside(scene, name) for name in sd)
        return cls(scene, sd, lights, np.ones(len(sd)))

    def __post_init__(self) -> None:
        for name, sd in self.sd.items():
            require_sd(name, sd)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sizes."""
        return tuple(self.sd)

    @property
    def low(self) -> Array:
        """No light is less than none."""
        return np.array([max(-described(self.scene, name) / sd, -FURTHEST_OFF) for name, sd in self.sd.items()])

    @property
    def prior_weight(self) -> Array:
        """As given."""
        return self.weight

    def binned(self, by: int) -> "BesideBlock":
        """As a search looks at it."""
        scene = replace(self.scene, camera=self.scene.camera.binned(by) if by > 1 else self.scene.camera)
        return replace(self, scene=scene, lights=tuple(light_beside(scene, name, rough=True) for name in self.sd))

    def added(self, values: Values, liquid: Medium) -> Image:
        """Sizes times images."""
        return np.asarray(np.tensordot(values[self.name], self._images(liquid), 1))

    def turned(self, values: Values, liquid: Medium) -> Image:
        """The same of their derivatives."""
        parts = zip(values[self.name], self.sd.values(), self.lights, strict=True)
        return np.asarray(sum(size * sd * light.slopes(liquid) for size, sd, light in parts))

    def stderr(self, values: Values, liquid: Medium) -> Array:
        """(rows, columns) standard error of what is added."""
        parts = zip(values[self.name], self.sd.values(), self.lights, strict=True)
        return np.asarray(np.sqrt(sum((size * sd * light.stderr(liquid)) ** 2 for size, sd, light in parts)))

    def changes(self, values: Values, dose: int, liquid: Medium, by_liquid: Image) -> Image:
        """(k, rows, columns) images, each of a size of one standard deviation."""
        return self._images(liquid)

    def _images(self, liquid: Medium) -> Array:
        return np.stack([sd * light.image(liquid) for sd, light in zip(self.sd.values(), self.lights, strict=True)])


def described(scene: Scene, name: str) -> float:
    """How much of some light beside a scene has by its own description."""
    faces = scene.tank.faces
    return {
        "projector_halo": scene.projector.halo.share,
        "black_level": scene.projector.black_level,
        "floor": faces.floor.reflectance if faces.floor.kind == "diffuse" else 0.0,
        "pane": 0.0 if faces.entry.dark else 1.0,
    }[name]


def sizes_along(blocks: Sequence[Block], values: Values) -> dict[str, float]:
    """Sizes of what went astray as they were fitted along, beyond what is described, by their names in `ASTRAY`."""
    stray = [block for block in blocks if isinstance(block, AstrayBlock | BesideBlock)]
    return {
        name: float(size) * sd
        for block in stray
        for (name, sd), size in zip(block.sd.items(), values[block.name], strict=True)
    }
