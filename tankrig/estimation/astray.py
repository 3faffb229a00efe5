"""Light that went astray: halo, veil and blur of lenses, a floor that reflects, a dark picture that is none.

Each changes the image by a pattern of its own, times its size: nearly so even where the size is not small, for light
that goes astray twice is faint. So sizes are fitted along linearly.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tankrig.errors import SceneError
from tankrig.estimation.astray_patterns import (
    BLUR_MM2,
    Array,
    Image,
    Pattern,
    black_level,
    blur,
    by_width,
    floor,
    floor_by_few,
    halo,
    more_blur,
    other_halo,
    panes,
    projector_halo,
    veil,
)
from tankrig.estimation.found_optics import of_width
from tankrig.estimation.parameters import FURTHEST_OFF, Block, Values
from tankrig.scene import Medium, Scene

ASTRAY = {
    "halo": 0.01, "veil": 0.01, "blur_mm2": 0.1,
    "floor": 0.05, "pane": 1.0, "black_level": 0.001, "projector_halo": 0.02, "halo_width": 0.5,
}  # fmt: skip
"""What may go astray, and by how much on a common bench: shares of the light in the camera's halo and veil, variance by
which its picture is blurred more than described; diffuse reflectance of the floor, what the entry pane's outer side
sends back as a share of what glass does, W/mm² on the wall, share of the light in the projector's halo; natural
logarithm of the camera's halo's width over what the scene says, which is fitted along wherever a halo is."""
BENDING = 0.2
"""Share of itself by which a blur is changed to see how that changes the image."""
MOST_WIDER = 1.25
"""How far the logarithm of a halo's width is believed to be off."""
PATTERNS: dict[str, Pattern] = {
    "halo": halo, "veil": veil, "blur_mm2": blur,
    "floor": floor, "pane": panes, "black_level": black_level, "projector_halo": projector_halo,
}  # fmt: skip
QUICK_PATTERNS = PATTERNS | {"floor": floor_by_few}
"""What an image gains, by few light paths where many take seconds, for a person who waits for a fit."""


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
    quick
        Whether patterns may be noisy, where that saves seconds.
    """

    scene: Scene
    sd: Mapping[str, float]
    patterns: Array | None = None
    beside: Array | float = 0.0
    quick: bool = False

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
        pattern_of, patterns = QUICK_PATTERNS if self.quick else PATTERNS, []
        for name, sd in self.sd.items():
            mm2 = found[name]
            if name == "halo_width":
                slope = by_width(scene, image, found)
                described = other_halo(scene, image, np.exp(found[name]))
                beside = beside + described - found[name] * slope
                patterns.append(sd * slope)
            elif name == "blur_mm2" and mm2 > BENDING * BLUR_MM2:
                here = more_blur(scene, image, mm2)
                slope = (more_blur(scene, image, (1.0 + BENDING) * mm2) - here) / (BENDING * mm2)
                beside = beside + here - mm2 * slope
                patterns.append(sd * slope)
            else:
                patterns.append(sd * pattern_of[name](wider, image))
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

    def at(self, media: Sequence[Medium], images: Sequence[Image], sizes: Array) -> "AstrayBlock":
        """The same with the patterns of each image's liquid and its image, at sizes in standard deviations."""
        of_each = zip(self.astray, media, images, strict=True)
        return replace(
            self, astray=tuple(replace(one, quick=False).at(medium, image, sizes) for one, medium, image in of_each)
        )

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
