"""The closed loop: an independent simulation, the tube that holds it, the worst case in it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import drake_rho as rho
from tests.disturbed import KINDS, crowded, disturbed, least_margin, winds_for
from tests.loop import Array
from tests.scenarios import single, slow
from tests.tolerances import ROUNDING

KEPT_LATE = (14, 25, 40)
"""Seeds of crowded scenarios with a delay in which windows keep the previous plan."""


def _finely(simulation: rho.Simulation, parts: int) -> tuple[Array, Array]:
    """Return positions and velocities at the times, by Runge-Kutta in fractions of the steps.

    Only the recorded commands and winds are used; the library's integration is not.
    """
    p, v = simulation.positions[0], simulation.velocities[0]
    found = [(p, v)]
    for m, step in enumerate(np.diff(simulation.times)):
        a, h = simulation.commands[m] + simulation.wind[m], step / parts
        for _ in range(parts):
            k1, k2, k4 = v, v + h / 2 * a, v + h * a
            p, v = p + h / 6 * (k1 + 4 * k2 + k4), v + h * a
        found.append((p, v))
    return np.array([p for p, _ in found]), np.array([v for _, v in found])


def commanded(simulation: rho.Simulation, estimated: Array) -> Array:
    """Return the commands at all times by the law of docs/flight.md, sample by sample."""
    scenario, around = simulation.scenario, simulation.scenario.disturbance
    assert around is not None
    grid, sample = scenario.grid, around.sample(scenario.grid)
    k_p, k_v = rho.error_tube(scenario).gains
    commands = np.empty_like(simulation.commands)
    for m, time in enumerate(simulation.times[:-1]):
        window = simulation.flight.windows[
            max(
                number
                for number, each in enumerate(simulation.flight.windows)
                if grid.start + each.first_knot * grid.step <= time + 1e-9
            )
        ]
        tracking = window.plan.scenario.disturbance
        assert tracking is not None
        since = grid.start if tracking.tracking is None else tracking.tracking.since
        j = int((time - grid.start) / sample + 1e-9)
        knot = int((time - grid.start) / grid.step + 1e-9)
        commands[m] = window.plan.accelerations[:, knot - window.first_knot]
        if rho.error_tube(scenario).measurements.predicted:
            commands[m] -= _answer(simulation, estimated, j, round((since - grid.start) / sample))
            continue
        seen = grid.start + (j - around.delay) * sample
        if seen >= since - 1e-9:
            at = int(np.argmin(np.abs(simulation.times - seen)))
            k, part = divmod((j - around.delay) * sample + 1e-9, grid.step)
            # the tracked plan may have begun in an earlier window, which it continues
            tracked = next(
                each
                for each in reversed(simulation.flight.windows)
                if each.first_knot <= min(k, window.first_knot)
            )
            k = int(k) - tracked.first_knot
            a = tracked.plan.accelerations[:, k]
            planned = tracked.plan.positions[:, k] + part * (
                tracked.plan.velocities[:, k] + part / 2 * a
            )
            speed = tracked.plan.velocities[:, k] + part * a
            commands[m] -= k_p * (estimated[at, :, :3] - planned)
            commands[m] -= k_v * (estimated[at, :, 3:] - speed)
    commands[-1] = commands[-2]
    return commands


def _answer(simulation: rho.Simulation, estimated: Array, j: int, since: int) -> Array:
    """Return the feedback of sample j, with its sign changed, by prediction from measurements.

    The newest measurement that has arrived is moved to sample j by the recorded commands.
    """
    scenario, around = simulation.scenario, simulation.scenario.disturbance
    assert around is not None
    grid, h = scenario.grid, around.sample(scenario.grid)
    k_p, k_v = rho.error_tube(scenario).gains
    starts = np.searchsorted(simulation.times, grid.start + h * np.arange(j + 1) - 1e-9)
    time = simulation.times[starts[j]]
    planned = np.concatenate([simulation.nominal(q, time)[0] for q in ("position", "velocity")], 1)
    found = np.zeros((len(scenario.vehicles), 3))
    for i in range(len(found)):
        samples = range(since, j - around.delay + 1)
        known = [k for k in samples if simulation.lost is None or not simulation.lost[k, i]]
        if known:
            p, v = np.split(estimated[starts[known[-1]], i], 2)
            for k in range(known[-1], j):
                a = simulation.commands[starts[k], i]
                p, v = p + h * v + h**2 / 2 * a, v + h * a
            found[i] = k_p * (p - planned[i, :3]) + k_v * (v - planned[i, 3:])
    return found


@pytest.mark.parametrize("kind", [*slow(*KINDS[:-1]), KINDS[-1]])
@pytest.mark.parametrize("delay", [0, *slow(1), 3])
def test_the_loop_equals_an_independent_simulation(kind: str, delay: int) -> None:
    scenario = disturbed(17 + delay, delay=delay, errors=False)
    simulation = rho.simulate(scenario, wind=winds_for(scenario, 3)[kind], replan_every=4)
    positions, velocities = _finely(simulation, 4)
    scale = np.abs(simulation.positions).max()
    np.testing.assert_allclose(simulation.positions, positions, atol=ROUNDING * scale)
    np.testing.assert_allclose(simulation.velocities, velocities, atol=ROUNDING * scale)
    seen = np.concatenate([simulation.positions, simulation.velocities], axis=2)
    commands = commanded(simulation, seen)
    np.testing.assert_allclose(simulation.commands, commands, atol=1e-6 * np.abs(commands).max())
    assert len(simulation.flight.windows) == -(-(scenario.grid.knots - 1) // 4)


@pytest.mark.slow
def test_the_feedback_continues_where_windows_keep_the_previous_plan() -> None:
    """With a delay the feedback answers to errors from before the window."""
    kept = 0
    for seed in KEPT_LATE:
        scenario = crowded(seed)
        assert scenario.disturbance is not None
        assert scenario.disturbance.delay > 0
        simulation = rho.simulate(
            scenario, wind=winds_for(scenario, seed)["constant"], replan_every=3
        )
        seen = np.concatenate([simulation.positions, simulation.velocities], axis=2)
        expected = commanded(simulation, seen)
        np.testing.assert_allclose(simulation.commands, expected, atol=1e-6)
        kept += sum(window.kept for window in simulation.flight.windows)
    assert kept > 0


@pytest.mark.parametrize("seed", [*range(2), *slow(*range(2, 12))])
@pytest.mark.parametrize("kind", KINDS)
def test_errors_never_leave_the_tube(kind: str, seed: int) -> None:
    scenario = disturbed(seed)
    wind = winds_for(scenario, seed)[kind]
    simulation = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=5)
    for quantity in ("position", "velocity", "acceleration"):
        errors = simulation.errors(quantity)[:-1]
        radii = simulation.radii(quantity)[:-1, None]
        assert np.all(errors <= radii * (1.0 + ROUNDING) + 1e-9), quantity
    assert scenario.disturbance is not None
    assert np.linalg.norm(simulation.wind, axis=2).max() <= scenario.disturbance.acceleration + 1e-9
    assert simulation.tracking_difference.max() <= 1e-9


@pytest.mark.parametrize("seeds", [(38, 39, 46), *slow((14, 20, 23, 33, 47, 58))], ids=str)
def test_no_constraint_is_violated_even_where_windows_keep_the_previous_plan(
    seeds: tuple[int, ...],
) -> None:
    """The induction of docs/flight.md promises this, in tight scenarios and winds of all kinds."""
    kept = 0
    for seed in seeds:
        scenario = crowded(seed)
        wind = winds_for(scenario, seed)[KINDS[seed % 6]]
        flown = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(seed), replan_every=3)
        assert least_margin(flown) >= -1e-6, seed
        assert np.all(flown.errors() <= flown.radii()[:, None] * (1.0 + ROUNDING) + 1e-9)
        assert not any(window.off_tube for window in flown.flight.windows)
        assert all(window.kept == bool(window.infeasible) for window in flown.flight.windows)
        kept += sum(window.kept for window in flown.flight.windows)
    assert kept >= len(seeds) - 1


def test_a_wind_above_the_declared_one_leaves_the_tube() -> None:
    scenario = disturbed(1)
    blow = rho.winds.constant(scenario, [0, 0, 1])
    simulation = rho.simulate(
        scenario, wind=lambda *state: 1.5 * blow(*state), rng=np.random.default_rng(1)
    )
    assert np.any(simulation.errors() > 1.05 * simulation.radii()[:, None])


@pytest.mark.parametrize("seed", [*range(4), *slow(*range(4, 10))])
def test_the_worst_case_reaches_the_radius_in_a_single_window(seed: int) -> None:
    scenario, rng = disturbed(100 + seed), np.random.default_rng(seed)
    time = scenario.grid.start + rng.uniform(0.3, 1.0) * scenario.grid.duration
    quantity = ("position", "velocity")[seed % 2]
    wind = rho.worst_case(scenario, rng.normal(size=3), time, quantity)  # type: ignore[arg-type]
    simulation = rho.simulate(scenario, wind=wind, replan_every=scenario.grid.knots)
    assert len(simulation.flight.windows) == 1
    errors = simulation.errors(quantity)  # type: ignore[arg-type]
    at = int(np.argmin(np.abs(simulation.times - time)))
    assert simulation.times[at] == pytest.approx(time, abs=1e-9)
    np.testing.assert_allclose(errors[at], wind.radius, rtol=1e-6)
    np.testing.assert_allclose(simulation.radii(quantity)[at], wind.radius, rtol=1e-6)  # type: ignore[arg-type]
    assert np.all(errors <= simulation.radii(quantity)[:, None] + 1e-9)  # type: ignore[arg-type]


def test_errors_of_estimates_are_within_their_balls_and_fill_them() -> None:
    """Errors of the estimate change the feedback by no more than their bounds."""
    scenario = disturbed(2, delay=0)
    assert scenario.disturbance is not None
    E_p, E_v = scenario.disturbance.position_error, scenario.disturbance.velocity_error
    flown = rho.simulate(scenario, rng=np.random.default_rng(5), replan_every=scenario.grid.knots)
    k_p, k_v = rho.error_tube(scenario).gains
    off = flown.positions - flown.nominal("position")
    fast = flown.velocities - flown.nominal("velocity")
    exact = flown.nominal("acceleration") - k_p * off - k_v * fast
    per_sample = 10
    left = np.linalg.norm(flown.commands - exact, axis=2)[:-1:per_sample]
    assert left.max() <= k_p * E_p + k_v * E_v
    assert left.max() >= 0.5 * (k_p * E_p + k_v * E_v)


def test_without_a_disturbance_only_new_windows_react_to_wind() -> None:
    scenario = dataclasses.replace(single(), disturbance=None)
    still = rho.simulate(scenario, replan_every=4)
    flight = rho.plan_rho(scenario, replan_every=4)
    for one, other in zip(still.flight.windows, flight.windows, strict=True):
        np.testing.assert_allclose(one.plan.accelerations, other.plan.accelerations, atol=1e-9)
    np.testing.assert_allclose(still.positions[-1], flight.plan.positions[:, -1], atol=1e-9)
    np.testing.assert_array_equal(still.radii(), 0.0)

    blow = rho.simulate(scenario, wind=lambda t, p, v: np.full_like(p, 0.05), replan_every=4)
    planned = blow.nominal("acceleration")
    np.testing.assert_array_equal(blow.commands[:-1], planned[:-1])
    for window in blow.flight.windows[1:]:  # each begins where the wind has carried the vehicle
        at = int(np.argmin(np.abs(blow.times - window.plan.scenario.grid.start)))
        np.testing.assert_allclose(window.plan.positions[:, 0], blow.positions[at], atol=1e-9)
    once = rho.simulate(scenario, wind=lambda t, p, v: np.full_like(p, 0.05), replan_every=100)
    miss = [np.linalg.norm(each.positions[-1] - [10.0, 4.0, -2.0]) for each in (blow, once)]
    assert miss[0] < 0.1 * miss[1]


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_windows_begin_at_the_state_predicted_from_delayed_estimates(delay: int) -> None:
    """The difference is exactly the effect of the wind during the delay."""
    scenario = disturbed(17, delay=delay, errors=False)
    assert scenario.disturbance is not None
    late = delay * scenario.disturbance.sample(scenario.grid)
    wind = rho.winds.constant(scenario, [1, 2, 0])
    flown = rho.simulate(scenario, wind=wind, replan_every=3)
    assert len(flown.flight.windows) > 2
    for window in flown.flight.windows[1:]:
        assert not window.kept
        at = int(np.argmin(np.abs(flown.times - window.plan.scenario.grid.start)))
        expected = flown.positions[at] - flown.wind[at] * late**2 / 2.0
        np.testing.assert_allclose(window.plan.positions[:, 0], expected, atol=1e-9)
        expected = flown.velocities[at] - flown.wind[at] * late
        np.testing.assert_allclose(window.plan.velocities[:, 0], expected, atol=1e-9)


@pytest.mark.parametrize("prediction", [True, False])
def test_windows_before_the_first_estimate_begin_at_the_known_starts(prediction: bool) -> None:
    scenario = disturbed(17)
    around = rho.Disturbance(
        0.2, 0.02, 0.05, feedback_every=0.25, delay=5, share=0.4, prediction=prediction
    )
    scenario = dataclasses.replace(scenario, disturbance=around)
    flown = rho.simulate(scenario, rng=np.random.default_rng(1), replan_every=1)
    for window in flown.flight.windows[:5]:
        at = int(np.argmin(np.abs(flown.times - window.plan.scenario.grid.start)))
        away = np.abs(window.plan.positions[:, 0] - flown.positions[at]).max()
        assert (away <= 1e-9) == (window.first_knot < 3)  # two samples in a step, a delay of five


@pytest.mark.parametrize("seed", range(4))
def test_with_exact_estimates_and_no_wind_windows_are_those_of_plan_rho(seed: int) -> None:
    scenario = disturbed(seed)
    flight = rho.plan_rho(scenario)
    for one, other in zip(rho.simulate(scenario).flight.windows, flight.windows, strict=True):
        assert one.infeasible == other.infeasible
        np.testing.assert_allclose(one.plan.accelerations, other.plan.accelerations, atol=1e-9)


def test_simultaneous_changes_are_one_time_of_the_record() -> None:
    scenario = disturbed(4)
    grid = scenario.grid
    track = rho.Track([0.111, 1.2345, 3.0], [[50.0, 0, 0], [51.0, 0, 0], [50.0, 2.0, 0]])
    body = rho.Obstacle(rho.Sphere([0, 0, 0], 0.1), track=track)
    scenario = dataclasses.replace(scenario, obstacles=(*scenario.obstacles, body))
    wind = rho.worst_case(scenario, [1, 0, 0], grid.start + 0.77 * grid.duration)
    times = rho.simulate(scenario, wind=wind).times
    assert scenario.disturbance is not None
    sample = scenario.disturbance.sample(grid)
    samples = grid.start + sample * np.arange(scenario.disturbance.samples(grid) + 1)
    for each in (grid.times, samples, wind.switching_times, np.array([1.2345, 3.0])):
        inside = each[(each >= grid.start) & (each <= grid.end)]
        apart = np.abs(times[:, None] - inside).min(axis=0)
        assert apart.max(initial=0.0) <= 1e-9
    assert np.isin(grid.times, times).all()
    assert np.diff(times).max() <= sample / 10.0 * (1.0 + 1e-9)
    assert np.diff(times).min() > 1e-10


def test_invalid_arguments_are_refused_by_name() -> None:
    scenario = disturbed(1)
    count = len(scenario.vehicles)
    plan = rho.plan(scenario)
    with pytest.raises(
        ValueError, match=rf"^wind: got shape \(3,\) at .* s, .* shape \({count}, 3\)$"
    ):
        rho.simulate(plan, wind=lambda t, p, v: np.zeros(3))
    with pytest.raises(ValueError, match=r"^wind: got \[\[nan.* at .* s, expected finite"):
        rho.simulate(plan, wind=lambda t, p, v: p * np.nan)
    with pytest.raises(TypeError, match=r"^rng: got 3, expected Generator or None"):
        rho.simulate(plan, rng=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"^replan_every: got 0"):
        rho.simulate(scenario, replan_every=0)
    simulation = rho.simulate(plan)
    for method in (simulation.errors, simulation.radii):
        with pytest.raises(ValueError, match=r"^quantity: got 'jerk'"):
            method("jerk")
    with pytest.raises(ValueError, match=r"^wind: got shape"):
        dataclasses.replace(simulation, wind=simulation.wind[1:])
    with pytest.raises(ValueError, match=r"^positions: got values that are not finite"):
        dataclasses.replace(simulation, positions=np.full_like(simulation.positions, np.inf))
    with pytest.raises(ValueError, match=r"^times: got"):
        dataclasses.replace(simulation, times=simulation.times[::-1])
