"""A scene's orders of scattering as its camera's lens shows them, of its light as the projector's lens throws it.

Light that clear faces of the tank send back is part of order 1; what else faces send back stands apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tankrig.light.entering import entering
from tankrig.light.leaving import CameraLens
from tankrig.light.order_one import once_seen
from tankrig.light.tank import by_faces_within, paths_by_faces, twice_of
from tankrig.scene import Medium, Scene
from tankrig.scene.optics import Faces
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BehindLenses:
    """A scene as described, and the one that light paths are followed in.

    Parameters
    ----------
    scene
        Any.
    """

    scene: Scene

    @cached_property
    def lens(self) -> CameraLens | None:
        """The camera's; None where it is ideal."""
        return CameraLens.of(self.scene)

    @cached_property
    def seen_by(self) -> Scene:
        """With an ideal camera that sees as far as light comes from."""
        return self.scene if self.lens is None else self.lens.wide

    @cached_property
    def of_paths(self) -> Scene:
        """The same with sharp beams."""
        return entering(self.seen_by, fine=False)

    def once(self, media: Sequence[Medium]) -> Array:
        """(media, rows, columns) of order 1, by way of clear faces too."""
        return once_seen(self.scene, media)

    def twice(self, media: Sequence[Medium], tolerance: float, others: Sequence[PhaseFunction] = ()) -> Array:
        """(media, rows, columns) of order 2, or (1 + others, …); as `tankrig.light.double.double_scattering_of`."""
        return self.seen(twice_of(self.seen_by, media, tolerance, others=others))

    def by_faces(self, seed: int, lattices: int) -> Array:
        """(rows, columns) of what faces send back besides, in all orders, by so many lattices of paths."""
        return self.seen(paths_by_faces(self.seen_by, seed, lattices)[0])

    def seen(self, images: Array) -> Array:
        """(…, rows, columns) of the camera, of images by that of `seen_by`."""
        lens = self.lens
        if lens is None or images.size == 0:
            return images if lens is None else np.zeros((*images.shape[:-2], *self.scene.camera.shape))
        flat = images.reshape(-1, *images.shape[-2:])
        seen = np.array([lens.of_wide(one) for one in flat])
        return seen.reshape(*images.shape[:-2], *seen.shape[-2:])

    def error_seen(self, stderr: Array) -> Array:
        """(rows, columns) standard error of what is seen at most, of that of an image by that of `seen_by`."""
        return stderr if self.lens is None else np.sqrt(self.lens.variance_of_wide(np.square(stderr)))

    def holding(self, medium: Medium) -> "BehindLenses":
        """The same with another liquid."""
        return BehindLenses(replace(self.scene, medium=medium))


def more_by_faces(
    scene: Scene, with_it: Faces, without: Faces, seed: int, lattices: int
) -> tuple[Array, Array]:  # fmt: skip
    """What some faces send back more than others do, as the camera shows it, and its standard error by pixel.

    Parameters
    ----------
    scene
        Any; its own faces do not matter.
    with_it, without
        Faces whose light counts, and whose light is taken off.
    seed, lattices
        Of the light paths.

    Notes
    -----
    Where clear faces are the same, only light that has met a diffuse one counts: what clear ones show besides is in
    both, and its noise would pass for light of the diffuse one.
    """
    behind = BehindLenses(scene)
    shown = partial(paths_by_faces, diffuse_only=True) if with_it.clear == without.clear else by_faces_within
    (lit, one), (dark, other) = (
        shown(replace(behind.seen_by, tank=replace(scene.tank, faces=faces)), seed, lattices)
        for faces in (with_it, without)
    )
    return behind.seen(lit - dark), behind.error_seen(np.hypot(one, other))
