"""Causes of structure in a residual that are light astray, each told by its own pattern."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tankrig.estimation.astray_patterns import (
    Array,
    Image,
    Pattern,
    black_level,
    blur,
    blur_of_moved_light,
    floor_by_few,
    gamma,
    halo,
    other_halo,
    other_pane,
    other_projector_halo,
    pane_mm,
    panes,
    soft_blur,
    veil,
    wide_lens,
)
from tankrig.estimation.found_optics import LEAST_PANE
from tankrig.scene import Scene
from tankrig.scene.optics import MOST_HALO, MOST_VEIL

OTHER_WIDTH, OTHER_MM = 2.0, 3.0
"""How many times as wide, or as narrow, a halo is that stands for all of another width; how much thicker, or thinner, a
pane is that stands for all of another thickness. Halves and thirds of these look alike."""


@dataclass(frozen=True)
class Sign:
    """A cause of structure in a residual that is told by its own pattern.

    Parameters
    ----------
    pattern
        What an image gains per unit of its size.
    along
        Name in `tankrig.estimation.astray.ASTRAY` of what it is fitted along as; empty where it is not.
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
    rough
        A pattern that is nearly the same for a tenth of the time, by which to see whether it is worth a closer look;
        None where none is.
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
    rough: Pattern | None = None
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
        quick=soft_blur,
        rough=blur_of_moved_light,
        of_image=True,
    ),
    "a wide lens of the projector, sharp at one distance only": Sign(wide_lens, slow=True, asked=_may_be_wide),
    "light that the floor reflects": Sign(
        floor_by_few, "floor", 1.0, asked=lambda scene: scene.tank.faces.floor.dark),
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
