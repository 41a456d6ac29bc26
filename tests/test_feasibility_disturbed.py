"""Diagnoses of disturbed scenarios without a plan, and the largest tolerable wind."""

from __future__ import annotations

import dataclasses

import pytest

import drake_rho as rho
from drake_rho.analysis.trials import PRECISION, PRECISION_WITH_OBSTACLES, is_monotone
from drake_rho.planning.planners.related import can_be_slower
from tests.scenarios import box, single, slow


def corridor(disturbance: rho.Disturbance | None, **options: object) -> rho.Scenario:
    """Return a flight along x with 0.3 m to each wall."""
    limits = rho.Limits(rho.Box([-1.0, -0.3, -0.3], [11.0, 0.3, 0.3]), **options)  # type: ignore[arg-type]
    straight = single(limits=limits, goal=rho.State([10.0, 0.0, 0.0]), between_knots=True)
    return dataclasses.replace(straight, disturbance=disturbance)


def gap(disturbance: rho.Disturbance | None) -> rho.Scenario:
    """Return two walls with a gap of 0.8 m, the only path to the goal."""
    walls = rho.Box([4, -50, -50], [5, 1.6, 50]), rho.Box([4, 2.4, -50], [5, 50, 50])
    scenario = single(limits=rho.Limits(box(12)), obstacles=walls, between_knots=True)
    return dataclasses.replace(scenario, disturbance=disturbance)


@pytest.mark.slow
def test_longer_is_not_always_possible_with_a_tube_that_grows() -> None:
    """The feedback may take half of 1.5 m/s², so wind of 1 m/s² drives it ever further away."""

    def lasting(duration: float) -> rho.Scenario:
        limits = rho.Limits(position=rho.Box([-2, -2, -2], [3, 2, 2]), max_acceleration=1.5)
        scenario = single(
            grid=rho.Grid(duration / 10, 11), goal=rho.State([1.0, 0, 0]), limits=limits
        )
        return dataclasses.replace(scenario, disturbance=rho.Disturbance(1.0, share=0.5))

    assert rho.verify(rho.plan(lasting(2.0))).ok
    for duration in (4.0, 8.0, 12.0):
        with pytest.raises(rho.InfeasibleError):
            rho.plan(lasting(duration))
    assert not is_monotone(lasting(12.0))
    assert not can_be_slower(lasting(2.0))
    diagnosis = rho.diagnose(lasting(12.0), time_limit=1e6)
    assert diagnosis.shortest_duration is not None
    assert diagnosis.longest_duration is not None
    assert 1.0 < diagnosis.shortest_duration < 2.0 < diagnosis.longest_duration < 4.0
    assert rho.verify(rho.plan(lasting(diagnosis.longest_duration))).ok
    with pytest.raises(rho.InfeasibleError):
        rho.plan(lasting(1.01 * diagnosis.longest_duration))
    assert "or perhaps another instead of 12 s" in str(diagnosis)
    shortest = rho.shortest_plan(lasting(12.0))
    assert rho.verify(shortest).ok
    assert shortest.scenario.grid.duration == pytest.approx(
        diagnosis.shortest_duration, rel=PRECISION
    )


def test_obstacles_do_not_slow_down_with_a_longer_duration() -> None:
    still, ball = single(), rho.Sphere([5.0, 2.0, -1.0], 0.5)
    assert can_be_slower(still)
    assert can_be_slower(dataclasses.replace(still, obstacles=(ball,)))
    moving = rho.Obstacle(ball, velocity=[0.1, 0.0, 0.0])
    assert not can_be_slower(dataclasses.replace(still, obstacles=(moving,)))
    assert not can_be_slower(dataclasses.replace(still, disturbance=rho.Disturbance(0.1)))


@pytest.mark.parametrize("windy", [False, *slow(True)])
def test_a_conflict_states_the_problem_for_which_it_is_proved(windy: bool) -> None:
    limits = rho.Limits(max_acceleration=0.7)
    scenario = single(goal=rho.State([0.9 * 0.7 * 16.0, 0, 0]), limits=limits)
    around = rho.Disturbance(0.3, share=1.0) if windy else None
    scenario = dataclasses.replace(scenario, disturbance=around)
    if not windy:
        scenario = dataclasses.replace(scenario, limits=rho.Limits(max_acceleration=0.6))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(scenario)
    assert caught.value.is_proved == (not windy)
    for reported in (str(caught.value), rho.diagnose(scenario).reason):
        margins = "with the constraints tightened for the disturbance" in reported
        assert margins == windy
        assert "together" in reported


def test_the_largest_wind_of_a_corridor_fills_it_with_the_tube() -> None:
    scenario = corridor(rho.Disturbance(5.0, feedback_every=0.5, delay=1))
    diagnosis = rho.diagnose(scenario)
    known = rho.largest_disturbance(scenario, 0.3)
    assert diagnosis.bearable_wind == pytest.approx(known, rel=0.011)  # bounds over steps: 1 %
    (why,) = diagnosis.conflicts.values()
    assert "disturbance" in why
    assert any("position box" in each for each in why)
    reported = str(diagnosis)
    assert "without a disturbance there is a plan" in reported
    assert "instead of 5 m/s²" in reported
    assert len(reported.splitlines()) <= 12


@pytest.mark.slow
def test_there_is_a_plan_with_the_largest_wind_and_none_with_more() -> None:
    scenario = gap(rho.Disturbance(3.0, feedback_every=0.5))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(scenario)
    assert caught.value.bearable is None  # starts and goals have slack: the gap does not
    less = rho.diagnose(scenario).bearable_wind  # as far as the bound on the work allows
    bearable = rho.diagnose(scenario, time_limit=1e6).bearable_wind
    assert bearable is not None
    assert less is not None
    assert 0.0 < less <= bearable < 3.0
    plan = rho.plan(gap(rho.Disturbance(bearable, feedback_every=0.5)))
    assert rho.verify(plan).ok
    with pytest.raises(rho.InfeasibleError):
        rho.plan(
            gap(
                rho.Disturbance(bearable + 3.0 * 2.0 * PRECISION_WITH_OBSTACLES, feedback_every=0.5)
            )
        )


@pytest.mark.slow
def test_errors_of_the_estimate_alone_may_be_too_large() -> None:
    noisy = rho.Disturbance(0.5, position_error=5.0, velocity_error=5.0, share=0.9)
    scenario = corridor(noisy, acceleration=box(0.8))
    lightest = rho.diagnose(scenario).bearable_wind
    assert lightest is not None
    assert 0.0 < lightest < 0.02  # which is tolerable without feedback
    started = rho.error_tube(scenario, gains=(4.0, 3.0)).tracking
    tracked = corridor(dataclasses.replace(noisy, tracking=started))
    diagnosis = rho.diagnose(tracked)
    assert diagnosis.bearable_wind == 0.0
    assert "with the estimation errors alone there is none" in str(diagnosis)
    assert "wind up to" not in str(diagnosis)


@pytest.mark.slow
def test_infeasibility_without_a_disturbance_is_not_attributed_to_it() -> None:
    weak = rho.Limits(acceleration=box(0.1))
    scenario = dataclasses.replace(single(limits=weak), disturbance=rho.Disturbance(0.01))
    diagnosis = rho.diagnose(scenario)
    assert diagnosis.bearable_wind is None
    assert "disturbance" not in str(diagnosis)
    assert diagnosis.acceleration_factor is not None
    calm = rho.diagnose(dataclasses.replace(scenario, disturbance=None))
    assert calm.bearable_wind is None


def test_subsets_of_disturbed_scenarios_are_irreducible_with_their_margins() -> None:
    """The velocity box alone leaves time enough; tightened by its margins it does not."""
    limits = rho.Limits(velocity=box(1.8), acceleration=box(30.0))
    scenario = single(limits=limits, between_knots=True)
    scenario = dataclasses.replace(scenario, disturbance=rho.Disturbance(3.0, feedback_every=0.1))
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(scenario)
    (names,) = rho.infeasible_subset(caught.value).values()
    assert sorted(name.split(" from")[0] for name in names) == ["goal x", "velocity box x"]


def test_a_missing_margin_at_the_ends_is_its_own_subset() -> None:
    with pytest.raises(rho.InfeasibleError) as caught:
        rho.plan(corridor(rho.Disturbance(5.0, feedback_every=0.5, delay=1)))
    assert caught.value.bearable is not None
    assert rho.infeasible_subset(caught.value) == caught.value.conflicts


def test_shortest_plans_keep_their_margins() -> None:
    limits = rho.Limits(velocity=box(1.8), acceleration=box(3.0))
    scenario = single(limits=limits, between_knots=True)
    disturbed = dataclasses.replace(scenario, disturbance=rho.Disturbance(0.5, feedback_every=0.1))
    calm, shortest = rho.shortest_plan(scenario), rho.shortest_plan(disturbed)
    assert rho.verify(shortest).ok
    assert shortest.scenario.grid.duration > calm.scenario.grid.duration * (1.0 + 1e-3)
