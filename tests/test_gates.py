"""Waypoints with a velocity, a dwell and a name, and requirements between named waypoints."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram, SolverOptions

import drake_rho as rho

FORWARDS = rho.Cone([0, 0, 0], [1, 0, 0], 0.2)


def scene(*waypoints: rho.Waypoint, **changes: Any) -> rho.Scenario:
    """Return a flight of 12 m along x in 10 s with some waypoints."""
    start, goal = rho.State([0, 0, 1]), rho.State([12, 0, 1])
    vehicle = rho.Vehicle("scout", start, goal, radius=0.2, waypoints=waypoints)
    limits = rho.Limits(max_speed=5.0, max_acceleration=6.0)
    given = {"limits": limits, **changes}
    return rho.Scenario("gates", rho.Grid.lasting(10.0, step=0.25), [vehicle], **given)


GATE = rho.Waypoint(2.13, [3, 1, 1], velocity=rho.Cone([0, 0, 0], [0, 1, 0], 0.2), name="gate")
STOP = rho.Waypoint(4.3, [6, 2, 1], dwell=1.2, name="stop")
OUT = rho.Waypoint(8.0, [9, -2, 1], 0.1, velocity=[1, 0.5, 0], name="out")
SLOW = rho.KeepIn(rho.Ball([0, 0, 0], 2.9), of="velocity", between=("stop", "out"), name="slow")
SOFT = rho.KeepIn(rho.Ball([0, 0, 0], 5.0), of="acceleration", between=("start", "gate"))
MISSION = scene(GATE, STOP, OUT, requirements=[SLOW, SOFT])


def dense(plan: rho.Plan, count: int = 20_001) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, positions and velocities of a plan's one vehicle, integrated anew."""
    h, a = plan.scenario.grid.step, plan.accelerations[0]
    p, v = [plan.scenario.vehicles[0].start.position], [plan.scenario.vehicles[0].start.velocity]
    for each in a:
        p.append(p[-1] + h * v[-1] + h**2 / 2.0 * each)
        v.append(v[-1] + h * each)
    times = np.linspace(0.0, h * len(a), count)
    k = np.minimum((times / h).astype(int), len(a) - 1)
    t = (times - k * h)[:, None]
    positions = np.array(p)[k] + t * np.array(v)[k] + t**2 / 2.0 * a[k]
    return times, positions, np.array(v)[k] + t * a[k]


def at(plan: rho.Plan, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return position and velocity at a time."""
    times, p, v = dense(plan)
    return (
        np.array([np.interp(time, times, p[:, i]) for i in range(3)]),
        np.array([np.interp(time, times, v[:, i]) for i in range(3)]),
    )


def own_cost(
    scenario: rho.Scenario, rest: range, slow: range, gate: rho.Waypoint | None = None
) -> float:
    """Return the least cost of a program of its own: rest and slow knots, a gate at a knot."""
    grid, vehicle = scenario.grid, scenario.vehicles[0]
    n, h, limits = grid.knots - 1, grid.step, scenario.limits
    assert limits.max_speed is not None
    assert limits.max_acceleration is not None
    prog = MathematicalProgram()
    a = prog.NewContinuousVariables(n, 3)
    p, v = prog.NewContinuousVariables(n + 1, 3), prog.NewContinuousVariables(n + 1, 3)

    def within(x: np.ndarray, most: float) -> None:
        A = np.vstack([np.zeros(3), np.eye(3)])
        prog.AddLorentzConeConstraint(A, np.array([most, 0.0, 0.0, 0.0]), x)

    one, next_to = np.eye(3), np.array([1.0, -1.0])
    moved = np.hstack([*(each * one for each in next_to), -h * one, -(h**2) / 2.0 * one])
    sped = np.hstack([*(each * one for each in next_to), -h * one])
    for k in range(n):
        prog.AddLinearEqualityConstraint(
            moved, np.zeros(3), np.hstack([p[k + 1], p[k], v[k], a[k]])
        )
        prog.AddLinearEqualityConstraint(sped, np.zeros(3), np.hstack([v[k + 1], v[k], a[k]]))
        within(a[k], limits.max_acceleration)
    for k, state in ((0, vehicle.start), (n, vehicle.goal)):
        prog.AddLinearEqualityConstraint(one, state.position, p[k])
        prog.AddLinearEqualityConstraint(one, state.velocity, v[k])
    for k in range(1, n):
        most = 1.5 if k in slow else limits.max_speed
        within(v[k], most)
        if k in rest:
            prog.AddLinearEqualityConstraint(one, np.zeros(3), v[k])
    for each in vehicle.waypoints:
        assert each.time is not None
        prog.AddLinearEqualityConstraint(one, each.position, p[round(each.time / h)])
    if gate is not None and gate.time is not None:  # in a cone along x
        assert isinstance(gate.velocity, rho.Cone)
        tan = np.tan(gate.velocity.half_angle)
        A = np.diag([tan, 1.0, 1.0])
        prog.AddLorentzConeConstraint(A, np.zeros(3), v[round(gate.time / h)])
    prog.AddQuadraticCost(2.0 * np.eye(3 * n), np.zeros(3 * n), a.ravel(), is_convex=True)
    options = SolverOptions()
    for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        options.SetOption(ClarabelSolver.id(), name, 1e-11)
    result = ClarabelSolver().Solve(prog, None, options)
    assert result.is_success()
    return float((result.GetSolution(a) ** 2).sum())


def test_a_plan_meets_gates_dwells_and_legs_at_every_instant() -> None:
    plan = rho.plan(MISSION)
    assert rho.verify(plan).ok
    times, p, v = dense(plan)
    _, through = at(plan, 2.13)
    assert np.arccos(through[1] / np.linalg.norm(through)) <= 0.2 + 1e-4
    rest = (times >= 4.3) & (times <= 5.5)
    assert np.abs(v[rest]).max() < 1e-4
    assert np.linalg.norm(p[rest] - STOP.position, axis=1).max() < 1e-4
    assert np.allclose(at(plan, 8.0)[1], [1, 0.5, 0], atol=1e-4)
    leg = (times >= 4.3) & (times <= 8.0)
    assert np.linalg.norm(v[leg], axis=1).max() <= 2.9 + 1e-4
    assert np.linalg.norm(v, axis=1).max() <= 5.0 + 1e-4
    assert np.linalg.norm(plan.accelerations[0][:9], axis=1).max() <= 5.0 + 1e-4


def test_costs_are_those_of_a_program_of_its_own() -> None:
    gate = rho.Waypoint(2.0, [3, 1, 1], velocity=FORWARDS, name="gate")
    stop = rho.Waypoint(5.0, [6, -1, 1.5], dwell=1.0, name="stop")
    slow = rho.KeepIn(rho.Ball([0, 0, 0], 1.5), of="velocity", between=("gate", "stop"))
    for waypoints, required, rest, leg, cone in (
        ((gate, stop), [], range(20, 25), range(0), gate),
        ((gate, stop), [slow], range(20, 25), range(8, 21), gate),
        ((stop,), [], range(20, 25), range(0), None),
    ):
        scenario = scene(*waypoints, requirements=required)
        cost = rho.plan(scenario).cost
        assert cost == pytest.approx(own_cost(scenario, rest, leg, cone), rel=1e-6)


def test_a_dwell_covers_the_steps_that_it_meets() -> None:
    plan = rho.plan(MISSION)
    still = np.flatnonzero(np.abs(plan.accelerations[0]).max(axis=1) < 1e-6)
    assert {17, 18, 19, 20, 21} <= {*still.tolist()}  # 4.25 s to 5.5 s


def test_a_set_of_all_velocities_changes_nothing() -> None:
    bare = scene(dataclasses.replace(GATE, velocity=None))
    wide = scene(dataclasses.replace(GATE, velocity=rho.Ball([0, 0, 0], 100.0)))
    assert rho.plan(wide).cost == pytest.approx(rho.plan(bare).cost, rel=1e-9)


def test_mirrored_gates_have_mirrored_plans() -> None:
    flip = np.array([1, -1, 1])
    waypoints = (
        rho.Waypoint(2.13, GATE.position * flip, velocity=rho.Cone([0, 0, 0], [0, -1, 0], 0.2)),
        rho.Waypoint(4.3, STOP.position * flip, dwell=1.2),
    )
    cost = rho.plan(scene(GATE, STOP)).cost
    assert rho.plan(scene(*waypoints)).cost == pytest.approx(cost, rel=1e-6)


def test_own_sets_of_velocities(tmp_path: Path) -> None:
    class Fast:
        """Velocities of at least 2 m/s along x."""

        def signed_distance(self, x: np.ndarray) -> np.ndarray:
            return 2.0 - x[..., 0]

        def outward(self, x: np.ndarray) -> np.ndarray:
            return np.broadcast_to([-1.0, 0.0, 0.0], x.shape)

        def support(self, n: np.ndarray) -> np.ndarray:
            back = np.linalg.norm(n - [-1.0, 0.0, 0.0], axis=-1) < 1e-9
            return np.where(back, -2.0, np.inf)

    scenario = scene(rho.Waypoint(2.0, [3, 0, 1], velocity=Fast()))
    same = scene(rho.Waypoint(2.0, [3, 0, 1], velocity=rho.HalfSpace([-1, 0, 0], -2.0)))
    plan = rho.plan(scenario)
    assert at(plan, 2.0)[1][0] >= 2.0 - 1e-4
    assert plan.cost == pytest.approx(rho.plan(same).cost, rel=1e-7)
    with pytest.raises(rho.ScenarioError, match=r"vehicles\[0\].waypoints\[0\].velocity"):
        rho.save_scenario(scenario, tmp_path / "own.yaml")


def test_the_verifier_finds_what_is_violated() -> None:
    bare = scene(*(rho.Waypoint(e.time, e.position, e.within) for e in (GATE, STOP, OUT)))
    plan = rho.Plan.from_accelerations(MISSION, rho.plan(bare).accelerations)
    violated = {each.what for each in rho.verify(plan).checks if not each.holds}
    assert "velocity at waypoint 1 (gate)" in violated
    assert "dwell at waypoint 2 (stop)" in violated
    assert "velocity at waypoint 3 (out)" in violated


def test_names_of_several_vehicles() -> None:
    def of(name: str, y: float, time: float) -> rho.Vehicle:
        waypoint = rho.Waypoint(time, [5, y, 1], name=f"gate of {name}")
        ends = rho.State([0, y, 1]), rho.State([12, y, 1])
        return rho.Vehicle(name, *ends, waypoints=[waypoint, rho.Waypoint(8, [9, y, 1], name="b")])

    leg = rho.KeepIn(rho.Ball([0, 0, 0], 2.0), of="velocity", between=("gate of one", "b"))
    scenario = rho.Scenario(
        "two",
        rho.Grid.lasting(10.0, step=0.25),
        [of("one", 0, 4.0), of("two", 3, 3.0)],
        requirements=[leg],
    )
    checks = rho.verify(rho.plan(scenario)).checks
    assert {e.vehicle for e in checks if e.constraint == "requirement 1"} == {"one"}
    assert {e.vehicle for e in checks if e.constraint == "waypoint 1 (gate of two)"} == {"two"}


@pytest.mark.parametrize("free", [False, True])
def test_windows_keep_gates_dwells_and_legs(free: bool, tmp_path: Path) -> None:
    flight = rho.plan_rho(MISSION, free_final_time=free)
    assert rho.verify(flight).ok
    rho.save(flight, tmp_path / "flight.npz")
    again = rho.load(tmp_path / "flight.npz")
    assert again.scenario == MISSION
    assert rho.verify(again).ok
    for window in again.windows:
        assert rho.verify(window.plan).ok


def test_in_wind_a_set_says_what_counts_as_rest() -> None:
    wind = rho.Disturbance(acceleration=0.05)
    gate = dataclasses.replace(GATE, within=0.3)
    stop = dataclasses.replace(STOP, within=0.3)
    with pytest.raises(rho.InfeasibleError, match=r"dwell at waypoint 2 \(stop\)"):
        rho.plan(scene(gate, stop, disturbance=wind))
    stop = dataclasses.replace(stop, velocity=rho.Ball([0, 0, 0], 0.1))
    scenario = scene(gate, stop, disturbance=wind)
    simulation = rho.simulate(scenario)
    assert rho.verify(simulation).ok
    times = np.asarray(simulation.elapsed)
    rest = (times >= 4.3) & (times <= 5.5)
    assert np.linalg.norm(simulation.velocities[rest, 0], axis=1).max() <= 0.1
    away = np.linalg.norm(simulation.positions[rest, 0] - stop.position, axis=1)
    assert away.max() <= 0.3


def test_with_smoothing() -> None:
    fast = rho.Limits(max_speed=8.0, max_acceleration=12.0)
    stop = dataclasses.replace(STOP, time=4.5, dwell=1.0)
    scenario = scene(GATE, stop, limits=fast, smoothing=rho.Smoothing(0.2))
    assert rho.verify(rho.plan(scenario)).ok
    assert rho.verify(rho.plan_rho(scenario)).ok


def test_a_gate_has_its_direction_in_plans_and_in_least_time() -> None:
    gate = rho.Waypoint(None, [5, 1, 1], velocity=FORWARDS, name="gate")
    bare = scene(dataclasses.replace(gate, velocity=None))
    for planner in (rho.plan, rho.plan_minimum_time):
        plan, free = planner(scene(gate)), planner(bare)
        assert rho.verify(plan).ok
        time = plan.scenario.vehicles[0].waypoints[0].time
        assert time is not None
        v = at(plan, time)[1]
        assert np.arccos(v[0] / np.linalg.norm(v)) <= 0.2 + 1e-4
        if planner is rho.plan:
            assert plan.cost >= free.cost * (1.0 - 1e-6)
        else:
            assert plan.scenario.grid.duration >= free.scenario.grid.duration * (1.0 - 1e-4)


def test_a_gate_across_is_passed_as_fast_as_by_given_times() -> None:
    gate = rho.Waypoint(None, [6, 1, 1], velocity=rho.Cone([0, 0, 0], [0, 1, 0], 0.3))
    found = rho.plan(scene(gate)).cost
    times = np.linspace(3.0, 7.0, 33)
    costs = [rho.plan(scene(dataclasses.replace(gate, time=t))).cost for t in times]
    assert found <= min(costs) * (1.0 + 1e-3)


def test_a_slow_leg_takes_its_time() -> None:
    """At 1 m/s for 4 m, a leg takes 4 s; the rest is at most as fast as without."""
    one, two = (
        rho.Waypoint(None, [4, 0, 1], name="one"),
        rho.Waypoint(None, [8, 0, 1], name="two"),
    )
    slow = rho.KeepIn(rho.Ball([0, 0, 0], 1.0), of="velocity", between=("one", "two"))
    plan = rho.plan_minimum_time(scene(one, two, requirements=[slow]))
    first, last = (each.time for each in plan.scenario.vehicles[0].waypoints)
    assert rho.verify(plan).ok
    assert first is not None
    assert last is not None
    assert last - first >= 4.0 - 1e-4
    # 4 m from rest at 6 m/s² to 1 m/s: at full thrust to u, then down to 1 m/s
    u = np.sqrt(6.0 * 4.0 + 0.5)
    ends = 2.0 * (u / 6.0 + (u - 1.0) / 6.0)
    assert plan.scenario.grid.duration == pytest.approx(4.0 + ends, rel=0.05)


def _least(legs: list[float], dwells: list[float], steps: int, most: float) -> float:
    """Return the least time of legs from rest to rest with dwells between, in whole steps [s].

    The farthest of n steps with accelerations up to a is a h² floor(n² / 4).
    """

    def needed(step: float) -> int:
        flown = 0
        for leg in legs:
            n = 2
            while most * step**2 * (n**2 // 4) < leg * (1.0 - 1e-12):
                n += 1
            flown += n
        return flown + sum(int(np.ceil(each / step - 1e-9)) for each in dwells)

    low, high = 1e-3, 1e3
    for _ in range(100):
        middle = (low + high) / 2.0
        low, high = (low, middle) if needed(middle) <= steps else (middle, high)
    return steps * high


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(each, marks=pytest.mark.slow) for each in range(2, 12))]
)
def test_stops_in_least_time_are_those_of_a_closed_form(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count, knots, most = int(rng.integers(1, 3)), int(rng.integers(20, 60)), rng.uniform(2.0, 9.0)
    places = np.cumsum(rng.uniform(-4.0, 4.0, (count + 2, 3)), axis=0)
    dwells = rng.uniform(0.1, 2.5, count).tolist()
    stops = [rho.Waypoint(None, p, dwell=d) for p, d in zip(places[1:-1], dwells, strict=True)]
    vehicle = rho.Vehicle("v", rho.State(places[0]), rho.State(places[-1]), waypoints=stops)
    limits = rho.Limits(max_acceleration=most)
    scenario = rho.Scenario("stops", rho.Grid(rng.uniform(0.05, 0.5), knots), [vehicle], limits)
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    legs = np.linalg.norm(np.diff(places, axis=0), axis=1).tolist()
    least = _least(legs, dwells, knots - 1, most)
    assert plan.scenario.grid.duration == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize("windows", [False, True])
def test_a_stop_is_at_the_steps_of_least_cost(windows: bool) -> None:
    def costs(time: float | None) -> float:
        stop = rho.Waypoint(time, [7, 2, 1.5], dwell=1.1, name="stop")
        return float(planner(scene(GATE, stop)).cost)

    planner: Any = rho.plan_rho if windows else rho.plan
    known = dict[float, float]()
    for time in 0.25 * np.arange(9, 30):
        with contextlib.suppress(rho.InfeasibleError):
            known[float(time)] = costs(float(time))
    assert costs(None) == pytest.approx(min(known.values()), rel=1e-6)


def test_dwells_as_long_as_the_flight_are_named() -> None:
    stop = rho.Waypoint(None, [6, 0, 1], dwell=10.0)
    with pytest.raises(rho.InfeasibleError, match="these take 10 s of the flight's 10 s") as error:
        rho.plan(scene(stop))
    assert error.value.conflicts == {"scout": ("dwells at its waypoints",)}
    assert rho.verify(rho.plan_minimum_time(scene(stop))).ok


def test_a_dwell_that_begins_with_a_window_is_kept() -> None:
    """Rounding puts its time after the window's start by one unit in the last place."""
    step = 0.12897515641043925
    stop = rho.Waypoint(25 * step, [1, 1, 1], dwell=0.72)
    ends = rho.State([0, 0, 1]), rho.State([2, 1, 1])
    vehicle = rho.Vehicle("v", *ends, waypoints=[stop])
    scenario = rho.Scenario("begun", rho.Grid(step, 51), [vehicle])
    flight = rho.plan_rho(scenario, replan_every=5)
    assert len(flight.windows[5].plan.scenario.vehicles[0].waypoints) == 1


REFUSED: dict[str, tuple[Any, str]] = {
    "a dwell at a moving waypoint": (
        lambda: rho.Waypoint(1.0, [0, 0, 0], dwell=1.0, velocity=[1, 0, 0]),
        "waypoint.dwell",
    ),
    "a dwell at a gate that excludes rest": (
        lambda: rho.Waypoint(1.0, [0, 0, 0], dwell=1.0, velocity=rho.Ball([2, 0, 0], 1.0)),
        "waypoint.dwell",
    ),
    "a negative dwell": (lambda: rho.Waypoint(1.0, [0, 0, 0], dwell=-1.0), "waypoint.dwell"),
    "an infinite dwell": (lambda: rho.Waypoint(1.0, [0, 0, 0], dwell=np.inf), "waypoint.dwell"),
    "two numbers": (lambda: rho.Waypoint(1.0, [0, 0, 0], velocity=[1, 0]), "waypoint.velocity"),
    "a word": (lambda: rho.Waypoint(1.0, [0, 0, 0], velocity="fast"), "waypoint.velocity"),
    "an end as a name": (lambda: rho.Waypoint(1.0, [0, 0, 0], name="start"), "waypoint.name"),
    "a name twice": (
        lambda: scene(GATE, dataclasses.replace(STOP, name="gate")),
        "waypoints[1].name",
    ),
    "too fast a value": (
        lambda: scene(dataclasses.replace(GATE, velocity=[0, 6, 0])),
        "vehicles[0].waypoints[0].velocity",
    ),
    "too fast a set": (
        lambda: scene(dataclasses.replace(GATE, velocity=rho.HalfSpace([-1, 0, 0], -6.0))),
        "vehicles[0].waypoints[0].velocity",
    ),
    "a set outside of the box": (
        lambda: scene(
            dataclasses.replace(GATE, velocity=rho.Ball([0, 3, 0], 0.5)),
            limits=rho.Limits(velocity=rho.Box([-2, -2, -2], [2, 2, 2])),
        ),
        "vehicles[0].waypoints[0].velocity",
    ),
    "a dwell past the end": (
        lambda: scene(dataclasses.replace(STOP, dwell=8.0)),
        "vehicles[0].waypoints[0].dwell",
    ),
    "a dwell past the next waypoint": (
        lambda: scene(STOP, dataclasses.replace(OUT, time=5.2)),
        "vehicles[0].waypoints[0].dwell",
    ),
    "an unknown name": (
        lambda: scene(GATE, STOP, OUT, requirements=[_between("gate", "stpo")]),
        "requirements[0].between",
    ),
    "names out of order": (
        lambda: scene(GATE, STOP, OUT, requirements=[_between("out", "gate")]),
        "requirements[0].between",
    ),
    "names of no one vehicle": (
        lambda: scene(GATE, STOP, requirements=[_between("gate", "out")]),
        "requirements[0].between",
    ),
    "one name": (lambda: _between("gate", "gate"), "keepin.between"),
    "beside active": (lambda: dataclasses.replace(SLOW, active=(1.0, 2.0)), "keepin.between"),
}


def _between(first: str, last: str) -> rho.KeepIn:
    return rho.KeepIn(rho.Ball([0, 0, 0], 2.0), of="velocity", between=(first, last))


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_one_error_with_the_field(case: str) -> None:
    make, field = REFUSED[case]
    with pytest.raises(rho.ScenarioError) as refused:
        make()
    assert refused.value.field.endswith(field)


def test_files(tmp_path: Path) -> None:
    rho.save_scenario(MISSION, tmp_path / "mission.yaml")
    assert rho.load_scenario(tmp_path / "mission.yaml") == MISSION


def test_the_program_of_a_scenario_has_gates_and_legs() -> None:
    scenario = scene(
        rho.Waypoint(2.0, [3, 1, 1], velocity=FORWARDS, name="gate"),
        rho.Waypoint(5.0, [6, -1, 1.5], dwell=1.0, name="stop"),
        requirements=[_between("gate", "stop")],
        between_knots=False,
    )
    program = rho.program(scenario)
    assert "velocity at waypoint 1 (gate)" in program.bindings
    assert "dwell at waypoint 2 (stop)" in program.bindings
    plan = program.plan(ClarabelSolver().Solve(program.prog))
    assert plan.cost == pytest.approx(rho.plan_convex(scenario).cost, rel=1e-6)


def test_what_cannot_be_met_is_named() -> None:
    late = dataclasses.replace(OUT, time=5.8)
    with pytest.raises(rho.InfeasibleError, match=r"waypoint 3 \(out\)"):
        rho.plan(scene(GATE, STOP, late))


@pytest.mark.slow
def test_gates_that_no_fast_motion_passes_are_passed_more_slowly() -> None:
    """The second is flown backwards; with given times there is a motion that is slow enough."""
    speeds = [2.433462914527276, 2.847485795663662]
    along = [[0.82036684, 0.11156233, 0.56084944], [-0.555013, 0.77061072, 0.31324063]]
    places = [[4.0, 1.75181513, -0.57451317], [8.0, -1.63817843, -0.14738253]]
    gates = [
        rho.Waypoint(None, place, velocity=rho.HalfSpace([-x for x in way], -speed))
        for place, way, speed in zip(places, along, speeds, strict=True)
    ]
    ends = rho.State([0, 0, 0]), rho.State([12, 0, 0])
    racer = rho.Vehicle("racer", *ends, waypoints=gates)
    limits = rho.Limits(max_speed=6.0, max_acceleration=8.0)
    scenario = rho.Scenario("backwards", rho.Grid(0.1, 41), [racer], limits)
    plan = rho.plan_minimum_time(scenario)
    assert rho.verify(plan).ok
    assert plan.scenario.grid.duration < 4.48  # of IPOPT on the same grid, from the fast motion
    for gate, way, speed in zip(plan.scenario.vehicles[0].waypoints, along, speeds, strict=True):
        assert gate.time is not None
        velocity = plan.at([gate.time]).velocities[0, 0]
        assert velocity @ np.array(way) > speed - 1e-5
