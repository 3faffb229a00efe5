"""Fits by models that are made right where each has led: how far they trust them, and whether they have settled."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from tankrig.estimation import by_prepared
from tankrig.estimation.by_shares import CLOSE


@dataclass(frozen=True)
class Valley:
    """A problem of one shape, whose real cost is the square of its distance from 1, and which knows it to `sd`."""

    close: tuple[np.ndarray, float] | None = None
    sd: float = 1e-9

    def at(self, coordinates: np.ndarray) -> "Place":
        return Place(self, coordinates)


@dataclass(frozen=True)
class Place:
    """Where a fit is."""

    problem: Valley
    coordinates: np.ndarray

    @property
    def row(self) -> np.ndarray:
        return self.coordinates

    @property
    def deviations(self) -> np.ndarray:
        return np.full(1, self.problem.sd)

    @property
    def deviations_by_parts(self) -> np.ndarray:
        return np.full(1, 2.0)

    @property
    def chain(self) -> np.ndarray:
        return np.eye(1)

    @property
    def cost(self) -> float:
        return 100.0 * float((self.coordinates[0] - 1.0) ** 2)


def led(
    monkeypatch: pytest.MonkeyPatch,
    promise: Callable[[float, float], float],
    sd: float = 1e-9,
    weight: float = 1.0,
    roughly: list[bool] | None = None,
    suffices: Callable[[Any], bool] | None = None,
) -> tuple[Place, Any, list[float], float]:
    """The end of a fit from 0 that derivatives lead by so much at a place where nothing is held, or shapes are held so
    closely; by how much it was still to be corrected; how closely shapes were held each time; and how far from the
    truth the worst place was that it went on from. What was made right roughly is added."""
    held: list[float] = []
    asked: list[bool] = [] if roughly is None else roughly

    def made_right(_: object, best: Place, by_few: bool = False) -> list[tuple[Place, None]]:
        asked.append(by_few)
        return [(best, None)]

    def solved(problem: Valley, start: np.ndarray, *_: object, **__: object) -> Place:
        close = problem.close[1] if problem.close else 0.0
        held.append(close)
        return problem.at(start + promise(float(start[0]), close) / (1.0 + close))

    gone_on: list[float] = []

    def accurate(_: Valley, __: object, centre: Place, *___: object, **____: object) -> Valley:
        gone_on.append(abs(float(centre.coordinates[0]) - 1.0))
        return Valley(sd=sd)

    monkeypatch.setattr(by_prepared, "versions_near", made_right)
    monkeypatch.setattr(by_prepared, "accurate_problem", accurate)
    monkeypatch.setattr(by_prepared, "solve", solved)
    monkeypatch.setattr(by_prepared, "whole_step", lambda ahead: np.array([promise(float(ahead.coordinates[0]), 0.0)]))
    monkeypatch.setattr(by_prepared, "costs_more", lambda ahead, centre, *_: ahead.cost > centre.cost + 3.0)
    monkeypatch.setattr(
        by_prepared, "are_foretold", lambda there, before: abs(float((there[0][0].row - before[0][0].row)[0])) < 0.02
    )
    start = Valley().at(np.zeros(1))
    before = [(Valley().at(np.full(1, -1.0)), None)]
    ended = by_prepared.by_centres(cast(Any, start), [], cast(Any, before), weight, suffices)
    return cast(Any, ended.best), ended.moved, held, max(gone_on)


def test_a_fit_whose_derivatives_promise_too_much_gets_there_in_shorter_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    """By derivatives that led 14 times too far it went to and fro, and its end explained less than its beginning."""
    end, moved, held, worst = led(monkeypatch, lambda at, _: (14.0 if abs(at - 1.0) > 0.5 else 1.0) * (1.0 - at))
    assert held[:2] == [CLOSE, by_prepared.FIRMER * CLOSE]
    assert worst == 1.0
    assert abs(float(end.coordinates[0]) - 1.0) < 0.05
    assert moved is None


@pytest.mark.parametrize(("weight", "few"), [(1.0, False), (10.0, False), (3500.0, True)])
def test_images_that_hold_much_besides_noise_are_made_right_by_fewer_light_paths(
    weight: float, few: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An emulsion's bench, whose images seem to tell 3,500 times more than they do, took 323 CPU s a place."""
    asked: list[bool] = []
    led(monkeypatch, lambda at, _: 1.0 - at, weight=weight, roughly=asked)
    assert asked
    assert set(asked) == {few}


def test_a_fit_that_nothing_bears_out_stays_and_says_that_it_has_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    end, moved, held, _ = led(monkeypatch, lambda *_: -60.0)
    np.testing.assert_array_equal(end.coordinates, 0.0)
    assert len(held) == by_prepared.MOST_REFUSED
    assert moved is not None
    assert float(np.abs(moved).max()) > 0.1


def test_a_fit_that_leads_astray_wherever_it_is_let_go_ends_where_holding_it_leads_nowhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beads of .5 µm behind glass were let go and held again at one place until no centres were left."""

    def promise(at: float, close: float) -> float:
        if at < 0.9:
            return (0.95 - at) * (1.0 + close)
        return 0.0 if close else -30.0

    end, moved, held, _ = led(monkeypatch, promise)
    assert held == [CLOSE, CLOSE, 0.0, by_prepared.FIRMER * CLOSE]
    assert float(end.coordinates[0]) == pytest.approx(0.95)
    assert moved is not None
    assert float(moved[0]) == pytest.approx(-30.0)


@pytest.mark.parametrize(("sd", "weight", "places"), [(2.0, 1.0, 2), (1e-9, 1.0, 3), (1e-9, 100.0, 2)])
def test_a_fit_ends_where_no_value_moves_by_what_is_known_of_it(
    monkeypatch: pytest.MonkeyPatch, sd: float, weight: float, places: int
) -> None:
    """An emulsion's series on a bench made models right at seven places, the last four .1 % of σs apart: two minutes
    each. Where images hold structure, parts of them say how well values are known, be noise as little as it may."""
    end, moved, held, _ = led(
        monkeypatch, lambda at, close: (0.9 if at < 0.5 else 0.05) * (1.0 - at) * (1.0 + close), sd, weight
    )
    assert len(held) == places
    assert moved is None
    assert abs(float(end.coordinates[0]) - 1.0) < 0.1


def test_a_fit_that_shapes_held_keep_from_moving_has_not_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would end wherever it is held closely enough."""
    end, moved, held, _ = led(monkeypatch, lambda at, close: (1.0 - at) * (0.02 if close else 1.0), 0.5)
    assert held[0] == CLOSE
    assert len(held) > 1
    assert abs(float(end.coordinates[0]) - 1.0) < 0.05
    assert moved is None


def test_a_fit_ends_at_the_first_place_that_tells_what_is_fitted_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bench each place takes minutes, and a free phase function's seventeen numbers follow structure at each: an
    emulsion's σs was 4.7 % too large after the last of twelve, though the first had told of spheres."""
    seen: list[float] = []

    def suffices(fit: Any) -> bool:
        seen.append(float(fit.optimum.coordinates[0]))
        return len(seen) == 2

    end, moved, held, _ = led(monkeypatch, lambda at, _: 0.5 * (1.0 - at), suffices=suffices)
    assert len(held) == 2
    assert seen[1] == float(end.coordinates[0])
    assert moved is not None
    assert float(moved[0]) == pytest.approx(seen[1] - seen[0])
