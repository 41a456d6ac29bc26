"""Vehicles that plan for themselves: what they commit to is separated, whatever happens in between.

Distances are of samples of the committed accelerations, integrated here.
"""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import struct
import subprocess
import sys
import textwrap
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho

EXAMPLES = Path(__file__).parent.parent / "docs" / "examples"
SEPARATION = 0.5
LIMITS = rho.Limits(max_speed=6.0, max_acceleration=8.0)
DELAY = 0.1
Array = np.ndarray[Any, Any]


def fleet(starts: Sequence[Sequence[float]], **changes: Any) -> rho.Scenario:
    """Return vehicles that fly to the opposite side of the origin, 1 m above the ground."""
    vehicles = [
        rho.Vehicle(
            f"q{i}", rho.State([*each, 1.0]), rho.State([-each[0], -each[1], 1.0]), radius=0.1
        )
        for i, each in enumerate(starts)
    ]
    given: dict[str, Any] = {"limits": LIMITS, "separation": rho.Separation(SEPARATION)}
    return rho.Scenario("fleet", rho.Grid(0.15, 21), vehicles, **(given | changes))


def swap(half: float = 4.0, **changes: Any) -> rho.Scenario:
    """Return two vehicles that swap places, head-on."""
    return fleet([[-half, 0.0], [half, 0.0]], **changes)


def circle(count: int) -> rho.Scenario:
    angles = 2.0 * np.pi * np.arange(count) / count
    return fleet([[4.0 * np.cos(each), 4.0 * np.sin(each)] for each in angles])


def pair(scenario: rho.Scenario | None = None, **settings: Any) -> list[rho.OnboardPlanner]:
    return [rho.OnboardPlanner(scenario or swap(), name, **settings) for name in ("q0", "q1")]


def positions(plan: rho.Plan, times: Array) -> Array:
    """Return positions at times since the start, at rest after the end, shape (N, T, 3)."""
    h, a, start = plan.scenario.grid.step, plan.accelerations, plan.scenario.fleet.start_states
    found = np.empty((len(a), len(times), 3))
    for i, own in enumerate(a):
        v = start[i, 3:] + h * np.concatenate([np.zeros((1, 3)), np.cumsum(own, axis=0)])
        p = start[i, :3] + np.concatenate(
            [np.zeros((1, 3)), np.cumsum(h * v[:-1] + h**2 / 2 * own, axis=0)]
        )
        k = np.minimum((times / h).astype(int), len(own))
        s = np.where(k < len(own), times - h * k, 0.0)[:, None]
        found[i] = p[k] + s * v[k] + s**2 / 2 * np.append(own, np.zeros((1, 3)), axis=0)[k]
    return found


def least_distance(x: Array) -> float:
    """Return the least distance of two vehicles, positions (N, T, 3)."""
    return min(
        float(np.linalg.norm(x[i] - x[j], axis=1).min()) for i in range(len(x)) for j in range(i)
    )


def apart(flown: rho.OnboardFlight) -> float:
    """Return the least distance of two vehicles of a flight, at 1 kHz."""
    return least_distance(
        positions(flown.plan, np.arange(0.0, flown.plan.scenario.grid.duration, 1e-3))
    )


def distance_of(planners: Sequence[rho.OnboardPlanner], offsets: Sequence[float] = (0, 0)) -> float:
    """Return the least distance of what planners committed to, with clocks ahead by offsets."""
    every = [each.flight for each in planners]
    times = np.arange(max(offsets), max(each.times[-1] for each in every), 1e-3)
    x = [positions(each, times + ahead)[0] for each, ahead in zip(every, offsets, strict=True)]
    return least_distance(np.array(x))


def fly(
    planners: Sequence[rho.OnboardPlanner],
    seconds: float,
    delay: float,
    offsets: Sequence[float] = (0.0, 0.0),
) -> None:
    """Run the loops of planners, whose messages all take the same time."""
    air, turns = list[tuple[float, int, bytes]](), np.arange(0.0, seconds, 0.02)
    for now in turns.tolist():
        for arrival, receiver, data in [each for each in air if each[0] <= now]:
            air.remove((arrival, receiver, data))
            planners[receiver].hear(data, now + offsets[receiver])
        for i, planner in enumerate(planners):
            if (sent := planner.step(now + offsets[i])) is not None:
                air += [(now + delay, other, sent) for other in range(len(planners)) if other != i]


def message(planner: rho.OnboardPlanner, begin: float = 0.0) -> tuple[bytes, float]:
    """Return a message with an announced plan, and its time."""
    planner.step(begin)
    sent = planner.step(begin + 0.01)
    assert sent is not None
    assert planner.counts.announced == 1
    return sent, begin + 0.01


def with_checksum(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


@pytest.mark.parametrize("delay", [0.0, DELAY])
def test_two_vehicles_swap(delay: float) -> None:
    rng = np.random.default_rng(1)
    flown = rho.simulate_onboard(swap(), rho.Radio(delay=delay), duration=20.0, rng=rng)
    assert np.isfinite(flown.arrivals).all()
    assert apart(flown) >= SEPARATION * (1 - 1e-6)
    assert rho.verify(flown.plan).ok


@pytest.mark.parametrize("seed", range(3))
def test_vehicles_on_a_circle_stay_separated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radio = rho.Radio(delay=DELAY, loss=0.3, lost=1)
    flown = rho.simulate_onboard(circle(6), radio, duration=3.0, rng=rng, latency=0.1)
    assert apart(flown) >= SEPARATION * (1 - 1e-6)
    assert sum(each.committed for each in flown.counts) >= 6


def test_equal_generators_give_equal_flights() -> None:
    radio = rho.Radio(delay=DELAY, loss=0.3, lost=1)
    one, other = (
        rho.simulate_onboard(swap(), radio, duration=2.0, rng=np.random.default_rng(7))
        for _ in range(2)
    )
    assert np.array_equal(one.plan.accelerations, other.plan.accelerations)
    assert one.counts == other.counts


def test_of_two_announcements_that_conflict_the_earlier_wins() -> None:
    """The later one is withdrawn, and never flown."""
    one, other = pair(delay=DELAY)
    (first, begin), (second, later) = message(one), message(other, 0.005)
    one.hear(second, later + DELAY)
    other.hear(first, begin + DELAY)
    assert one.step(begin + one.check) is not None
    assert other.step(later + other.check) is not None
    assert (one.counts.committed, other.counts.withdrawn) == (1, 1)
    assert one.flight.positions[0, -1, 0] > 0.0
    np.testing.assert_array_equal(other.flight.accelerations, 0.0)
    np.testing.assert_array_equal(other.at(2.0).positions, [[4.0, 0.0, 1.0]])


def test_of_announcements_at_one_time_the_first_name_wins() -> None:
    one, other = pair(delay=DELAY)
    (first, begin), (second, _) = message(one), message(other)
    one.hear(second, begin + DELAY)
    other.hear(first, begin + DELAY)
    one.step(begin + one.check)
    other.step(begin + other.check)
    assert (one.counts.committed, other.counts.withdrawn) == (1, 1)


def test_an_announced_plan_is_not_flown_before_its_check_ends() -> None:
    one, _ = pair(delay=DELAY)
    _, begin = message(one)
    one.step(begin + one.check - 1e-6)
    assert one.counts.committed == 0
    np.testing.assert_array_equal(one.flight.accelerations, 0.0)
    one.step(begin + one.check)
    assert one.counts.committed == 1


def test_a_plan_whose_time_is_over_is_withdrawn() -> None:
    one, _ = pair(delay=DELAY)
    message(one)
    one.step(1.0)
    assert (one.counts.committed, one.counts.withdrawn) == (0, 1)


def test_delays_longer_than_declared_let_plans_conflict() -> None:
    """So the premise is needed: both commit before they hear each other."""
    planners = pair(delay=DELAY)
    fly(planners, 1.0, delay=2.0)
    assert all(each.counts.committed > 0 for each in planners)
    assert distance_of(planners) < SEPARATION / 2


def test_clocks_may_differ_as_declared() -> None:
    offsets = 0.0, 0.08
    planners = pair(delay=DELAY, clock_error=0.08)
    fly(planners, 8.0, DELAY, offsets)
    assert distance_of(planners, offsets) >= SEPARATION * (1 - 1e-6)
    assert all(each.has_arrived for each in planners)


@pytest.mark.parametrize("start", [-30.0, 1.7e9])
def test_clocks_far_from_0_make_no_difference(start: float) -> None:
    scenario = swap()
    later = dataclasses.replace(scenario, grid=dataclasses.replace(scenario.grid, start=start))
    usual, other = (
        rho.simulate_onboard(
            each, rho.Radio(delay=DELAY), duration=20.0, rng=np.random.default_rng(2)
        )
        for each in (scenario, later)
    )
    assert other.arrivals - start == pytest.approx(usual.arrivals, abs=0.3)
    assert apart(other) >= SEPARATION * (1 - 1e-6)


def test_a_vehicle_arrives_in_a_goal_that_is_a_set() -> None:
    goals = [rho.Goal(rho.Sphere([4, 0, 1], 0.5)), rho.State([-4, 0, 1])]
    vehicles = [
        dataclasses.replace(each, goal=goal)
        for each, goal in zip(swap().vehicles, goals, strict=True)
    ]
    scenario = dataclasses.replace(swap(), vehicles=tuple(vehicles))
    flown = rho.simulate_onboard(scenario, duration=20.0, rng=np.random.default_rng(3))
    assert np.isfinite(flown.arrivals).all()
    assert np.linalg.norm(flown.plan.positions[0, -1] - [4, 0, 1]) <= 0.5 + 1e-6
    assert rho.verify(flown.plan).ok


def test_in_wind_a_vehicle_passes_another_that_stays_in_its_way() -> None:
    wind = rho.Disturbance(0.1, position_error=0.01, velocity_error=0.01)
    limits = rho.Limits(max_speed=2.5, max_acceleration=5.0)
    scenario = fleet([[-2.45, 0.0], [-0.18, 0.38]], limits=limits, disturbance=wind)
    scenario = dataclasses.replace(scenario, separation=rho.Separation(0.7))
    vehicles = (scenario.vehicles[0], dataclasses.replace(scenario.vehicles[1], goal=None))
    scenario = dataclasses.replace(scenario, vehicles=vehicles)
    flown = rho.simulate_onboard(scenario, duration=10.0, rng=np.random.default_rng(4))
    assert np.isfinite(flown.arrivals[0])
    assert apart(flown) >= 0.7


def test_losses_in_a_row_as_declared_are_safe() -> None:
    radio = rho.Radio(delay=0.05, loss=0.7, lost=2)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        flown = rho.simulate_onboard(swap(), radio, duration=6.0, rng=rng)
        assert apart(flown) >= SEPARATION * (1 - 1e-6)


def test_vehicles_keep_their_tubes_apart() -> None:
    scenario = swap(disturbance=rho.Disturbance(acceleration=0.3))
    rng = np.random.default_rng(0)
    flown = rho.simulate_onboard(scenario, rho.Radio(delay=0.05), duration=8.0, rng=rng)
    assert np.isfinite(flown.arrivals).all()
    radius = float(rho.error_tube(scenario).position(np.linspace(0.0, 3.0, 50)).max())
    assert radius > 0.001
    assert apart(flown) >= SEPARATION + 2.0 * radius - 1e-6


SLOW = rho.Limits(max_speed=1.0, max_acceleration=2.0)
"""Limits for which the least radius of communication is short."""


def test_vehicles_beyond_the_radius_need_not_be_heard() -> None:
    scenario = swap(8.0, limits=SLOW)
    settings: dict[str, Any] = {"replan_every": 0.5, "horizon": 2.1}
    least = rho.OnboardPlanner(scenario, "q0", delay=DELAY, **settings).least_radius
    assert 3.0 * 2.1 < least < 12.0
    with pytest.raises(ValueError, match="radius: got"):
        rho.OnboardPlanner(scenario, "q0", delay=DELAY, radius=0.9 * least, **settings)
    for radius, safe in ((least, True), (0.5, False)):
        settings["radius"] = radius if safe else None
        rng, radio = np.random.default_rng(2), rho.Radio(delay=DELAY, radius=radius)
        flown = rho.simulate_onboard(scenario, radio, duration=16.0, rng=rng, **settings)
        assert (apart(flown) >= SEPARATION * (1 - 1e-6)) == safe
        assert sum(each.committed for each in flown.counts) >= 10


def test_messages_may_be_heard_twice_and_in_any_order() -> None:
    one, other = pair(delay=DELAY)
    first, begin = message(one)
    second = one.step(begin + one.check)
    assert second is not None
    for data in (second, first, second, second):
        other.hear(data, begin + one.check + DELAY)
    third, fourth = pair(delay=DELAY)
    message(third)
    fourth.hear(second, begin + one.check + DELAY)
    for each in (other, fourth):
        each.step(0.5)
    assert other.step(0.51) == fourth.step(0.51)


def other_than(scenario: rho.Scenario, begin: float = 0.0, name: str = "q1") -> bytes:
    return message(rho.OnboardPlanner(scenario, name), begin)[0]


def test_messages_that_do_not_hold_are_refused() -> None:
    good = other_than(swap())
    body, last = good[:-4], struct.pack("<d", np.nan)
    fast = swap(9.0, limits=rho.Limits(max_speed=20.0, max_acceleration=20.0))
    low = dataclasses.replace(LIMITS, position=rho.Box([-9, -9, 2], [9, 9, 4]))
    foreign = dataclasses.replace(swap().vehicles[1], name="z")
    strangers = dataclasses.replace(swap(), vehicles=(swap().vehicles[0], foreign))
    refused = {
        "bytes": b"",
        "at first": b"RHO" + good[3:],
        "checksum": good[:40] + b"x" + good[41:],
        "lengths": with_checksum(body[:-8]),
        "finite": with_checksum(body[:-8] + last),
        "rest at its end": with_checksum(body[:-24] + struct.pack("<3d", 1.0, 0.0, 0.0)),
        "future": other_than(swap(), begin=4.0),
        "own name": other_than(swap(), name="q0"),
        "not in the scenario": other_than(strangers, name="z"),
        "violates": other_than(fast),
        "expected bytes": "text",
    }
    for reason, data in refused.items():
        planner = rho.OnboardPlanner(swap(), "q0", delay=DELAY)
        with pytest.raises(rho.MessageError, match=reason) as error:
            planner.hear(data, 0.05)  # type: ignore[arg-type]
        named = reason in ("rest at its end", "future", "violates")
        assert error.value.sender == ("q1" if named else error.value.sender)
    up = np.array([0.0, 0.0, 2.0])
    above = tuple(
        dataclasses.replace(
            each, start=rho.State(each.start.position + up), goal=rho.State(each.goal.position + up)
        )
        for each in swap().vehicles
    )
    boxed = dataclasses.replace(swap(), vehicles=above, limits=low)
    with pytest.raises(rho.MessageError, match="violates"):
        rho.OnboardPlanner(boxed, "q0").hear(good, 0.05)


def test_damaged_messages_are_refused_or_harmless() -> None:
    rng, good = np.random.default_rng(3), other_than(swap())
    planner = rho.OnboardPlanner(swap(), "q0", delay=DELAY)
    message(planner)
    planner.step(0.01 + planner.check)
    before, refused = planner.flight.accelerations, 0
    for index in range(400):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        if rng.uniform() < 0.2:
            data = data[: rng.integers(len(data))]
        sent = bytes(data) if index % 2 else with_checksum(bytes(data[:-4]))
        try:
            planner.hear(sent, 0.2)
        except rho.MessageError:
            refused += 1
        np.testing.assert_array_equal(planner.flight.accelerations, before)
    assert refused >= 200
    planner.hear(good, 0.2)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"separation": None}, "separation"),
        (
            {
                "requirements": [
                    rho.KeepIn(rho.Sphere([0, 0, 0], 30.0), vehicles="q0", relative_to="q1")
                ]
            },
            "requirements[0].relative_to",
        ),
        ({"vehicles": None}, "vehicles[0].start.velocity"),
    ],
)
def test_scenarios_that_vehicles_cannot_plan_for_alone_are_refused(
    change: dict[str, Any], field: str
) -> None:
    if "vehicles" in change:
        first, second = swap().vehicles
        moving = rho.State(first.start.position, [0.1, 0.0, 0.0])
        change = {"vehicles": [dataclasses.replace(first, start=moving), second]}
    with pytest.raises(rho.ScenarioError) as error:
        rho.OnboardPlanner(dataclasses.replace(swap(), **change), "q0")
    assert error.value.field == field


@pytest.mark.parametrize(
    "setting", [{"period": 0.0}, {"delay": -1.0}, {"latency": np.nan}, {"radius": 1.0}]
)
def test_impossible_settings_are_refused(setting: dict[str, Any]) -> None:
    (name,) = setting
    with pytest.raises(ValueError, match=f"{name}: got"):
        rho.OnboardPlanner(swap(), "q0", **setting)
    with pytest.raises(ValueError, match="vehicle: got 'q9'"):
        rho.OnboardPlanner(swap(), "q9")
    with pytest.raises(ValueError, match="loss: got 2"):
        rho.Radio(loss=2.0)


def test_goals_and_obstacles_may_change() -> None:
    planner = rho.OnboardPlanner(swap(), "q0")
    own = dataclasses.replace(swap().vehicles[0], goal=rho.State([0, 6, 1]))
    wall = rho.Box([-3.0, 2.0, 0.0], [-2.0, 3.0, 3.0])
    vehicles = own, swap().vehicles[1]
    news = dataclasses.replace(swap(), vehicles=vehicles, obstacles=(wall,))
    planner.step(0.0)
    planner.tell(news)
    for now in np.arange(0.02, 6.0, 0.02):
        planner.step(float(now))
    assert planner.has_arrived
    x = positions(planner.flight, np.arange(0.0, planner.flight.times[-1], 1e-3))[0]
    np.testing.assert_allclose(x[-1], [0, 6, 1], atol=1e-5)
    assert wall.signed_distance(x).min() >= 0.1 - 1e-6


def test_the_past_is_not_flown() -> None:
    planner = rho.OnboardPlanner(swap(), "q0")
    fly([planner], 2.0, 0.0)
    with pytest.raises(ValueError, match="times: got 0"):
        planner.at(0.0)
    state = planner.at([2.0])
    there = positions(planner.flight, np.array([2.0]))[0]
    np.testing.assert_allclose(state.positions, there, atol=1e-9)


def _free_ports(count: int) -> list[int]:
    with contextlib.ExitStack() as open_ones:
        every = [
            open_ones.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            for _ in range(count)
        ]
        for each in every:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in every]


@pytest.mark.slow
def test_two_processes_share_plans_over_udp(tmp_path: Path) -> None:
    script, begin = EXAMPLES / "onboard_udp.py", time.time() + 3.0
    ports, names = _free_ports(2), ("q0", "q1")
    processes = []
    for name, own, other in zip(names, ports, ports[::-1], strict=True):
        words = [name, str(own), str(other), str(begin), str(tmp_path / f"{name}.npz")]
        processes.append(subprocess.Popen([sys.executable, str(script), *words]))
    try:
        assert [each.wait(timeout=60.0) for each in processes] == [0, 0]
    finally:
        for each in processes:
            each.kill()
    plans = [rho.load(tmp_path / f"{name}.npz").plan for name in names]
    times = np.arange(0.0, max(each.times[-1] for each in plans), 1e-3)
    x = np.array([positions(each, times)[0] for each in plans])
    assert least_distance(x) >= 0.5 * (1 - 1e-6)
    assert np.linalg.norm(np.diff(x, axis=1), axis=2).sum(axis=1).min() > 1.0


def test_the_guide_shows_the_loop_of_the_example() -> None:
    text = (EXAMPLES.parent / "guides" / "onboard.md").read_text()
    (loop,) = (each for each in text.split("```\n") if each.startswith("while "))
    assert textwrap.indent(loop, 8 * " ") in (EXAMPLES / "onboard_udp.py").read_text()


def test_what_is_seen_in_flight_is_avoided() -> None:
    wall = rho.Box([-0.3, -1.5, 0.0], [0.3, 1.5, 3.0])
    scenario, told = swap(limits=dataclasses.replace(LIMITS, max_speed=3.0)), set[str]()
    aware = dataclasses.replace(scenario, obstacles=(rho.Obstacle(wall, name="wall"),))

    def sees(name: str, time: float, place: Array) -> rho.Scenario | None:
        assert 0.0 <= time <= 20.0
        if name in told or np.abs(place[0]) > 3.2:
            return None
        told.add(name)
        return aware

    flown = rho.simulate_onboard(
        scenario, duration=20.0, rng=np.random.default_rng(5), sees=sees, solver="daqp"
    )
    assert told == {"q0", "q1"}
    assert np.isfinite(flown.arrivals).all()
    x = positions(flown.plan, np.linspace(0.0, 20.0, 20_001))
    clear = np.linalg.norm(np.maximum(np.abs(x - wall.center) - [0.3, 1.5, 1.5], 0.0), axis=2)
    assert clear.min() >= 0.1 - 1e-6
    assert np.linalg.norm(x[0] - x[1], axis=1).min() >= SEPARATION - 1e-6
    without = rho.simulate_onboard(
        scenario, duration=20.0, rng=np.random.default_rng(5), solver="daqp"
    )
    x = positions(without.plan, np.linspace(0.0, 20.0, 2_001))
    assert (np.abs(x - wall.center) < [0.3, 1.5, 1.5]).all(axis=2).any()  # the wall has an effect


def test_what_is_seen_on_the_last_way_to_the_goal_counts() -> None:
    ball, told = rho.Sphere([3.0, 0.0, 1.0], 0.5), set[str]()
    scenario = fleet([[-4.0, 0.0], [-4.0, 6.0]])
    aware = dataclasses.replace(scenario, obstacles=(rho.Obstacle(ball, name="ball"),))

    def sees(name: str, time: float, place: Array) -> rho.Scenario | None:
        if name in told or np.linalg.norm(place - ball.center) > 4.0:
            return None
        told.add(name)
        return aware

    flown = rho.simulate_onboard(scenario, duration=20.0, rng=np.random.default_rng(6), sees=sees)
    assert "q0" in told
    assert np.isfinite(flown.arrivals).all()
    x = positions(flown.plan, np.linspace(0.0, 20.0, 20_001))
    assert np.linalg.norm(x[0] - ball.center, axis=1).min() >= 0.5 + 0.1 - 1e-6
