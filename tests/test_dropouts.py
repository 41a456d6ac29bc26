"""Measurements that are lost: the tube is the largest over all patterns, and is reached."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import drake_rho as rho
from tests.disturbed import KINDS, crowded, disturbed, least_margin, winds_for
from tests.loop import Array, fine_times, summed_responses
from tests.scenarios import slow
from tests.test_closed_loop import commanded
from tests.test_tube import random_tube, scenario_of, sizes_of
from tests.test_worst_case import QUANTITIES, flown_case
from tests.tolerances import ROUNDING

Pattern = NDArray[np.bool_]


def longest_run(lost: Pattern) -> int:
    """Return the largest number of lost measurements in a row, over all vehicles."""
    columns = np.asarray(lost).reshape(len(lost), -1).T
    return max(
        (
            sum(1 for _ in run)
            for each in columns
            for is_lost, run in itertools.groupby(each)
            if is_lost
        ),
        default=0,
    )


def patterns(samples: int, most: int) -> list[Pattern]:
    """Return every pattern of lost measurements with at most this many in a row."""
    every = np.array(list(itertools.product([False, True], repeat=samples)))
    return [each for each in every if longest_run(each) <= most]


@pytest.mark.parametrize("dropouts", [1, 2, 3])
@pytest.mark.parametrize("seed", [*range(4), *slow(*range(4, 12))])
def test_radii_are_the_largest_of_all_patterns(seed: int, dropouts: int) -> None:
    while True:
        tube, loop = random_tube(seed, dropouts)
        if 3 <= loop.samples <= 7:
            break
        seed += 100
    parts = 4
    times = tube.grid.start + fine_times(loop, parts)
    radii = tube.position(times), tube.velocity(times), tube.acceleration(times[:-1:parts])
    known = [np.zeros(each.shape) for each in radii]
    for lost in patterns(loop.samples, dropouts):
        found = summed_responses(loop, parts, sizes_of(tube), lost)
        known = [np.maximum(*both) for both in zip(known, found, strict=True)]
    for largest, radius in zip(known, radii, strict=True):
        assert np.all(largest <= radius * (1.0 + ROUNDING) + ROUNDING * radius.max())
        np.testing.assert_allclose(largest, radius, rtol=0, atol=radius.max() / parts**2)
    if loop.samples > loop.delay + 2:  # a lost measurement has an effect
        none = summed_responses(loop, parts, sizes_of(tube))
        assert np.any(known[0] > 1.001 * none[0])


@pytest.mark.parametrize("dropouts", [1, 2, 3, 7])
@pytest.mark.parametrize("seed", range(12))
def test_the_worst_case_with_its_lost_measurements_reaches_the_radius(
    seed: int, dropouts: int
) -> None:
    tube, loop = random_tube(2000 + seed, dropouts)
    rng = np.random.default_rng(seed)
    quantity = QUANTITIES[seed % 3]
    time = tube.grid.start + rng.uniform(0.3, 1.0) * tube.grid.duration
    direction = rng.normal(size=3)
    scenario = scenario_of(tube.disturbance, tube.grid)
    case = rho.worst_case(scenario, direction, time, quantity, tube=tube)  # type: ignore[arg-type]
    assert longest_run(case.lost) <= dropouts
    flown = flown_case(tube, loop, case, time)
    reached = flown[quantity] @ direction / np.linalg.norm(direction)
    assert reached == pytest.approx(float(getattr(tube, quantity)(time)), rel=1e-9, abs=1e-12)
    assert flown["all"].max() <= 1.0 + 1e-9


def test_more_lost_measurements_make_no_radius_smaller() -> None:
    for seed in range(6):
        tubes = [random_tube(seed, dropouts)[0] for dropouts in (1, 2, 4)]
        times = np.linspace(tubes[0].grid.start, tubes[0].grid.end, 57)
        for quantity in ("position", "velocity", "acceleration"):
            radii = [getattr(tube, quantity)(times) for tube in tubes]
            for fewer, more in itertools.pairwise(radii):
                assert np.all(more >= fewer * (1.0 - ROUNDING))


def lossy(seed: int, dropouts: int, *, errors: bool = True, crowd: bool = False) -> rho.Scenario:
    """Return a disturbed scenario whose measurements may be lost."""
    scenario = crowded(seed) if crowd else disturbed(seed, errors=errors)
    assert scenario.disturbance is not None
    around = dataclasses.replace(scenario.disturbance, dropouts=dropouts)
    return dataclasses.replace(scenario, disturbance=around)


class Losing:
    """Wind in one direction, without estimation errors, and chosen lost measurements."""

    def __init__(self, scenario: rho.Scenario, lost: Pattern) -> None:
        assert scenario.disturbance is not None
        self._blow = rho.winds.constant(scenario, [1.0, 2.0, 0.0])
        samples = scenario.disturbance.samples(scenario.grid)
        self.position_errors = self.velocity_errors = np.zeros((samples, 3))
        self.lost = lost

    def __call__(self, time: float, positions: Array, velocities: Array) -> Array:
        """Return the wind, (N, 3)."""
        return np.asarray(self._blow(time, positions, velocities))


@pytest.mark.parametrize("dropouts", [1, 3])
@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_the_loop_with_lost_measurements_equals_an_independent_one(
    seed: int, dropouts: int
) -> None:
    scenario = lossy(17 + seed, dropouts, errors=False)
    wind = winds_for(scenario, seed)["constant"]
    simulation = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=4)
    assert simulation.lost is not None
    assert 1 <= longest_run(simulation.lost) <= dropouts
    seen = np.concatenate([simulation.positions, simulation.velocities], axis=2)
    commands = commanded(simulation, seen)
    np.testing.assert_allclose(simulation.commands, commands, atol=1e-6 * np.abs(commands).max())


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 16))])
def test_errors_never_leave_the_tube_in_windows_with_lost_measurements(seed: int) -> None:
    dropouts = 1 + seed % 3
    scenario = lossy(seed, dropouts)
    wind = winds_for(scenario, seed)[KINDS[seed % len(KINDS)]]
    if hasattr(wind, "lost"):  # the worst case for the first window alone
        assert longest_run(wind.lost) <= dropouts
    rng = np.random.default_rng(seed)
    simulation = rho.simulate(scenario, wind=wind, rng=rng, replan_every=1 + seed % 5)
    assert not any(window.off_tube or window.unseen for window in simulation.flight.windows)
    for quantity in ("position", "velocity", "acceleration"):
        errors = simulation.errors(quantity)[:-1]
        radii = simulation.radii(quantity)[:-1, None]
        assert np.all(errors <= radii * (1.0 + ROUNDING) + 1e-9), quantity


@pytest.mark.slow
def test_no_constraint_is_violated_where_measurements_are_lost() -> None:
    kept = flights = 0
    for seed in (14, 20, 25, 33, 40, 46):
        scenario = lossy(seed, 2, crowd=True)
        wind = winds_for(scenario, seed)[KINDS[seed % 6]]
        try:
            flown = rho.simulate(
                scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=3
            )
        except rho.InfeasibleError:
            continue
        flights += 1
        assert least_margin(flown) >= -1e-6, seed
        assert np.all(flown.errors() <= flown.radii()[:, None] * (1.0 + ROUNDING) + 1e-9)
        kept += sum(window.kept for window in flown.flight.windows)
    assert flights >= 3
    assert kept >= 1


@pytest.mark.parametrize("seed", [*range(3), *slow(*range(3, 6))])
def test_the_worst_case_reaches_the_radius_in_a_simulated_flight(seed: int) -> None:
    scenario, rng = lossy(100 + seed, 1 + seed % 3), np.random.default_rng(seed)
    time = scenario.grid.start + rng.uniform(0.3, 1.0) * scenario.grid.duration
    quantity = ("position", "velocity")[seed % 2]
    wind = rho.worst_case(scenario, rng.normal(size=3), time, quantity)  # type: ignore[arg-type]
    simulation = rho.simulate(scenario, wind=wind, replan_every=scenario.grid.knots)
    errors = simulation.errors(quantity)  # type: ignore[arg-type]
    at = int(np.argmin(np.abs(simulation.times - time)))
    np.testing.assert_allclose(errors[at], wind.radius, rtol=1e-9)
    assert np.all(errors <= simulation.radii(quantity)[:, None] + 1e-9)  # type: ignore[arg-type]
    if wind.lost.any():  # the lost measurements are needed
        received = dataclasses.replace(wind, lost=np.zeros_like(wind.lost))
        others = rho.simulate(scenario, wind=received, replan_every=scenario.grid.knots)
        assert np.all(others.errors(quantity)[at] < wind.radius)  # type: ignore[arg-type]


def test_the_attack_uses_lost_measurements() -> None:
    scenario = lossy(3, 3)
    plan = rho.plan(scenario)
    attack = rho.attack(scenario, plan)
    assert attack.simulation.lost is not None
    assert attack.clearance == pytest.approx(attack.bound, abs=1e-6)
    assert attack.bound < rho.attack(lossy(3, 0), plan).bound


@pytest.mark.parametrize(
    ("delay", "dropouts"),
    [
        (2, 3),
        pytest.param(0, 2, marks=pytest.mark.slow),
        pytest.param(1, 1, marks=pytest.mark.slow),
    ],
)
def test_windows_begin_at_the_state_predicted_from_the_newest_measurement(
    delay: int, dropouts: int
) -> None:
    """The error there is that of wind since a measurement of the largest declared age."""
    scenario = disturbed(17, delay=delay, errors=False)
    assert scenario.disturbance is not None
    around = dataclasses.replace(scenario.disturbance, acceleration=0.02, dropouts=dropouts)
    scenario = dataclasses.replace(scenario, disturbance=around)
    samples, per_step = around.samples(scenario.grid), around.samples_per_step(0.5)
    lost = np.zeros(samples, dtype=bool)
    for knot in range(3, scenario.grid.knots - 1, 3):  # the last ones that arrive before a window
        newest = knot * per_step - delay
        lost[newest - dropouts + 1 : newest + 1] = True
    assert longest_run(lost) == dropouts
    flown = rho.simulate(scenario, wind=Losing(scenario, lost), replan_every=3)
    position, velocity = around.first_error(scenario.grid)
    assert len(flown.flight.windows) > 2
    for window in flown.flight.windows[1:]:
        assert (window.kept, window.unseen, window.off_tube) == (False, (), ())
        at = int(np.argmin(np.abs(flown.times - window.plan.scenario.grid.start)))
        off = np.linalg.norm(window.plan.positions[:, 0] - flown.positions[at], axis=1)
        fast = np.linalg.norm(window.plan.velocities[:, 0] - flown.velocities[at], axis=1)
        np.testing.assert_allclose(off, position, rtol=1e-6)
        np.testing.assert_allclose(fast, velocity, rtol=1e-6)
    lost[newest - dropouts] = True  # one more than declared
    late = rho.simulate(scenario, wind=Losing(scenario, lost), replan_every=3).flight.windows[-1]
    assert late.unseen == scenario.names


def test_drake_flies_the_same_lost_measurements_and_files_preserve_them(tmp_path: Path) -> None:
    scenario = lossy(5, 2)
    wind = winds_for(scenario, 5)["noise"]
    one = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(7))
    other = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(7))
    assert one.lost is not None
    np.testing.assert_array_equal(one.lost, other.lost)
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-9)
    rho.save(other, tmp_path / "flown.npz")
    loaded = rho.load(tmp_path / "flown.npz")
    assert isinstance(loaded, rho.Simulation)
    np.testing.assert_array_equal(loaded.lost, other.lost)
    none = rho.simulate(lossy(5, 0), wind=wind, rng=np.random.default_rng(7))
    assert none.lost is None
    with pytest.raises(ValueError, match=r"^lost: got shape \(3,\)"):
        dataclasses.replace(none, lost=np.zeros(3, dtype=bool))


def test_without_a_prediction_the_feedback_is_linear_in_one_measurement() -> None:
    scenario = disturbed(17, delay=2, errors=False)
    assert scenario.disturbance is not None
    around = dataclasses.replace(scenario.disturbance, prediction=False)
    scenario = dataclasses.replace(scenario, disturbance=around)
    simulation = rho.simulate(scenario, wind=winds_for(scenario, 3)["noise"], replan_every=4)
    seen = np.concatenate([simulation.positions, simulation.velocities], axis=2)
    commands = commanded(simulation, seen)
    np.testing.assert_allclose(simulation.commands, commands, atol=1e-6 * np.abs(commands).max())
    assert np.all(simulation.errors() <= simulation.radii()[:, None] * (1.0 + ROUNDING) + 1e-9)
