"""Light without edges, and what clear walls send back, are computed coarsely: nothing that a camera sees is lost."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tankrig.light import tank
from tankrig.light.double import double_scattering_of
from tankrig.light.entering import edged_and_smooth, entering, through_lens
from tankrig.light.leaving import CameraLens
from tankrig.light.order_one import once, once_through
from tankrig.light.prepared.sampling import PathImages
from tankrig.light.single import single_scattering
from tankrig.light.tank import twice, twice_of
from tankrig.light.walls.once import by_walls_of
from tankrig.scene import Medium
from tankrig.scene.optics import NO_HALO, Face, Faces, Halo, WideLens
from tests.optics_scenes import a_calibrated_scene, apart

GLASS = Face("glass")
MEDIUM = Medium(0.0, 0.012, 0.6)


def a_dim_scene(shape=(27, 40)):
    """Three beams on a calibrated bench, with a projector's halo and a dark picture that is none."""
    scene = a_calibrated_scene((3.157, 0.0, 0.0), 6.0, shape)
    light = replace(scene.projector, halo=Halo(0.02, 25.0), black_level=0.0005)
    return replace(scene, projector=light, medium=MEDIUM)


@cache  # two tests look at it
def smooth_by_tables():
    """Order 2 of light without edges, by tables of coarse cells."""
    _, smooth = edged_and_smooth(CameraLens.of(a_dim_scene()).wide, fine=False)
    return double_scattering_of(smooth, [MEDIUM], 0.01, little=True)[0]


def test_smooth_light_is_looked_up_on_coarse_cells_and_shows_the_same():
    """In fine pixels it took most of a bench's order 1, and by tables of fine cells 20 to 40 times what rays do."""
    wide = CameraLens.of(a_dim_scene()).wide
    edged, _ = edged_and_smooth(wide, fine=False)
    first, second = once(wide), twice_of(wide, [wide.medium], 0.01)[0]
    size = np.linalg.norm(first + second)
    _, finely = edged_and_smooth(wide)
    assert np.linalg.norm(first - once(edged_and_smooth(wide)[0]) - single_scattering(finely)) < 0.0005 * size
    by_tables = smooth_by_tables()
    assert np.linalg.norm(by_tables) > 0.005 * size  # there is something to be missed
    assert np.linalg.norm(second - twice(edged, 0.01) - by_tables) < 0.0005 * size


def test_a_prepared_models_order_2_of_smooth_light_comes_along_paths():
    scene = a_dim_scene()
    paths, lens = PathImages(scene, (1.0, 0.8)), CameraLens.of(scene)
    found = paths.to_pixels(paths.twice_smooth(MEDIUM, 1, range(24)))
    np.testing.assert_allclose(found[1], 0.64 * found[0], rtol=1e-9)
    expected = lens.of_wide(smooth_by_tables())
    bright = expected > 0.2 * expected.max()
    off = (found[0].reshape(expected.shape) - expected)[bright] / expected[bright].mean()
    assert abs(off.mean()) < 0.01
    assert np.sqrt(np.mean(off**2)) < 0.1  # by so few paths
    rays = replace(scene, projector=replace(scene.projector, halo=NO_HALO, black_level=0.0))
    assert not PathImages(rays, (1.0,)).twice_smooth(MEDIUM, 1, range(1)).any()


def with_little_light():
    """Rays with half a per cent of their light in a projector's halo."""
    scene = a_dim_scene()
    light = replace(scene.projector, halo=Halo(0.005, 25.0), black_level=0.0)
    return CameraLens.of(replace(scene, projector=light)).wide


def test_little_light_has_tables_as_much_coarser(monkeypatch):
    """Fine tables of a halo of .4 % took 60 % of the time that a bench's fine derivatives did."""
    asked = []

    def as_asked(_scene, _media, tolerance, _others):
        asked.append(tolerance)
        return 0.0

    monkeypatch.setattr(tank, "twice_edged_of", lambda *_: 0.0)
    monkeypatch.setattr(tank, "twice_smooth_of", as_asked)
    twice_of(with_little_light(), [MEDIUM], 0.001)
    assert 0.15 < asked[0] < 0.35


@pytest.mark.long
def test_coarse_tables_do_for_little_light():
    """They err by 2 % of it."""
    _, smooth = edged_and_smooth(with_little_light(), fine=False)
    found, finely = (tank.twice_smooth_of(smooth, [MEDIUM], one)[0] for one in (0.2, 0.001))
    assert 0.0 < apart(found, finely) < 0.05


@pytest.mark.long
def test_few_pinholes_and_coarse_cells_do_for_what_walls_send_back():
    """By as many as beams seen directly, order 1 of a bench of glass with a halo took hundreds of seconds."""
    scene = a_dim_scene()
    light = replace(scene.projector, halo=NO_HALO, black_level=0.0, wide_lens=WideLens(12.0, 100.0))
    tank = replace(scene.tank, faces=Faces(entry=GLASS, far=GLASS, left=GLASS, right=GLASS))
    lens = CameraLens.of(replace(scene, tank=tank, projector=light))
    (found,), _ = once_through(lens, [scene.medium])
    expected, by_walls = np.zeros((2, *found.shape))
    for share, one in through_lens(entering(lens.fine, fine=True), fine=True):
        expected += share * lens.means(single_scattering(one))
        by_walls += share * by_walls_of(one, [scene.medium]).seen_by(lens.wide)[0]
    assert apart(found, expected) > 0.02  # walls show something
    assert apart(found, expected + by_walls) < 0.002
