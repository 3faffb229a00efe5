"""Forward models as a fit sees them: versions that are cheap to search with, accurate to end with, or differentiated.

The tank model follows light paths, and its noise is a smooth function of the medium only where the same paths are
followed every time: so each version follows a fixed number of them, chosen once for a fit from the noise that the
cheap version states. Derivatives use other paths than the image that they are to improve: with the same ones, noise
would look like a way to a better fit.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tankrig.errors import SceneError
from tankrig.estimation.coordinates import Range
from tankrig.estimation.differences import (
    EXACT_STEP,
    slopes_of,
)
from tankrig.estimation.followed import (
    LOW_ORDERS,
    SLOPE_BLUR_MM,
    SOLVED_BATCHES,
    Followed,
    Image,
    Model,
    Solved,
    in_water,
    remembered,
    tank_along,
)
from tankrig.estimation.light_beside import WithBeside, described_beside, with_light
from tankrig.estimation.phase_families import Family
from tankrig.estimation.stated_errors import COARSE, FINE, stated_error
from tankrig.estimation.versions import Exact, Models, image_of
from tankrig.estimation.with_prepared import Lift, Lifted, Made, WithPrepared
from tankrig.image.predict import MODELS, predict
from tankrig.light.prepared.phases.checked import FEWEST
from tankrig.prediction import Prediction, Skipped
from tankrig.scene import Medium, Scene
from tankrig.scene.phase_table import PhaseFunction

if TYPE_CHECKING:
    from tankrig.image.prepare import Prepared

COARSE_BATCHES, SMOOTHED_BATCHES = 2, 6
"""Shifted lattices of light paths of the tank model's cheap images: where every path stands for all starts, and where
it does not and noise is told from light by their scatter (two of them err by 7 % unseen, four by 1.5 %)."""
FINE_NOISE, FINE_BATCHES = 0.003, 32
SLOPE_NOISE, SLOPE_BATCHES = 0.006, 16
"""Noise (relative L2) that the images for the last steps and for derivatives aim for, and their lattices at most."""
ALIKE_NOISE, ALIKE_BATCHES = 0.001, 64
"""The same of images for derivatives by a family's coordinates, of which many change an image nearly alike."""
CHECK_BATCHES = 32
"""Lattices of the image that a prepared model of light or sight that slant is compared with."""
LOOK_PIXELS = 2400
"""Pixels of the images that the search looks at, or up to four times as many; of so many small lattices of paths as a
cheap image has large ones."""
ROUGH_SOURCE = 6
"""Lattices that make the source of the orders that are solved for, on the way there."""
NEAR_NOISE, NEAR_BATCHES = 0.01, 8
"""Noise of the images that lead from the search's end to where accurate ones are worth their price."""
EXACT_NOISE, EXACT_BATCHES = 0.0005, 128
"""The same for the one image, at the optimum, that the others are corrected by."""


def is_ideal(scene: Scene) -> bool:
    """Whether its lenses blur nothing, its light is what its beams say, and its walls send nothing back."""
    from tankrig.light.entering import is_plain
    from tankrig.light.leaving import CameraLens

    return is_plain(scene) and CameraLens.of(scene) is None and scene.tank.faces.dark


def models_of(
    scene: Scene, model: "str | Prepared", max_order: int | None, family: Family | None = None, checked: bool = False
) -> Models:
    """Versions of a model of a scene, for media of a family of phase functions; None: Henyey–Greenstein.

    With `checked`, what a prepared model says of light or sight that slant is compared with light paths at the optimum:
    it was trained on smoothed images, and what these all lack no cross-validation sees.

    Raises
    ------
    SceneError
        When a prepared model is of another scene, or asked for a phase function that it was not prepared for; on the
        first image, when the model is unknown or cannot treat the scene.
    """
    if family is not None:
        if not isinstance(model, str) and model.phases == "any":
            return replace(_prepared_models(scene, model, max_order, False), family=family)
        if model == "prepared" or not isinstance(model, str):
            raise SceneError(
                f'phase = "{family.name}" needs model = "tank", or a model that was prepared for any phase function '
                '(tankrig.prepare(…, phases = "any")): other prepared models know Henyey–Greenstein only'
            )
        return models_of(scene, model, max_order).of(family)
    if model == "prepared":
        from tankrig.image.prepare import prepare

        model = prepare(replace(scene, medium=Medium(*scene.medium.coefficients)))
    if not isinstance(model, str):
        return _prepared_models(scene, model, max_order, checked)
    if model == "tank":
        # Derivatives come along the paths where lenses and walls are ideal; others are differences of whole images.
        # A lens would let them come, too: their noise then left σa ten times as unsure where the gain is free.
        if is_ideal(scene):
            return _followed_models(scene, max_order)
        bare, _ = described_beside(scene)
        return _models_with_beside(scene) if max_order is None and is_ideal(bare) else _tank_models(scene, max_order)

    if model not in MODELS:
        raise SceneError(f'model = "{model}" is unknown; use one of prepared, {", ".join(MODELS)}')

    def within(tolerance: float) -> Model:
        return remembered(lambda medium: predict(replace(scene, medium=medium), model, tolerance, max_order))

    fine = within(FINE)
    if model == "single":
        # Its images have no noise and cost a millisecond: where nearly the same images come of many media, as in its
        # bent valley, derivatives that are only nearly right stop a search beside the optimum.
        slopes = slopes_of(image_of(fine), max(scene.tank.size_mm), step=EXACT_STEP)
        return Models(fine, lambda _: (fine, fine), slopes)
    return Models(within(COARSE), lambda _: (fine, fine))


def _prepared_models(scene: Scene, model: "Prepared", max_order: int | None, checked: bool) -> Models:
    _require_prepared_for(scene, model, max_order)
    box = model.box
    answered, predicted = _answers(model)

    def refine(medium: Medium) -> tuple[Model, Model]:
        with_noise = predicted if model.phases != "hg" else _with_noise(model, predicted, medium)
        return with_noise, with_noise

    @remembered
    def slopes_noise(medium: Medium) -> Image:
        return model.errors_of_slopes_at(box.nearest(medium))

    def along(medium: Medium, others: Sequence[PhaseFunction]) -> Image:
        return model.slopes(box.nearest(medium), others)[1]

    albedo, g = ((edges[0], min(edges[1], 1.0 - 1e-6)) for edges in (box.albedo, box.g))
    scattering = (box.sigma_t[0] * albedo[0], box.sigma_t[1])
    return Models(
        predicted, refine, lambda medium: answered(medium)[1],
        Range.of_media(scattering, albedo, g, sigma_t=box.sigma_t),
        exact=_compared(scene, model) if checked and is_ideal(scene) and _slants(scene) else None,
        along=along if model.phases == "any" else None,
        slopes_noise=slopes_noise if model.phases == "hg" else None,
    )  # fmt: skip


def _require_prepared_for(scene: Scene, model: "Prepared", max_order: int | None) -> None:
    """Refuse a model of another scene, and orders that it does not tell apart."""
    if replace(model.scene, medium=scene.medium) != scene:
        raise SceneError(
            f"the model {model.path} was prepared for another tank, projector or camera than "
            f"{scene.source or 'the scene'} has; prepare this one"
        )
    if max_order is not None:
        raise SceneError(f'max_order = {max_order} needs model = "tank": a prepared model holds all orders in one')


def _answers(model: "Prepared") -> tuple[Callable[[Medium], tuple[Prediction, Image]], Model]:
    """Its images with derivatives, and without; of the nearest medium in its box."""

    def told(image: Image, near: Medium) -> Prediction:
        error = Skipped("noise and polynomials of the prepared model", model.error_at(near))
        return Prediction(image, "prepared", skipped=(error,))

    @remembered
    def answered(medium: Medium) -> tuple[Prediction, Image]:
        near = model.box.nearest(medium)
        image, slopes = model.predict(near, derivatives=True)
        return told(image, near), slopes

    @remembered
    def predicted(medium: Medium) -> Prediction:
        if model.phases == "hg":
            return answered(medium)[0]
        near = model.box.nearest(medium)
        return told(model.predict(near), near)

    return answered, predicted


def _with_noise(model: "Prepared", predicted: Model, medium: Medium) -> Model:
    """Its images, with the patterns of their noise as they are at a medium."""
    near = model.box.nearest(medium)
    patterns, tables = model.errors_at(near)
    size = float(np.linalg.norm(model.predict(near)))
    rest = (Skipped("tables that order 2 is looked up in", tables),)

    @remembered
    def known(medium: Medium) -> Prediction:
        # Errors go with the image: from one medium to the next they change as slowly as that.
        image = predicted(medium).image
        noise = patterns * (float(np.linalg.norm(image)) / size if size > 0.0 else 1.0)
        stderr = np.sqrt(np.sum(np.square(noise), axis=0))
        return Prediction(image, "prepared", stderr=stderr, skipped=rest, patterns=noise)

    return known


def _compared(scene: Scene, model: "Prepared") -> Exact:
    """Images by light paths that a prepared model is compared with."""

    def compared(medium: Medium, times: float) -> Prediction:
        from tankrig.light.paths.block import LARGE
        from tankrig.light.tangent import tank_accurate

        near = replace(scene, medium=model.box.nearest(medium))
        return replace(tank_accurate(near, math.ceil(times * CHECK_BATCHES * LARGE.points), 3), model="prepared")

    return compared


Lattices = Callable[[Medium, float, int], int]
"""How many lattices a medium's image takes for a noise, at most so many."""


def _lattices(rough: Model, fewest: int) -> Lattices:
    """As told by the noise that an image of the fewest lattices states."""

    def batches(medium: Medium, noise: float, most: int) -> int:
        need = fewest * stated_error(rough(medium)) ** 2
        return int(np.clip(need / noise**2, fewest, most))

    return batches


def _once(batches: Lattices) -> Lattices:
    """As many for every medium as for the first, so that noise at places near each other is alike."""
    chosen: dict[tuple[float, int], int] = {}

    def once(medium: Medium, noise: float, most: int) -> int:
        if (noise, most) not in chosen:
            chosen[noise, most] = batches(medium, noise, most)
        return chosen[noise, most]

    return once


def _accurate(scene: Scene, max_order: int | None, batches: Lattices) -> Exact:
    """The image by many light paths that is not smoothed, with the patterns of its noise."""

    def exact(medium: Medium, times: float) -> Prediction:
        from tankrig.light.paths.block import LARGE
        from tankrig.light.tangent import tank_accurate

        paths = math.ceil(times * batches(medium, EXACT_NOISE, EXACT_BATCHES) * LARGE.points)
        return tank_accurate(replace(scene, medium=medium), paths, 3, max_order)

    return exact


def _tank_models(scene: Scene, max_order: int | None) -> Models:
    def following(batches: int, seed: int, blur_mm: float = 0.0) -> Model:
        return remembered(lambda medium: tank_along(replace(scene, medium=medium), max_order, batches, seed, blur_mm))

    fewest = _fewest(scene)
    coarse = following(fewest, 0)

    batches = _lattices(coarse, fewest)

    def refine(medium: Medium) -> tuple[Model, Model]:
        fine, slope = batches(medium, FINE_NOISE, FINE_BATCHES), batches(medium, SLOPE_NOISE, SLOPE_BATCHES)
        return following(fine, 1), following(slope, 2, SLOPE_BLUR_MM)

    def exact(medium: Medium, times: float) -> Prediction:
        return following(max(math.ceil(times * batches(medium, EXACT_NOISE, EXACT_BATCHES)), fewest), 3)(medium)

    different = _families(scene, max_order)
    return Models(coarse, refine, exact=exact, low=low_orders_of(scene, max_order), different=different)


def _families(scene: Scene, max_order: int | None) -> Callable[[Family], Models] | None:
    """Gives versions for a family's media; None where they are of whole images, as for Henyey–Greenstein's.

    Where light or sight slants, light paths leave so much noise that a family's coordinates are lost in it, and what
    is prepared has little.
    """
    prepared = _slants(scene) and max_order is None
    if not (prepared or scene.tank.faces.dark):
        return None
    return partial(family_models, scene, max_order=max_order, prepared=prepared)


def low_orders_of(scene: Scene, max_order: int | None = None) -> Model | None:
    """Orders 1 and 2 of a scene's media; None where no others are asked for."""
    from tankrig.light.tank import tank_image

    if max_order is not None and max_order < LOW_ORDERS + 1:
        return None
    return remembered(lambda medium: tank_image(replace(scene, medium=medium), FINE, LOW_ORDERS))


def _followed_models(scene: Scene, max_order: int | None) -> Models:
    """Versions for Henyey–Greenstein's media, whose derivatives come along the paths; families have their own."""
    fewest = _fewest(scene)
    coarse = Followed(scene, fewest, 0, max_order, small=True)
    slanted = remembered(lambda medium: tank_along(replace(scene, medium=medium), max_order, fewest, 1, 0.0))

    batches = _lattices(slanted, fewest)

    def refine(medium: Medium) -> tuple[Model, Model]:
        from tankrig.light.behind_lenses import BehindLenses
        from tankrig.light.moments.plan import plan_of_changes

        plan = None if max_order else plan_of_changes(BehindLenses(replace(scene, medium=medium)).of_paths)
        if plan is not None:
            low = Followed(scene, SOLVED_BATCHES, 1, plan.above)
            return Solved(low, replace(plan, batches=ROUGH_SOURCE)), Solved(low, plan, parts=2)
        fine, slope = batches(medium, NEAR_NOISE, NEAR_BATCHES), batches(medium, SLOPE_NOISE, SLOPE_BATCHES)
        return Followed(scene, fine, 1, max_order, alone=True), Followed(scene, slope, 2, max_order)

    return Models(
        coarse, refine, exact=_accurate(scene, max_order, batches), look=_look(scene, max_order),
        different=_families(scene, max_order),
    )  # fmt: skip


def _look(scene: Scene, max_order: int | None) -> tuple[int, Followed]:
    """Pixels of a block and the cheap model of such blocks that a search looks at, see `Models.look`."""
    by = max(1, int(math.sqrt(math.prod(scene.camera.shape) / LOOK_PIXELS)))
    binned = replace(scene, camera=scene.camera.binned(by))
    return by, Followed(binned, _fewest(scene), 0, max_order, small=True, rough=True, tables=COARSE)


def _fewest(scene: Scene) -> int:
    """Lattices of paths of a cheap image of a scene."""
    return SMOOTHED_BATCHES if _slants(scene) else COARSE_BATCHES


def _slants(scene: Scene) -> bool:
    """Whether light or sight slants."""
    from tankrig.light.rays import shift_invariant

    return not shift_invariant(scene)


def family_models(
    scene: Scene, family: Family, max_order: int | None = None, water_sigma_s: float = 0.0, prepared: bool = False,
    made: Made | None = None,
) -> Models:  # fmt: skip
    """Versions for media of a family of phase functions, whose derivatives come along the paths as well.

    Parameters
    ----------
    scene
        Whose walls are dark, if nothing is prepared.
    family
        Of phase functions.
    max_order
        As for `models_of`; None, if something is prepared.
    water_sigma_s
        What water scatters besides, 1/mm, see `in_water`.
    prepared
        Whether accurate versions are prepared for the medium's neighbourhood, see `WithPrepared`, in place of following
        paths for each medium.
    made
        What was prepared so, for other families too; what is, is added.
    """
    fewest = _fewest(scene)
    followed = partial(
        Followed, scene, max_order=max_order, family=family, tables=COARSE if _slants(scene) else None,
        water_sigma_s=water_sigma_s,
    )  # fmt: skip
    coarse = followed(fewest, 0)
    lift = Lift.of(coarse)

    batches = _lattices(coarse, fewest)

    known: Made = {} if made is None else made

    def refine_prepared(medium: Medium, most: int | None = None) -> tuple[Model, Model]:
        near = WithPrepared.about(lift, medium, known, most)
        return near, replace(near, fine=True)

    def refine(medium: Medium) -> tuple[Model, Model]:
        fine, slope = batches(medium, NEAR_NOISE, NEAR_BATCHES), batches(medium, ALIKE_NOISE, ALIKE_BATCHES)
        return followed(fine, 1), followed(slope, 2, sharp=True, fine=True)

    accurate = _accurate(scene, max_order, _once(batches))

    def exact(medium: Medium, times: float) -> Prediction:
        return accurate(in_water(medium, water_sigma_s), times)

    return Models(
        Lifted(lift) if prepared and not lift.nothing else coarse, refine_prepared if prepared else refine,
        exact=None if prepared else exact, family=family, look=_look(scene, max_order), prepares=prepared,
        roughly=partial(refine_prepared, most=FEWEST) if prepared else None,
        different=partial(
            family_models, scene, max_order=max_order, water_sigma_s=water_sigma_s, prepared=prepared,
            made=known,
        ),
    )  # fmt: skip


def _models_with_beside(scene: Scene) -> Models:
    """Versions where the beams' own light meets ideal lenses and dark walls only, and other light is beside it.

    The other light is smooth and mostly a few per cent: all of it by as many paths, and computed as often as the
    beams' light, took ten times as long.
    """
    bare, rough = described_beside(scene, rough=True)
    main = _followed_models(bare, None)
    _, fine = described_beside(scene)
    refine, exact, look = main.refine, main.exact, main.look
    assert refine is not None
    assert exact is not None
    assert look is not None
    by, seen = look
    looked_at = replace(scene, camera=scene.camera.binned(by))

    def with_rough(model: Model) -> Model:
        assert isinstance(model, Followed | Solved)
        return WithBeside(model, rough)

    def refined(medium: Medium) -> tuple[Model, Model]:
        best, differentiated = refine(medium)
        return with_rough(best), with_rough(differentiated)

    def exactly(medium: Medium, times: float) -> Prediction:
        return with_light(exact(medium, times), fine, medium)

    # By way of faces 40 lattices were not enough: g of a pane's image came out 2.0 standard deviations off.
    whole = _tank_models(scene, None)
    accurate = exactly if scene.tank.faces.dark else whole.exact

    assert isinstance(seen, Followed)
    rougher = WithBeside(seen, described_beside(looked_at, rough=True)[1])
    return replace(
        main, coarse=with_rough(main.coarse), refine=refined, exact=accurate, look=(by, rougher),
        different=_families(scene, None) or whole.of,
    )  # fmt: skip
