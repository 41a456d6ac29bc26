"""Flights are recorded and verified as flown: from the states with which their windows began."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import drake_rho as rho
from tests.arrays import FloatArray
from tests.flown_loops import ROUNDING, least_distances, off_record, random_loop
from tests.scenarios import slow

FAR = 3.9 * 0.08
"""Distance of vehicles in sizes, beyond which `verify` reports an upper bound only."""
PRECISE = 1e-8
"""Amount by which `verify` may miss a smaller distance, a hundredth of its tolerance, over the
size."""
SAMPLED = 1e-6
"""Largest excess of a sampled least distance, over the size of a scene."""


@pytest.mark.parametrize("seed", [*range(5), *slow(*range(5, 120))])
def test_records_equal_an_integration_of_what_was_commanded(seed: int) -> None:
    """The report's least distances are those of dense samples of that integration."""
    try:
        loop = random_loop(seed)
    except rho.ScenarioError:
        loop = None  # the scene contradicts itself
    if loop is None:
        return
    assert off_record(loop) <= ROUNDING, loop.words
    knots = {knot for knot, _ in loop.jumps}
    assert knots == set(loop.flight.plan.jumps)
    size = float(loop.flight.scenario.fleet.lengths.max())
    missed = PRECISE * size + _while_the_clock_ticks(loop.flight)
    for vehicle, what, own, told, _ in least_distances(loop):
        if what == "separation" and told > FAR * size:
            continue
        assert -missed <= own - told <= SAMPLED * size, (vehicle, what, loop.words)


def _while_the_clock_ticks(flight: rho.Flight) -> float:
    """Return how far anything flies in the rounding of a time at which it becomes known [m]."""
    scenario, times = flight.scenario, flight.plan.times
    tracks = [body.velocities(times) for body in scenario.bodies]
    motions = [*flight.plan.velocities, *tracks]
    fastest = max(float(np.linalg.norm(each, axis=-1).max()) for each in motions)
    return 2.0 * fastest * float(np.spacing(scenario.grid.end))


def windy(*, sphere: float = 0.8, **changes: object) -> rho.Scenario:
    """Return a vehicle that flies 6 m past a sphere in 6 s."""
    scout = rho.Vehicle("scout", rho.State([0, 0, 1]), rho.State([6, 0, 1]), radius=0.2)
    scenario = rho.Scenario(
        "loop",
        rho.Grid(0.1, 61),
        [scout],
        rho.Limits(max_speed=3.0, max_acceleration=4.0),
        obstacles=[rho.Sphere([3.0, -0.3, 1.0], sphere)],
    )
    return dataclasses.replace(scenario, **changes)  # type: ignore[arg-type]  # any field


def flown(scenario: rho.Scenario, wind: FloatArray, every: int = 5) -> rho.Flight:
    """Return the flight of windows from the states that a steady wind leads to."""
    horizon = rho.RecedingHorizon(scenario, replan_every=every)
    states, h = horizon.planned(0), scenario.grid.step
    for knot in horizon.knots:
        window = horizon.step(states, scenario.grid.times[knot])
        for k in range(min(every, scenario.grid.knots - 1 - knot)):
            a = window.plan.accelerations[:, k] + wind
            p = states[:, :3] + h * states[:, 3:] + h * h / 2.0 * a
            states = np.hstack([p, states[:, 3:] + h * a])
    return horizon.flight


DRIFT = np.array([0.0, 0.3, 0.0])


def test_a_flight_in_wind_is_recorded_where_it_was() -> None:
    """Its commands from the start would end metres away."""
    around = rho.Disturbance(0.4, feedback_every=0.1)
    flight = flown(windy(disturbance=around), DRIFT, every=1)
    commanded = rho.Plan.from_accelerations(flight.scenario, flight.plan.accelerations)
    goal = flight.scenario.fleet.goal_positions
    assert np.linalg.norm(commanded.positions[:, -1] - goal) > 1.0
    report = rho.verify(flight)
    assert report.ok
    assert report.clearance is not None
    assert 0.0 < report.clearance.left < 0.2
    assert not rho.verify(commanded).ok


def test_a_vehicle_that_came_too_close_is_not_recorded_clear() -> None:
    wind = np.array([0.0, -0.3, 0.0])
    flight = flown(windy(), wind)
    report = rho.verify(flight)
    assert not report.ok
    assert {each.constraint for each in report.violations} == {"obstacle 1"}
    commanded = rho.Plan.from_accelerations(flight.scenario, flight.plan.accelerations)
    clear = [each for each in rho.verify(commanded).checks if each.constraint == "obstacle 1"]
    assert all(each.holds for each in clear)


def test_the_report_tells_the_largest_jump_once() -> None:
    flight = flown(windy(), DRIFT)
    report = rho.verify(flight)
    told = [each for each in report.notes if "jump" in each]
    jump = report.summary.largest_jump
    assert jump is not None
    # half a second of 0.3 m/s²: 0.0375 m and 0.15 m/s
    assert jump.vehicle == "scout"
    assert jump.position == pytest.approx(0.0375, rel=1e-3)
    assert jump.velocity == pytest.approx(0.15, rel=1e-3)
    assert len(told) == 1
    assert all(words in told[0] for words in (str(jump), "scout", "11 windows"))
    assert "gap to the optimum" not in str(report)


def test_windows_that_begin_on_plan_leave_one_motion() -> None:
    flight = flown(windy(), np.zeros(3))
    again = rho.Plan.from_accelerations(flight.scenario, flight.plan.accelerations)
    assert flight.plan.jumps == ()
    np.testing.assert_array_equal(flight.plan.positions, again.positions)
    report = rho.verify(flight)
    assert report.summary.largest_jump is None
    assert "gap to the optimum" in str(report)


def test_states_at_a_jump_are_those_after_it() -> None:
    flight = flown(windy(grid=rho.Grid(0.1, 61, start=1.7e9)), DRIFT)
    knot = flight.plan.jumps[3]
    time = flight.scenario.grid.times[knot]
    window = next(each for each in flight.windows if each.first_knot == knot)
    at = flight.at([time - 1e-4, time], vehicle="scout")
    np.testing.assert_array_equal(at.positions[1], window.plan.positions[0, 0])
    assert 0.03 < np.linalg.norm(at.positions[0] - at.positions[1]) < 0.05
    assert 0.1 < np.linalg.norm(at.velocities[0] - at.velocities[1]) < 0.2


def test_a_first_window_from_another_state_jumps_from_the_start() -> None:
    scenario = windy()
    horizon = rho.RecedingHorizon(scenario, replan_every=60)
    states = scenario.fleet.start_states + np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    horizon.step(states, 0.0)
    flight = horizon.flight
    assert flight.plan.jumps == (0,)
    np.testing.assert_array_equal(flight.plan.states(0), states)
    jump = rho.verify(flight).summary.largest_jump
    assert jump is not None
    assert jump.time == 0.0
    assert jump.position == pytest.approx(0.02)


def test_flights_that_jump_are_saved_whole(tmp_path: Path) -> None:
    flight = flown(windy(), DRIFT)
    rho.save(flight, tmp_path / "flight.npz")
    again = rho.load(tmp_path / "flight.npz")
    assert again.plan.jumps == flight.plan.jumps
    np.testing.assert_array_equal(again.plan.positions, flight.plan.positions)
    assert str(rho.verify(again)) == str(rho.verify(flight))


def test_older_files_are_read_as_flown(tmp_path: Path) -> None:
    """Their plans integrate all commands from the start."""
    flight = flown(windy(), DRIFT)
    forgetful = rho.Plan.from_accelerations(
        flight.scenario, flight.plan.accelerations, flight.plan.statistics
    )
    rho.save(dataclasses.replace(flight, plan=forgetful), tmp_path / "older.npz")
    again = rho.load(tmp_path / "older.npz")
    assert again.plan.jumps == flight.plan.jumps
    np.testing.assert_array_equal(again.plan.positions, flight.plan.positions)


def test_a_changed_record_is_found_out() -> None:
    """A piece is verified from its window's first states, not from the record's own."""
    flight = flown(windy(), DRIFT)
    positions = np.array(flight.plan.positions)
    positions[:, flight.plan.jumps[2] :] += [0.0, 0.0, 0.01]
    changed = dataclasses.replace(flight.plan, positions=positions)
    report = rho.verify(dataclasses.replace(flight, plan=changed))
    assert "dynamics" in {each.constraint for each in report.violations}


def test_exports_of_flights_that_jump(tmp_path: Path) -> None:
    """What is to be flown is refused, what was flown is written with its jumps."""
    flight = flown(windy(), DRIFT)
    for format, name in (("crazyswarm", "swarm"), ("px4", "setpoints.csv")):
        with pytest.raises(ValueError, match=r"jumps to measured states, as scout at .* by 0.0375"):
            rho.export(flight, tmp_path / name, format=format)
    rho.export(flight, tmp_path / "plan.json", format="json")
    again = rho.load(tmp_path / "plan.json")
    assert again.plan.jumps == flight.plan.jumps
    np.testing.assert_array_equal(again.plan.positions, flight.plan.positions)
    assert str(rho.verify(again)) == str(rho.verify(flight))
    written = rho.export(flight, tmp_path / "show.zip", format="skybrush", rate=7.0)
    ticks = np.arange(0.0, 6.0, 1.0 / 7.0).round(3)
    chords = flight.at(ticks, vehicle="scout").positions
    dense = np.linspace(0.0, ticks[-1], 6001)
    joined = np.stack([np.interp(dense, ticks, each) for each in chords.T], axis=1)
    off = np.linalg.norm(joined - flight.at(dense, vehicle="scout").positions, axis=1).max()
    assert 0.0375 / 2.0 < off <= written.deviation < 0.1


def test_a_flight_that_jumps_is_not_tracked() -> None:
    flight = flown(windy(), DRIFT)
    with pytest.raises(ValueError, match="jumps to measured states"):
        rho.simulate(flight)


def test_certificates_of_flights_that_jump_claim_no_optimum() -> None:
    certificate = rho.certify(flown(windy(), DRIFT))
    assert certificate.jumps
    assert not certificate.is_globally_optimal


def test_curves_have_gaps_at_jumps() -> None:
    flight = flown(windy(), DRIFT)
    for figure in (rho.velocities_figure(flight), rho.distances_figure(flight)):
        curves = [np.asarray(each.get_ydata(), dtype=np.float64) for each in figure.axes[0].lines]
        assert np.isnan(max(curves, key=len)).sum() == len(flight.plan.jumps)
    assert rho.paths_figure(flight).axes
    assert rho.animate(flight).HasPath("/flight/trails")


@pytest.mark.parametrize("between", [True, False])
def test_speeds_before_a_jump_count(between: bool) -> None:
    """A window is accelerated to the limit; the next one begins slower."""
    limits = rho.Limits(max_speed=1.5, max_acceleration=4.0)
    scenario = windy(obstacles=[], limits=limits, between_knots=between)
    plan = rho.plan(scenario)
    states = {20: plan.states(20) - [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]}
    accelerations = np.array(plan.accelerations)
    accelerations[:, :20] = [0.8, 0.0, 0.0]
    pieces = rho.Plan.in_pieces(scenario, accelerations, states)
    found = {each.constraint: each for each in rho.verify(pieces).checks}
    assert found["maximum speed"].value == pytest.approx(1.6)
    assert found["maximum speed"].time == pytest.approx(2.0)
    assert not found["maximum speed"].holds
