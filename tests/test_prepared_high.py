"""Orders ≥ 3 that were prepared for any phase function, where light and sight slant, are as the tank model has them."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tankrig.estimation import with_prepared
from tankrig.estimation.differences import values_of
from tankrig.estimation.followed import Followed, in_water
from tankrig.estimation.forward import family_models
from tankrig.estimation.phase_families import as_free, free, reynolds_mccormick
from tankrig.estimation.with_prepared import Lift, Lifted, WithPrepared, looked_at_together, told_together
from tankrig.light.behind_lenses import BehindLenses
from tankrig.light.prepared.box import Box
from tankrig.light.prepared.phases import checked, high, plan
from tankrig.light.prepared.phases.checked import CheckedOrders, checked_at, checked_by_lattices
from tankrig.light.prepared.phases.high import HighAnswer, high_orders_prepared
from tankrig.light.prepared.sampling import PathImages
from tankrig.light.tangent import tank_accurate
from tankrig.light.tank import tank_image
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.mie import Mie
from tankrig.scene.optics import SHARP, Blur, Face, Faces, Halo
from tankrig.scene.phase_functions import Mixture, ReynoldsMcCormick, TwoTerm

BEAMS = (Beam((-30.0, -10.0), (50.0, 58.0)), Beam((20.0, 28.0), (50.0, 58.0)))
LIGHT = Projector("pinhole", BEAMS, (-400.0, 0.0, 55.0))
CAMERA = Camera("pinhole", (20, 30), 8.0, (120.0, 0.0, 620.0), blur=Blur(1.5))
SCENE = Scene(Tank(surface="fresnel", refractive_index=1.33), Medium(0.0, 0.01, 0.8), LIGHT, CAMERA)
BOX = Box((0.0085, 0.0137), (0.8, 0.9999), (0.7, 0.87))
TOLERANCE = 0.05
BEAD = Mie(0.5, 1.5868, 1.3317, 633.0)
LIQUIDS = (
    Medium(0.0004, 0.0102, phase=BEAD),
    Medium(0.001, 0.009, phase=ReynoldsMcCormick(0.65, 1.0)),
    Medium(0.0001, 0.0123, phase=TwoTerm(0.85, -0.3, 0.96)),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where they are kept; a third of the media, for so small a tank's box, and a quarter of the lattices."""
    kept = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TANKRIG_CACHE", str(kept))
        patch.setattr(plan, "FEWEST", 0.3)
        patch.setattr(checked, "MOST", checked.FEWEST)
        yield kept


@pytest.fixture(scope="module")
def prepared(folder: Path) -> HighAnswer:
    assert folder.is_dir()
    return high_orders_prepared(SCENE, BOX, TOLERANCE)


@pytest.fixture(scope="module")
def of_beads(prepared: HighAnswer) -> CheckedOrders:
    """Made right by light paths at the first of the liquids, which two tests look at."""
    return checked_at(prepared, LIQUIDS[0])


def off_by(liquid: Medium, *images: NDArray[np.float64]) -> tuple[list[float], float]:
    """What images of orders ≥ 3 are off by over the whole image, in blocks; two images by light paths with noise of
    their own tell it without that. And the whole image's norm."""
    scene = replace(SCENE, medium=liquid)
    behind = BehindLenses(scene)
    low = behind.once([liquid])[0] + behind.twice([liquid], 0.001)[0]
    size = float(np.linalg.norm(low + images[0]))
    assert np.linalg.norm(images[0]) > 0.15 * size  # there is something to be wrong
    truths = [tank_accurate(scene, 400_000, seed).image - low for seed in (11, 12)]
    off = [(image - truths[0], image - truths[1]) for image in images]
    return [float(np.sqrt(max(np.sum(one * other), 0.0)) / size) for one, other in off], size


@pytest.mark.parametrize(
    "liquid",
    [LIQUIDS[0], pytest.param(LIQUIDS[1], marks=pytest.mark.long), LIQUIDS[2]],
    ids=["bead", "gegenbauer", "two"],
)
def test_they_are_those_of_light_paths_and_err_as_they_say(
    prepared: HighAnswer, of_beads: CheckedOrders, liquid: Medium
) -> None:
    found = of_beads if liquid is LIQUIDS[0] else checked_at(prepared, liquid)
    (off,), size = off_by(liquid, found.image(liquid))
    stated = float(np.sqrt(np.sum(found.errors_at(liquid) ** 2)) / size)
    assert stated < 0.02
    assert off < 1.5 * stated


def test_what_is_not_known_of_a_phase_function_is_told_by_paths(prepared: HighAnswer) -> None:
    """Beads alike were 2 to 3 % off, and nothing said so; and so is a medium next to the one that was looked at."""
    beads = Medium(0.0004, 0.0102, phase=Mie(0.55, 1.58242, 1.3317, 633.0))
    beside = Medium(0.0004, 0.0108, phase=beads.phase)
    (off, as_prepared), _ = off_by(beside, checked_at(prepared, beads).image(beside), prepared.image(beside))
    assert off < 0.4 * as_prepared


def test_order_2_of_light_without_edges_is_not_counted_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever computes orders 1 and 2 has it; models of Henyey–Greenstein's have it from paths."""
    scene = replace(SCENE, projector=replace(LIGHT, halo=Halo(0.02, 30.0)))
    monkeypatch.setattr(plan, "FEWEST", 0.01)
    few = plan.PhasePlan(BOX, 240.0, 1.0, slanted=True)
    assert PathImages(scene, (1.0,)).twice_smooth(LIQUIDS[0], 1, range(1)).any()

    def asked(*_: object) -> None:
        raise AssertionError("order 2 was asked of the paths")

    monkeypatch.setattr(PathImages, "twice_smooth", asked)
    assert high._followed(few, PathImages(scene, few.base.albedos), lambda _: None, 1).any()  # noqa: SLF001


def test_derivatives_are_those_of_the_image(of_beads: CheckedOrders) -> None:
    liquid, towards, found = LIQUIDS[0], ReynoldsMcCormick(0.7, 1.0), of_beads
    _, slopes = found.image_and_slopes(liquid, [towards])

    def image(more: float = 0.0, scattered: float = 0.0, share: float = 0.0) -> np.ndarray:
        phase = Mixture((BEAD, towards), (1.0 - share, share))
        return found.image(Medium(liquid.sigma_a + more, liquid.sigma_s + scattered, phase=phase))

    for slope, step, name in ((slopes[0], 2e-5, "more"), (slopes[1], 2e-5, "scattered"), (slopes[2], 1e-3, "share")):
        change = (image(**{name: step}) - image(**({name: -step} if name != "share" else {}))) / step
        change *= 0.5 if name != "share" else 1.0
        assert np.linalg.norm(change - slope) < 0.02 * np.linalg.norm(slope), name


def nothing_new(_: float) -> None:
    raise AssertionError("it was prepared once more")


def test_they_are_read_again_as_they_were_made(prepared: HighAnswer) -> None:
    again = high_orders_prepared(replace(SCENE, medium=Medium(0.0, 0.02, 0.1)), BOX, TOLERANCE, nothing_new)
    np.testing.assert_array_equal(again.image(LIQUIDS[0]), prepared.image(LIQUIDS[0]))


def test_media_beyond_the_box_are_answered_as_the_nearest(prepared: HighAnswer) -> None:
    """A step of a search may lead anywhere."""
    dense = prepared.image(Medium(0.001, 0.08, phase=BEAD))
    assert np.isfinite(dense).all()
    assert dense.sum() > prepared.image(LIQUIDS[0]).sum()
    assert np.isfinite(prepared.image_and_slopes(Medium(0.5, 0.001, phase=TwoTerm(0.98, -0.1, 0.99)), [BEAD])[1]).all()


def test_a_model_about_a_medium_has_all_orders_and_its_derivatives(prepared: HighAnswer) -> None:
    """Low orders as they are, the others as prepared; in water that scatters by itself, which derivatives leave out."""
    family, water = free(), 1e-4
    centre = Medium(0.0004, 0.0102, phase=family.phase(as_free(BEAD)))
    low = Followed(SCENE, 1, 0, None, family=family, tables=0.02, water_sigma_s=water)
    model = WithPrepared.about(Lift.of(low), centre, {prepared: []})
    found = model(centre)
    assert found.patterns is not None
    assert model.holds(centre)
    assert not model.holds(Medium(0.0004, 0.02, phase=centre.phase))
    assert found.stderr is not None
    expected = tank_accurate(replace(SCENE, medium=in_water(centre, water)), 200_000, 5)
    assert expected.stderr is not None
    noise = np.hypot(found.stderr, expected.stderr)
    assert np.linalg.norm(found.image - expected.image) < 1.5 * np.linalg.norm(noise)
    assert found.image.sum() == pytest.approx(expected.image.sum(), rel=0.005)
    slopes, at = model.slopes(centre), values_of(centre, family)
    for number, step in ((1, 2e-5), (2, 0.01), (4, 0.02)):
        moved = at + step * np.eye(at.size)[number]
        ahead = model(Medium(float(moved[0]), float(moved[1]), phase=family.phase(moved[2:]))).image
        change = (ahead - found.image) / step
        assert np.linalg.norm(change - slopes[number]) < 0.12 * np.linalg.norm(change), number


def test_derivatives_at_the_centre_are_made_right_there(prepared: HighAnswer) -> None:
    """A fit follows shapes that what was prepared hardly knows as far as derivatives promise.

    By those as prepared a two-term liquid's fit ended at σs −5.9 ± 1.3 %, where images cost 36 more than at the truth.
    """
    family, shape = free(), SCENE.camera.shape
    low = Lift.of(Followed(SCENE, 1, 0, None, family=family, tables=0.02))
    place = as_free(BEAD)
    there, here = (
        WithPrepared.about(low, Medium(0.0004, sigma_s, phase=family.phase(at)), {prepared: []})
        for sigma_s, at in ((0.0102, place), (0.0104, place + 0.4 * np.eye(place.size)[5]))
    )
    assert here.agrees(here)
    as_prepared = replace(here, missed=lambda: np.zeros((2 + family.low.size, *shape)))
    known, foretold, unknown = (model(there.centre).image for model in (there, here, as_prepared))
    assert np.linalg.norm(foretold - known) < 0.7 * np.linalg.norm(unknown - known)
    np.testing.assert_array_equal(as_prepared(here.centre).image, here(here.centre).image)
    at = values_of(here.centre, family)
    extra = here.slopes(here.centre) - as_prepared.slopes(here.centre)
    for number, step in ((0, 2e-5), (1, 2e-5), (2, 0.01), (6, 0.02)):
        moved = at + step * np.eye(at.size)[number]
        ahead = Medium(float(moved[0]), float(moved[1]), phase=family.phase(moved[2:]))
        change = (here(ahead).image - as_prepared(ahead).image) / step
        assert np.linalg.norm(change - extra[number]) < 0.05 * np.linalg.norm(change) + 1e-9, number


def test_what_lattices_show_is_taken_over_whole_and_errs_as_it_says(prepared: HighAnswer) -> None:
    """Natural waters' light is as sharp as their beams: drawn towards the model as if it might be noise, half of what
    that lacked went missing, and σs by four standard deviations."""
    rng, shape = np.random.default_rng(3), SCENE.camera.shape
    y, x = np.mgrid[: shape[0], : shape[1]]
    truth = 0.02 * (y % 2 - 0.5) * (np.abs(y - shape[0] / 2) < 6) + 0.01 * np.sin(x / 5.0)
    shares, errors = [], []
    for _ in range(12):
        lattices = truth.ravel() + 0.08 * rng.standard_normal((64, truth.size))
        found = checked._made_right(prepared, *checked._by_all(lattices))  # noqa: SLF001
        shares.append(float(np.sum(found.off * truth) / np.sum(truth**2)))
        errors.append(float(np.sum((found.off - truth) ** 2) / np.sum(found.errors**2)))
    assert np.mean(shares) == pytest.approx(1.0, abs=0.1)
    assert 0.85 < np.mean(errors) < 1.15


def test_a_medium_nearby_is_made_right_by_few_lattices(prepared: HighAnswer, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit of an emulsion behind glass asked at eighteen media, and all lattices at each took two thirds of its time.

    The same lattices at both have nearly the same noise, so what is told of the second is what all would tell there.
    """
    followed: list[int] = []
    by_paths = HighAnswer.by_paths

    def counted(high: HighAnswer, medium: Medium, seed: int) -> NDArray[np.float64]:
        followed.append(seed)
        return by_paths(high, medium, seed)

    known: checked.Known = []
    checked_at(prepared, LIQUIDS[0], known)
    monkeypatch.setattr(HighAnswer, "by_paths", counted)
    near = Medium(0.0004, 0.0103, phase=Mie(0.505, 1.5868, 1.3317, 633.0))
    found, few = checked_at(prepared, near, known), len(followed)
    by_all = checked_at(prepared, near)
    assert few == checked.NEAR
    assert len(known) == 1
    assert np.linalg.norm(found.off - by_all.off) < 0.5 * np.linalg.norm(by_all.errors)
    assert np.linalg.norm(found.errors) == pytest.approx(np.linalg.norm(by_all.errors), rel=0.25)
    followed.clear()
    checked_at(prepared, LIQUIDS[2], known)
    assert len(followed) == checked.FEWEST
    assert len(known) == 2


def test_more_lattices_leave_as_much_less_of_their_noise(prepared: HighAnswer) -> None:
    few, more = (checked_by_lattices(prepared, LIQUIDS[0], count) for count in (32, 128))
    stated = float(np.linalg.norm(few.errors))
    assert float(np.linalg.norm(more.errors)) == pytest.approx(0.5 * stated, rel=0.25)
    assert 0.3 * stated < float(np.linalg.norm(more.off - few.off)) < 1.5 * stated


def test_errors_of_few_lattices_beside_many_are_what_they_differ_by() -> None:
    """Noise that both media share, and half as much that each has of its own: within a fifth on average."""
    rng, shape = np.random.default_rng(5), SCENE.camera.shape
    shares = []
    for _ in range(12):
        many = 0.08 * rng.standard_normal((256, shape[0] * shape[1]))
        mean, errors = checked._beside(many, 0.04 * rng.standard_normal((64, many.shape[1])))  # noqa: SLF001
        shares.append(float(np.sum(mean**2) / np.sum(errors**2)))
    assert 0.8 < np.mean(shares) < 1.2


GLASS = replace(SCENE, tank=replace(SCENE.tank, faces=Faces(*[Face("glass")] * 4, floor=Face("diffuse", 0.2))))


@pytest.mark.long
def test_in_a_tank_of_glass_what_walls_and_floor_send_back_is_among_it(folder: Path) -> None:
    """Order 1 by way of walls with the low orders, the rest with what is prepared; nothing twice, nothing left out."""
    assert folder.is_dir()
    liquid, low = LIQUIDS[2], Followed(GLASS, 2, 0, None, family=free(), tables=0.02)
    found = WithPrepared.about(Lift.of(low), liquid, {high_orders_prepared(GLASS, BOX, TOLERANCE): []})(liquid)
    expected, without = (tank_image(replace(one, medium=liquid), seed=5, batches=48) for one in (GLASS, SCENE))
    assert found.stderr is not None
    assert expected.stderr is not None
    noise = np.linalg.norm(np.hypot(found.stderr, expected.stderr))
    off, by_walls = np.linalg.norm(found.image - expected.image), np.linalg.norm(expected.image - without.image)
    assert by_walls > 0.1 * np.linalg.norm(expected.image)
    assert off < 1.5 * noise
    assert found.image.sum() == pytest.approx(expected.image.sum(), rel=0.01)


def test_behind_glass_a_medium_nearby_is_made_right_by_few_lattices(prepared: HighAnswer) -> None:
    """Light by way of walls is seen where few paths end, and others at a medium that hardly differs: without averaging
    what changes over the picture a fit of six photographs followed 1,500 lattices at each of twelve places."""
    behind_glass = replace(prepared, sampling=PathImages(GLASS, prepared.sampling.albedos))
    near = Medium(0.0004, 0.0103, phase=Mie(0.505, 1.5868, 1.3317, 633.0))
    known: checked.Known = []
    before = checked_at(behind_glass, LIQUIDS[0], known)
    found = checked_at(behind_glass, near, known)
    stated = float(np.linalg.norm(found.errors))
    assert len(known) == 1  # all that told was what 16 lattices differ by
    assert stated < 1.12 * np.linalg.norm(before.errors)
    others = [checked._apart(behind_glass, near, range(first, first + 32), 2).mean(axis=0) for first in (500, 600)]  # noqa: SLF001
    off = (found.off.ravel() - others[0]) @ (found.off.ravel() - others[1])
    assert np.sqrt(max(off, 0.0)) < 1.25 * stated


def test_no_more_lattices_are_followed_than_are_asked_for(
    prepared: HighAnswer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They do where images hold much besides noise, however much that leaves."""
    monkeypatch.setattr(checked, "FEWEST", 16)
    monkeypatch.setattr(checked, "NEAR", 8)
    behind_glass = replace(prepared, sampling=PathImages(GLASS, prepared.sampling.albedos))
    few: checked.Known = []
    found = checked_at(behind_glass, LIQUIDS[0], few, checked.FEWEST)
    assert len(few[0]) == checked.FEWEST
    assert np.linalg.norm(found.errors) > checked.ENOUGH


def test_what_a_search_looks_at_has_light_by_way_of_walls_at_every_dose() -> None:
    """Without it a search for a phase function in a tank of glass began a third too dark; with one dose's share of it
    at all others, which have the same model, it went astray."""
    few = replace(GLASS, camera=replace(CAMERA, shape=(10, 15), pixel_mm=16.0, blur=Blur(0.0)))
    family = free()
    phase = family.phase(as_free(TwoTerm(0.85, -0.3, 0.96)))
    looked_at = Lifted(Lift.of(Followed(few, 2, 0, None, small=True, family=family, tables=0.05)))
    for sigma_s in (0.003, 0.0123):
        liquid = Medium(0.01 * sigma_s, sigma_s, phase=phase)
        expected = tank_image(replace(few, medium=liquid), 0.05, seed=5, batches=4).image
        assert np.linalg.norm(looked_at(liquid).image - expected) < 0.06 * np.linalg.norm(expected)
    slopes = looked_at.slopes(liquid)
    ahead = looked_at(Medium(liquid.sigma_a, 1.02 * sigma_s, phase=phase)).image
    assert slopes[1].sum() == pytest.approx((ahead - looked_at(liquid).image).sum() / (0.02 * sigma_s), rel=0.05)


def test_doses_of_a_pattern_have_their_low_orders_told_together(
    prepared: HighAnswer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each by itself, order 1 behind glass took 13 CPU s for each of three doses at every place of a refit."""
    asked: list[int] = []
    once = BehindLenses.once

    def counted(behind: BehindLenses, media: Sequence[Medium]) -> NDArray[np.float64]:
        asked.append(len(media))
        return once(behind, media)

    haloed = replace(SCENE, projector=replace(LIGHT, halo=Halo(0.02, 30.0)))
    lift = Lift.of(Followed(haloed, 2, 0, None, family=free(), tables=0.05))
    right = CheckedOrders(prepared, np.zeros(CAMERA.shape), np.zeros((1, *CAMERA.shape)))
    places = [WithPrepared(lift, right, liquid, lambda: np.zeros(1)) for liquid in LIQUIDS]
    monkeypatch.setattr(BehindLenses, "once", counted)
    told_together(places)
    assert asked == [3, 3]  # of the beams alone, and with the halo
    factors = [lift.of_low(one.centre) for one in places]
    assert asked == [3, 3]
    alone = Lift.of(Followed(haloed, 2, 0, None, family=free(), tables=0.05)).of_low(LIQUIDS[1])
    assert np.allclose(factors[1], alone, rtol=1e-9)


def test_doses_of_a_pattern_are_looked_at_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each by itself, a series of three doses and two patterns behind glass took 120 CPU s before its search began."""
    asked: list[int] = []
    once = BehindLenses.once

    def counted(behind: BehindLenses, media: Sequence[Medium]) -> NDArray[np.float64]:
        asked.append(len(media))
        return once(behind, media)

    few = replace(GLASS, camera=replace(CAMERA, shape=(10, 15), pixel_mm=16.0, blur=Blur(0.0)))
    family = free()
    phase = family.phase(as_free(TwoTerm(0.85, -0.3, 0.96)))
    doses = [Medium(0.0, sigma_s, phase=phase) for sigma_s in (0.002, 0.0021, 0.005, 0.02)]
    model = Lifted(Lift.of(Followed(few, 2, 0, None, small=True, family=family, tables=0.05)))
    monkeypatch.setattr(BehindLenses, "once", counted)
    looked_at_together([model] * 4, doses)
    assert asked[:2] == [3, 3]  # of all light and of the beams alone; two doses are of one density, nearly
    images = [model(one).image for one in doses]
    assert max(asked[2:]) == 1
    alone = Lifted(Lift.of(Followed(few, 2, 0, None, small=True, family=family, tables=0.05)))
    assert np.allclose(images[2], alone(doses[2]).image, rtol=1e-9)


def test_doses_of_a_pattern_have_derivatives_of_order_1_told_together(
    prepared: HighAnswer, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    once = BehindLenses.once

    def counted(behind: BehindLenses, media: Sequence[Medium]) -> NDArray[np.float64]:
        asked.append(len(media))
        return once(behind, media)

    family = reynolds_mccormick()
    sharp = replace(SCENE, projector=replace(LIGHT, halo=Halo(0.02, 30.0)), camera=replace(CAMERA, blur=SHARP))
    lift = Lift.of(Followed(sharp, 2, 0, None, family=family, tables=0.05))
    doses = [Medium(1e-5 * dose, 0.001 * dose, phase=ReynoldsMcCormick(0.65, 1.0)) for dose in (2, 5, 20)]
    dark = np.zeros((1, *CAMERA.shape))
    right = CheckedOrders(prepared, dark[0], dark)
    places = [WithPrepared(lift, right, one, lambda: dark, fine=True) for one in doses]
    monkeypatch.setattr(BehindLenses, "once", counted)
    with_prepared.fine_slopes_together(places, doses)
    each = 2 + family.low.size  # as it is, with more absorption, and along each of the family's coordinates
    assert asked == [3 * each]
    lift.tell_beside(doses)
    assert max(asked[1:]) == each  # the beams' alone; of all light nothing is computed again


def test_behind_glass_low_orders_change_as_all_their_light_does(prepared: HighAnswer) -> None:
    """By factors of each pixel alone derivatives by the shapes of a phase function were 5 to 30 % off."""
    family = free()
    lift = Lift.of(Followed(GLASS, 2, 0, None, family=family, tables=0.05))
    right = CheckedOrders(prepared, np.zeros(CAMERA.shape), np.zeros((1, *CAMERA.shape)))
    place = as_free(ReynoldsMcCormick(0.65, 1.0))
    centre = Medium(0.0004, 0.0102, phase=family.phase(place))
    moved = Medium(0.0004, 0.0106, phase=family.phase(place + 0.3 * np.sin(np.arange(place.size))))
    model = WithPrepared(lift, right, centre, lambda: np.zeros((2 + place.size, *CAMERA.shape)))
    low = model(moved).image - right.image(moved)
    expected, before = (lift.whole.low_image(one) for one in (moved, centre))
    by_factors = lift.bare.low_image(moved) * lift.of_low(centre)
    left, missed = np.linalg.norm(low - expected), np.linalg.norm(by_factors - expected)
    assert left < 0.1 * missed
    assert left < 0.01 * np.linalg.norm(expected - before)
    fine, beams = lift.low_shares(centre, fine=True)
    slopes = fine * before
    step = 1e-3
    for number in (1, 3, 9, 15):
        at = (
            values_of(centre, family) + step * (centre.sigma_s if number == 1 else 1.0) * np.eye(2 + place.size)[number]
        )
        ahead = Medium(float(at[0]), float(at[1]), phase=family.phase(at[2:]))
        change = (lift.whole.low_image(ahead) - before) / (at - values_of(centre, family))[number]
        off = np.linalg.norm(slopes[number] - change)
        assert off < 0.02 * np.linalg.norm(change), number
        assert off < np.linalg.norm(beams[number] * before - change), number


def test_what_was_prepared_is_used_again_where_it_holds_the_liquid(
    prepared: HighAnswer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A series asks once more where its fit has ended, and another box, whose edges are rounded, would take minutes.

    Both versions about a medium are made right by the same light paths.
    """
    asked: list[Box] = []
    looked: list[tuple[float, bool]] = []

    def counted(_: Scene, box: Box, __: float) -> HighAnswer:
        asked.append(box)
        return prepared

    def unchanged(high: HighAnswer, medium: Medium, known: object, *_: object) -> CheckedOrders:
        looked.append((medium.sigma_s, known == checked.FEWEST))
        return CheckedOrders(high, np.zeros(CAMERA.shape), np.zeros((1, *CAMERA.shape)))

    monkeypatch.setattr(with_prepared, "high_orders_prepared", counted)
    monkeypatch.setattr(with_prepared, "checked_at", unchanged)
    monkeypatch.setattr(with_prepared, "checked_by_lattices", unchanged)
    models = family_models(SCENE, free(), prepared=True)
    phase = free().phase(as_free(BEAD))
    found, fine = models.refined(Medium(0.0004, 0.0102, phase=phase))
    again, _ = models.refined(Medium(0.0004, 0.0112, phase=phase))
    assert len(asked) == 1
    assert isinstance(found, WithPrepared)
    assert isinstance(fine, WithPrepared)
    assert isinstance(again, WithPrepared)
    assert (found.fine, fine.fine, again.centre.sigma_s) == (False, True, 0.0112)
    models.refined(Medium(0.0004, 0.02, phase=phase))
    assert len(asked) == 2
    # Where a search has ended, from where a fit goes on, few lattices do.
    assert looked == [(0.0102, True), (0.0112, False), (0.02, True)]
