"""The limit on the norm of the jerk: it holds, has an effect, and is the cone's."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from tests.arrays import FloatArray
from tests.cones import TWIN, twin_cost
from tests.disturbed import disturbed
from tests.scenarios import acceleration_outside, box, examples, fleet, mapped, single, slow
from tests.tolerances import INDEX

FROM_REST = rho.State([0.0, 0.0, 0.0])
MOVING = rho.State([0.0, 0.0, 0.0], [0.5, 0.0, 0.0])
PUSHED = rho.State([0.0, 0.0, 0.0], acceleration=[0.2, -0.1, 0.0])
SPHERE = rho.Sphere([5.0, 2.2, -0.9], 1.5)


def _jerks(plan: rho.Plan) -> FloatArray:
    """Return the norms of the jerks [m/s³], by (7), shape (N, K); NaN where they are free."""
    vehicles = plan.scenario.vehicles
    before = np.array([acceleration_outside(each.start) for each in vehicles])
    after = np.array([acceleration_outside(each.goal) for each in vehicles])
    a = np.concatenate([before[:, None], plan.accelerations, after[:, None]], axis=1)
    jerks: FloatArray = np.linalg.norm(np.diff(a, axis=1), axis=2) / plan.scenario.grid.step
    return jerks


@pytest.mark.parametrize("start", [MOVING, PUSHED, FROM_REST], ids=["free", "pushed", "at rest"])
@pytest.mark.parametrize("most", [0.4, 0.8, 1.5])
def test_it_holds_and_costs_what_the_cones_cost(start: rho.State, most: float) -> None:
    scenario = single(limits=rho.Limits(max_jerk=most), start=start)
    known = twin_cost(scenario)
    if known is None:
        with pytest.raises(rho.InfeasibleError, match="maximum jerk"):
            rho.plan(scenario)
        return
    plan = rho.plan(scenario)
    assert plan.cost == pytest.approx(known, rel=TWIN)
    assert np.nanmax(_jerks(plan)) <= most * (1.0 + 1e-6)
    assert np.isnan(_jerks(plan)[:, 0]).all() == (start is MOVING)
    assert rho.verify(plan).ok


@pytest.mark.parametrize("solver", ["clarabel", *slow("daqp")])
def test_it_binds_past_an_obstacle_at_every_instant(solver: Literal["clarabel", "daqp"]) -> None:
    free = single(obstacles=[SPHERE], between_knots=True)
    limited = dataclasses.replace(free, limits=rho.Limits(max_jerk=1.5))
    loose, tight = (rho.plan(each, solver=solver) for each in (free, limited))
    assert np.nanmax(_jerks(loose)) > 1.9
    assert np.nanmax(_jerks(tight)) == pytest.approx(1.5, rel=1e-6)
    assert tight.cost > loose.cost
    assert rho.verify(tight).ok
    assert not rho.verify(rho.Plan.from_accelerations(limited, loose.accelerations)).ok
    assert rho.certify(tight).is_globally_optimal


def test_along_one_axis_it_is_the_box_of_jerks() -> None:
    ball, sides = (
        rho.plan(single(limits=limits, goal=rho.State([10.0, 0.0, 0.0])))
        for limits in (rho.Limits(max_jerk=0.7), rho.Limits(jerk=box(0.7)))
    )
    assert ball.cost == pytest.approx(sides.cost, rel=INDEX)
    np.testing.assert_allclose(ball.accelerations, sides.accelerations, atol=1e-6)


@given(seed=st.integers(0, 2**32 - 1))
@examples(few=1, many=2)
def test_it_is_the_same_in_every_direction(seed: int) -> None:
    scenario = single(limits=rho.Limits(max_jerk=0.8), obstacles=[SPHERE])
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turned = mapped(scenario, turn, np.zeros(3), length=2.0, time=3.0)
    one, other = rho.plan(scenario), rho.plan(turned)
    assert other.cost == pytest.approx(one.cost * (2.0 / 9.0) ** 2, rel=1e-4)


def test_each_vehicle_has_its_own() -> None:
    scenario = fleet([[0, 0, 0], [0, 5, 0]], [[10, 0, 0], [10, 5, 0]])
    one, other = scenario.vehicles
    other = dataclasses.replace(other, limits=rho.Limits(max_jerk=0.4))
    plan = rho.plan(dataclasses.replace(scenario, vehicles=(one, other)))
    first, second = np.nanmax(_jerks(plan), axis=1)
    assert second == pytest.approx(0.4, rel=1e-6)
    assert first > 0.5


def test_windows_keep_it_from_the_acceleration_that_was_flown() -> None:
    scenario = single(limits=rho.Limits(max_jerk=0.8), obstacles=[SPHERE])
    flight = rho.plan_rho(scenario, replan_every=2)
    assert rho.verify(flight).ok
    assert np.nanmax(_jerks(flight.plan)) == pytest.approx(0.8, rel=1e-6)


def test_disturbed_flights_keep_it_in_their_plans() -> None:
    calm = disturbed(1)
    limits = dataclasses.replace(calm.limits, max_jerk=6.0)
    scenario = dataclasses.replace(calm, limits=limits)
    flight = rho.plan_rho(scenario, replan_every=3)
    assert np.nanmax(_jerks(flight.plan)) <= 6.0 * (1.0 + 1e-6)
    assert rho.verify(rho.simulate(scenario)).ok


def test_a_reason_is_given_where_it_leaves_no_plan() -> None:
    scenario = single(limits=rho.Limits(max_jerk=0.02))
    found = rho.diagnose(scenario)
    assert any("maximum jerk" in name for name in found.conflicts["solo"])
    assert found.shortest_duration is not None
    assert found.shortest_duration > scenario.grid.duration


@pytest.mark.parametrize("most", [0.0, -1.0, np.nan, np.inf, True, "far"])
def test_what_is_no_limit_is_told(most: object) -> None:
    with pytest.raises(rho.ScenarioError, match="max_jerk"):
        rho.Limits(max_jerk=most)  # type: ignore[arg-type]  # on purpose


def test_figures_show_it() -> None:
    plan = rho.plan(single(limits=rho.Limits(max_jerk=0.8)))
    panel = rho.accelerations_figure(plan).axes[3]
    assert "j" in panel.get_ylabel()
    (limit,) = [line for line in panel.lines if np.all(np.asarray(line.get_ydata()) == 0.8)]
    assert limit.get_linestyle() == "--"
