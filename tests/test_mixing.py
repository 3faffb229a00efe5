"""The run goes on when the ink has really mixed: not before, whatever the time scale, and not long after.

`python -m tests.test_mixing` prints how long it waits and what is really left.
"""

import numpy as np
import pytest

from tankrig.run.mixing import Mixing, MixingWatch

ROWS, COLUMNS = 80, 120
Y, X = np.mgrid[:ROWS, :COLUMNS]
SHEET = 2000 * np.exp(-(((Y - 40) / 10) ** 2)) * np.exp(-X / 80) + 100
PLUME = np.exp(-(((Y - 40) / 12) ** 2) - ((X - 60) / 15) ** 2)
SCALE = np.sqrt(((SHEET - SHEET.min()) ** 2).mean())


def watched(structure, seed: int, light: float = 1.0, tolerance: float = 0.01) -> tuple[Mixing, float]:
    """Watch a sheet with a plume of `structure(t)`, with shot noise; what was seen and what was really left."""
    chance, watch = np.random.default_rng(seed), MixingWatch()
    for time_s in np.arange(0.0, 300.0, 0.25):
        plume = SHEET * PLUME * structure(time_s)
        expected = light * (SHEET + plume)
        picture = expected + np.sqrt(expected) * chance.standard_normal(expected.shape)
        mixing = watch.look(np.round(picture.clip(0)).astype(np.uint16), time_s)
        if mixing.remaining <= tolerance and mixing.seconds >= 3.0:
            break
    return mixing, float(np.sqrt((plume**2).mean()) / SCALE)


@pytest.mark.parametrize(("tau_s", "at_most_s"), [(0.5, 8.0), (2.0, 14.0), (5.0, 28.0), (20.0, 85.0)])
def test_a_plume_is_waited_for_as_long_as_it_takes(tau_s, at_most_s):
    for seed in (1, 2):
        mixing, left = watched(lambda t: np.exp(-t / tau_s), seed)
        assert left <= 0.01
        assert mixing.seconds <= at_most_s
        assert mixing.time_scale_s is not None
        if tau_s >= 2.0:
            assert mixing.time_scale_s == pytest.approx(tau_s, rel=0.35)


def test_a_slow_tail_behind_a_fast_beginning_is_waited_for():
    mixing, left = watched(lambda t: 0.7 * np.exp(-t / 2.0) + 0.3 * np.exp(-t / 8.0), seed=1)
    assert left <= 0.01
    assert mixing.seconds < 40.0


def test_a_darkening_plume_counts_like_a_brightening_one():
    _, left = watched(lambda t: -0.5 * np.exp(-t / 5.0), seed=1)
    assert left <= 0.01


def test_a_tank_at_rest_is_not_waited_for_long():
    mixing, _ = watched(lambda _: 0.0, seed=1)
    assert mixing.seconds <= 10.0


def test_noise_costs_time_and_not_truth():
    _, left = watched(lambda t: np.exp(-t / 2.0), seed=1, light=0.1)
    assert left <= 0.01


def test_darkness_never_counts_as_mixed():
    watch = MixingWatch()
    seen = [watch.look(np.zeros((10, 10), np.uint16), 0.1 * number) for number in range(30)]
    assert all(mixing.remaining == np.inf for mixing in seen)


if __name__ == "__main__":
    for tau_s in (0.5, 2.0, 5.0, 20.0):
        seen = [watched(lambda t, tau_s=tau_s: np.exp(-t / tau_s), seed) for seed in range(10)]
        left, waited, found = (
            [round(float(f), 4) for f in np.percentile(values, [0, 50, 100])]
            for values in (
                [left for _, left in seen],
                [mixing.seconds for mixing, _ in seen],
                [mixing.time_scale_s for mixing, _ in seen],
            )
        )
        print(f"τ = {tau_s:g} s: really left {left}, waited {waited} s, found τ {found} s (least, median, most of 10)")
    seen = [watched(lambda _: 0.0, seed)[0].seconds for seed in range(10)]
    print(f"at rest: waited {np.percentile(seen, [0, 50, 100])} s")
