"""Liquids are not Henyey–Greenstein: every family, particles and tables, in all models."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tankrig
from drivers.simulated.tank import mixture
from tankrig.errors import SceneError
from tankrig.light.double import double_scattering
from tankrig.light.lightfield.spectrum import spectrum
from tankrig.montecarlo import simulate
from tankrig.montecarlo.draws import phase_table
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.mie import Mie
from tankrig.scene.mie_series import coefficients, scattered_by
from tankrig.scene.phase_functions import (
    FournierForand,
    HenyeyGreenstein,
    Mixture,
    ReynoldsMcCormick,
    Tabulated,
    TwoTerm,
    phase_function,
)
from tankrig.scene.phase_table import BLUNT, PhaseFunction

BEAD = Mie(1.0, 1.5868, 1.3317, 633.0)
LIGHT = Projector("collimated", (Beam((-42.0, -38.0), (58.0, 62.0)), Beam((-2.0, 2.0), (58.0, 62.0))))
CAMERA = Camera("orthographic", (20, 30), 8.0)

families = st.one_of(
    st.builds(HenyeyGreenstein, st.floats(-0.9, 0.97)),
    st.builds(TwoTerm, st.floats(0.0, 0.97), st.floats(-0.9, 0.0), st.floats(0.0, 1.0)),
    st.builds(ReynoldsMcCormick, st.floats(0.05, 0.95), st.floats(-0.4, 1.5)),
    st.builds(FournierForand, st.floats(1.02, 1.3), st.floats(3.1, 4.5)),
    st.builds(Mie, st.floats(0.05, 3.0), st.floats(1.4, 1.7), st.just(1.33), st.floats(400.0, 700.0)),
)


def scene(medium: Medium) -> Scene:
    return Scene(Tank(), medium, LIGHT, CAMERA)


@settings(max_examples=60, deadline=None)
@given(families)
def test_a_phase_function_sends_all_light_somewhere_and_draws_what_it_says(phase: PhaseFunction) -> None:
    """Otherwise every order of scattering would gain or lose light, and paths would go elsewhere than p says."""
    moments = phase.moments(3)
    assert moments[0] == pytest.approx(1.0, abs=1e-9)
    assert np.all(np.abs(moments) <= 1.0 + 1e-9)
    assert phase.mean_cosine == pytest.approx(moments[1], abs=1e-9)
    record = phase.record
    if hasattr(record, "cosines"):
        place = np.linspace(0.0, 1.0, 100_001)
        cosines = np.interp(place, np.linspace(0.0, 1.0, record.cosines.size), record.cosines)
        assert np.trapezoid(cosines, 1.0 - (1.0 - place) ** 4) == pytest.approx(phase.mean_cosine, abs=2e-4)
    table = phase_table(phase)
    if hasattr(table, "below"):
        assert table.below[-1] == pytest.approx(1.0)
        mean = float(np.sum(np.diff(table.below) * 0.5 * (table.cosines[1:] + table.cosines[:-1])))
        assert mean == pytest.approx(phase.mean_cosine, abs=2e-3)


def test_a_lobe_that_ends_straight_backwards_has_a_width() -> None:
    """A fit that met such a liquid divided by zero."""
    low, high = 0.1, 0.3
    for _ in range(60):  # to where p has just fallen to 1/2.8 straight backwards, and nowhere before
        g = 0.5 * (low + high)
        table = ReynoldsMcCormick(g, 0.5).table
        fallen = table < table[0] / 2.8
        if fallen[-1] and not fallen[-2]:
            break
        low, high = (g, high) if not fallen[-1] else (low, g)
    assert fallen[-1]
    assert not fallen[-2]
    assert math.isfinite(ReynoldsMcCormick(g, 0.5).record.width)


def test_a_pole_straight_on_takes_no_light_from_elsewhere() -> None:
    """Natural waters turn half of their light by less than 5°: straight lines between a table's nodes made that .4 % of
    all light too much, and p at a right angle too small by as much."""
    waters = FournierForand(1.1, 3.58)
    logs = np.linspace(math.log(1e-30), math.log(2.0), 400_001)  # of 1 − cos θ, in which a pole is smooth
    by = waters.density(1.0 - np.exp(logs)) * np.exp(logs)
    light = 2.0 * math.pi * float(np.sum(0.5 * (by[1:] + by[:-1]) * np.diff(logs)))
    for cosine in (0.9, 0.0, -0.7):
        exact = float(waters.density(np.array([cosine]))[0]) / light
        assert float(waters.at(cosine)) == pytest.approx(exact, rel=3e-4)


def test_a_peak_that_paths_see_blunted_keeps_its_light() -> None:
    """Else orders ≥ 3 of natural waters would gain or lose what they scatter nearly straight on."""
    waters, beads = FournierForand(1.1, 3.58), Mie(2.0, 1.58, 1.3317, 633.0)
    assert waters.blunted[BLUNT:] == pytest.approx(waters.table[BLUNT:], rel=1e-12)
    assert np.ptp(waters.blunted[:BLUNT]) == 0.0
    assert waters.blunted[0] < 0.02 * waters.table[0]
    sines = np.linspace(0.0, 1.0, waters.table.size)
    fine = np.linspace(0.0, sines[BLUNT], 100_001)
    light, evenly = (np.trapezoid(np.interp(fine, sines, one) * fine, fine) for one in (waters.table, waters.blunted))
    assert evenly == pytest.approx(light, rel=1e-4)
    assert beads.blunted is beads.table


def test_families_nest_henyey_greenstein() -> None:
    cosine = np.linspace(-1.0, 1.0, 101)
    expected = phase_function(cosine, 0.7)
    for phase in (TwoTerm(0.7, 0.0, 1.0), ReynoldsMcCormick(0.7, 0.5)):
        assert phase.at(cosine) == pytest.approx(expected, rel=1e-4)
    assert Medium(0.0, 0.01, phase=HenyeyGreenstein(0.7)) == Medium(0.0, 0.01, 0.7)


def test_mie_is_miepythons_and_small_spheres_are_rayleighs() -> None:
    import miepython

    cosine = np.linspace(-1.0, 1.0, 181)
    size = math.pi * BEAD.water_index * BEAD.diameter_um / (BEAD.wavelength_nm / 1000.0)
    ratio = BEAD.particle_index / BEAD.water_index
    assert BEAD.at(cosine) == pytest.approx(miepython.i_unpolarized(ratio, size, cosine, norm="one"), rel=1e-3)
    area = miepython.efficiencies_mx(ratio, size)[1] * math.pi * BEAD.diameter_um**2 / 4.0
    assert BEAD.cross_section_um2 == pytest.approx(area, rel=1e-9)
    small = Mie(0.005, 1.58, 1.33, 633.0)
    assert small.at(cosine) == pytest.approx(3.0 / (16.0 * math.pi) * (1.0 + cosine**2), rel=1e-3)


@pytest.mark.parametrize(("diameter_um", "index"), [(0.003, 1.4), (0.06, 1.46), (0.7, 1.37), (2.6, 1.59), (31.0, 1.6)])
def test_spheres_of_any_size_are_miepythons(diameter_um: float, index: float) -> None:
    import miepython

    bead = Mie(diameter_um, index, 1.33, 532.0)
    ratio, size = index / 1.33, math.pi * diameter_um * 1.33 / 0.532
    cosine = np.cos(np.radians(np.linspace(0.0, 180.0, 91)))
    across, along = miepython.S1_S2(ratio, size, cosine, norm="wiscombe")
    expected = np.abs(across) ** 2 + np.abs(along) ** 2
    found = bead.density(cosine)
    np.testing.assert_allclose(found / found[0], expected / expected[0], rtol=1e-6, atol=1e-9)
    area = miepython.efficiencies_mx(ratio, size)[1] * math.pi * diameter_um**2 / 4.0
    assert bead.cross_section_um2 == pytest.approx(area, rel=1e-6)


@pytest.mark.parametrize(("diameter_um", "spread", "within"), [(0.17, 0.36, 1e-4), (0.4, 0.5, 1e-3), (3.0, 0.4, 0.02)])
def test_a_mixture_of_sizes_is_a_log_normal_to_its_end(diameter_um: float, spread: float, within: float) -> None:
    """Small spheres scatter as the sixth power of their diameter, so that few large ones count; of large ones
    resonances are to be averaged over."""
    mixture, width = Mie(diameter_um, 1.465, 1.333, 532.0, spread), math.sqrt(math.log1p(spread**2))
    at = np.linspace(-5.0, 5.0 + 6.0 * width, 1200)
    numbers = np.exp(-0.5 * at**2) / np.exp(-0.5 * at**2).sum()
    cosine = np.cos(np.radians(np.linspace(0.0, 180.0, 46)))
    own, whole, _ = scattered_by(
        diameter_um * np.exp(width * at - 0.5 * width**2), 1.465 / 1.333, 2e3 * math.pi * 1.333 / 532.0, cosine
    )
    assert mixture.cross_section_um2 == pytest.approx(float(numbers @ own), rel=1e-4)
    np.testing.assert_allclose(mixture.density(cosine), numbers @ whole / (numbers @ own), rtol=within)


@pytest.mark.parametrize("ratio", [0.8, 1.01, 1.19, 2.0])
def test_many_spheres_have_the_coefficients_of_each(ratio: float) -> None:
    """Small and large ones at once, and sizes at which sin x, where ψ begins, is next to 0."""
    import miepython

    sizes = np.concatenate([np.geomspace(0.01, 60.0, 30), math.pi * np.arange(1.0, 5.0)])
    a, b, terms = coefficients(ratio, sizes)
    for k, size in enumerate(sizes):
        of_one = miepython.coefficients(ratio, float(size))
        assert terms[k] == len(of_one[0])
        largest = float(np.abs(of_one).max())
        for found, expected in zip((a[k], b[k]), of_one, strict=True):
            assert found[: terms[k]] == pytest.approx(expected, rel=0.0, abs=1e-9 * largest)
            assert (found[terms[k] :] == 0.0).all()


def test_what_mie_says_of_latex_where_the_camera_looks() -> None:
    """Mie over Henyey–Greenstein at the same mean cosine, at 90°: .86, .45, .40, .64 at 633 nm."""
    for diameter, expected in ((0.2, 0.86), (0.5, 0.45), (1.0, 0.40), (2.0, 0.64)):
        bead = Mie(diameter, 1.58242, 1.3317, 633.0)
        assert float(bead.at(0.0) / phase_function(np.array(0.0), bead.mean_cosine)) == pytest.approx(
            expected, abs=0.006
        )


@pytest.mark.parametrize(
    "phase",
    [
        pytest.param(TwoTerm(0.9, -0.4, 0.9), id="two", marks=pytest.mark.long),
        pytest.param(BEAD, id="bead"),
        pytest.param(TwoTerm(0.5, -0.5, 0.3), id="back"),
    ],
)
def test_the_tank_and_the_monte_carlo_agree_on_any_liquid(phase: PhaseFunction) -> None:
    """Tables, drawing and quadratures are each side's own."""
    liquid = scene(Medium(0.0005, 0.02, phase=phase))
    predicted, tally = tankrig.predict(liquid, "tank", 0.01), simulate(liquid, 400_000)
    for order in (1, 2, 3):
        total = predicted.orders[order].sum() / tally.orders[order].sum()
        assert total == pytest.approx(1.0, abs=0.01), order
    off = np.linalg.norm(predicted.image - tally.image) / np.linalg.norm(tally.image)
    assert off < math.hypot(0.01, tally.noise, 0.004)
    wrong = tankrig.predict(scene(Medium(0.0005, 0.02, phase.mean_cosine)), "tank", 0.05)
    assert np.linalg.norm(wrong.image - tally.image) / np.linalg.norm(tally.image) > 0.1


def test_order_2_of_a_pole_is_the_monte_carlos() -> None:
    """Light that turns by a fraction of a degree, and then towards the camera, is in the beams themselves: the table of
    order 2 began too far from them, and was 4 % too faint."""
    liquid = scene(Medium(0.0005, 0.02, phase=FournierForand(1.1, 3.58)))
    tally = simulate(liquid, 400_000)
    assert double_scattering(liquid).sum() == pytest.approx(tally.orders[2].sum(), rel=0.01)


def test_a_mixture_scatters_as_its_parts_do() -> None:
    first, second = TwoTerm(0.9, -0.4, 0.9), HenyeyGreenstein(0.1)
    mixed = Mixture((first, second), (0.25, 0.75))
    assert mixed.moments(5) == pytest.approx(0.25 * first.moments(5) + 0.75 * second.moments(5), abs=1e-6)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_convolution_turns_light_by_the_phase_function(order: int) -> None:
    """n scatterings turn by a phase function whose moments are χⁿ, and weigh ϖⁿ⁻¹ σs."""
    phase = TwoTerm(0.6, -0.3, 0.7)
    medium = Medium(0.004, 0.016, phase=phase)
    wave = np.array([1e-9])
    found, _ = spectrum(medium, (order, order), wave, np.array([0.3]), np.array([0.5]), 40)
    degrees = np.arange(41)
    expected = (2.0 * degrees + 1.0) / (4.0 * math.pi) * phase.moments(40) ** order @ legendre_at_right_angle(40)
    assert found[0, 0] == pytest.approx(medium.albedo ** (order - 1) * medium.sigma_s * expected, rel=2e-3)


def legendre_at_right_angle(highest: int) -> np.ndarray:
    return np.array([np.polynomial.legendre.Legendre.basis(degree)(0.0) for degree in range(highest + 1)])


def test_single_knows_the_phase_function() -> None:
    liquid = scene(Medium(0.001, 0.003, phase=TwoTerm(0.6, -0.3, 0.7)))
    whole = tankrig.predict(liquid, "tank", 0.01)
    assert tankrig.predict(liquid, "single").image == pytest.approx(whole.orders[1])


INDICES = "particle_index = 1.59, water_index = 1.33, wavelength_nm = 633"
TABLE = "\n".join(f"{c:.6f} {1.0 / (4.0 * math.pi) * (1.0 + 0.9 * c):.8f}" for c in np.linspace(-1.0, 1.0, 41))


def scene_file(folder: Path, phase: str) -> Path:
    file = folder / "scene.toml"
    file.write_text(
        f'[tank]\nsize_mm = [240.0, 160.0, 120.0]\nsurface = "matched"\n[medium]\nsigma_a = 0.001\nsigma_s = 0.01\n'
        f'{phase}\n[projector]\nkind = "collimated"\nbeams = [ {{ y_mm = [-2.0, 2.0], z_mm = [58.0, 62.0], '
        f'irradiance = 1.0 }} ]\n[camera]\nkind = "orthographic"\nshape = [20, 30]\npixel_mm = 8.0\n'
    )
    return file


def test_a_scene_file_names_a_phase_function(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text("# cosine value\n" + TABLE)
    table = tankrig.load_scene(scene_file(tmp_path, 'phase = { kind = "table", file = "p.txt" }')).medium
    assert table.g == pytest.approx(0.3, abs=1e-3)
    bead = "diameter_um = 1.0, particle_index = 1.5868, water_index = 1.3317, wavelength_nm = 633"
    assert tankrig.load_scene(scene_file(tmp_path, f'phase = {{ kind = "mie", {bead} }}')).medium.phase == BEAD


@pytest.mark.parametrize(
    ("phase", "said"),
    [
        ('phase = { kind = "mei" }', 'medium.phase.kind = "mei" is unknown; did you mean "mie"?'),
        ('phase = { kind = "two-term", forward = 1.2, backward = 0.0, share = 0.5 }', "forward = 1.2 is outside"),
        (
            'phase = { kind = "two-term", forward = 1.0, backward = 0.0, share = 0.5 }',
            "= 1.0 is outside 0 ≤ forward < 1;",
        ),
        (
            f'phase = {{ kind = "mie", diameter_um = -1.0, {INDICES} }}',
            "-1.0 is outside 0.001 … 50; give",
        ),
        (
            'phase = { kind = "table", cosines = [-0.98, 1.0], values = [0.08, 0.08] }',
            "cosines go from -0.98 to 1",
        ),
        ('phase = { kind = "reynolds-mccormick", g = 0.5 }', 'key "medium.phase.alpha" is missing'),
        ('phase = { kind = "table", file = "no.txt" }', "no.txt"),
        ('phase = { kind = "mie", diameter_um = 1.0, particle_index = 1.59, water_index = 1.33 }', "wavelength_nm"),
        ('g = 0.5\nphase = { kind = "two-term", forward = 0.9, backward = 0.0, share = 0.5 }', "leave one of them out"),
    ],
)
def test_what_is_no_phase_function_is_refused_in_one_sentence(tmp_path: Path, phase: str, said: str) -> None:
    with pytest.raises(SceneError, match=r"scene\.toml") as refused:
        tankrig.load_scene(scene_file(tmp_path, phase))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("-1 0.1\n1 0.1", "integral"),
        ("-1 -0.1\n0 0.2\n1 0.1", "negative"),
        ("-1 0.0001\n0.5 0.0001\n0.999 20.0\n1 20", "coarse"),
        ("0 0.1\n1 0.1", "from −1 to 1"),
        ("-1 0.1\n-1 0.1\n1 0.1", "rise"),
        ("-1 one\n1 0.1", "row 1"),
        ("-1 nan\n1 0.1", "finite"),
    ],
)
def test_a_bad_table_is_refused(tmp_path: Path, rows: str, said: str) -> None:
    (tmp_path / "p.txt").write_text(rows)
    with pytest.raises(SceneError) as refused:
        tankrig.load_scene(scene_file(tmp_path, 'phase = { kind = "table", file = "p.txt" }'))
    assert said in str(refused.value)
    assert str(refused.value).startswith(f"{tmp_path / 'p.txt'}: ")


def test_a_table_may_be_off_by_rounding_only() -> None:
    cosines = tuple(np.linspace(-1.0, 1.0, 5).tolist())
    even = 1.0 / (4.0 * math.pi)
    assert Tabulated(cosines, (1.01 * even,) * 5).mean_cosine == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(SceneError, match="integral"):
        Tabulated(cosines, (1.05 * even,) * 5)


def test_prepared_models_say_that_they_know_henyey_greenstein_only() -> None:
    """They would answer for a Henyey–Greenstein liquid, 20 to 200 % off, without a word."""
    liquid = scene(Medium(0.0005, 0.02, phase=BEAD))
    with pytest.raises(
        SceneError, match=r'medium\.phase of kind "mie" is known to predictions and to fits of one image'
    ):
        tankrig.prepare(liquid)


def test_lines_of_fits_hold_what_earlier_versions_read() -> None:
    """A key more in a journal's `ink`, and an earlier tankrig could not open the run."""
    from tankrig.live.results import SeriesFit, to_fields

    fields = to_fields(SeriesFit((0.1, 0.2), Medium(0.001, 0.02, 0.7), Medium(1e-4, 0.0, 0.0)))
    assert fields["ink"] == {"sigma_a": 0.001, "sigma_s": 0.02, "g": 0.7}


def test_the_simulated_tank_keeps_the_inks_phase_function() -> None:
    """Beads would be shown as the Henyey–Greenstein liquid of their mean cosine, or as another's stored picture."""
    water, ink = Medium(1e-4, 1.9e-6, 0.0), Medium(0.0, 0.01, phase=BEAD)
    filled = mixture(water, ink, 2.0)
    by_part = (1.9e-6 * HenyeyGreenstein(0.0).moments(3) + 0.02 * BEAD.moments(3)) / (0.02 + 1.9e-6)
    assert filled.phase_function.moments(3) == pytest.approx(by_part, abs=1e-6)
    assert str(filled) != str(Medium(filled.sigma_a, filled.sigma_s, filled.g))


@pytest.mark.parametrize("diameter_um", [1.0, 2.0])
def test_coarse_tables_of_order_2_see_the_lobes_of_spheres(diameter_um: float) -> None:
    """Fine ones are within .1 % of an independent program's sum of order 2; coarse ones were .6 and .9 % off it."""
    beads = Medium(0.0003, 0.01, phase=Mie(diameter_um, 1.58242, 1.3317, 633.0, 0.02))
    light = Projector("collimated", tuple(Beam((low, low + 4.0), (58.0, 62.0)) for low in (-42.0, -2.0, 38.0)))
    scene = Scene(Tank(), beads, light, Camera("orthographic", (40, 60), 4.0))
    assert double_scattering(scene, 0.01).sum() == pytest.approx(double_scattering(scene, 0.0005).sum(), rel=2e-3)
