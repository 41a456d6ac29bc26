"""Recipes for other programs send the plan: docs/guides/recipes.md run with stand-ins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.clients import BEGIN, STORE, Sent, stand_in
from tests.guides import follow

PAGE = Path(__file__).parent.parent / "docs" / "guides" / "recipes.md"
CLOCK = 1e-6
"""Places that a clock in double precision tells apart at some m/s [m]."""


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[rho.Plan, Sent, rho.Trajectories]:
    """Return the plan of the page, what the recipes sent, and the polynomials that they read."""
    folder = tmp_path_factory.mktemp("recipes")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        sent = stand_in(patch)
        follow(PAGE, {})
    plan = rho.load(folder / "plan.npz")
    assert isinstance(plan, rho.Plan)
    return plan, sent, rho.load_trajectories(folder / "swarm")


def test_messages_of_ros_have_the_states_of_the_plan_at_their_stamps(
    flown: tuple[rho.Plan, Sent, rho.Trajectories],
) -> None:
    plan, sent, _ = flown
    assert len(sent.ros) > 500
    for topic, message in sent.ros:
        assert topic == "courier/command/trajectory"
        data = STORE.serialize_cdr(message, "trajectory_msgs/msg/MultiDOFJointTrajectory")
        read: Any = STORE.deserialize_cdr(data, "trajectory_msgs/msg/MultiDOFJointTrajectory")
        assert read.joint_names == ["courier"]
        assert read.header.frame_id == "map"
        stamp = read.header.stamp
        since = (stamp.sec * 10**9 + stamp.nanosec - BEGIN) / 1e9
        state = plan.at(min(plan.times[0] + since, plan.times[-1]), vehicle="courier")
        (point,) = read.points
        (place,), (speed,), (change,) = point.transforms, point.velocities, point.accelerations
        turn = place.rotation
        assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)
        for vector, row in (
            (place.translation, state.positions),
            (speed.linear, state.velocities),
            (change.linear, state.accelerations),
        ):
            np.testing.assert_allclose([vector.x, vector.y, vector.z], row[0], atol=1e-12)
    assert since > plan.times[-1] - plan.times[0]  # the last ones hold the goal


def test_a_crazyflie_gets_the_plan_and_begins_at_its_start(
    flown: tuple[rho.Plan, Sent, rho.Trajectories],
) -> None:
    plan, sent, read = flown
    assert [name for name, _ in sent.swarm] == [
        *("upload", "takeoff", "sleep", "goTo", "sleep", "start")
    ]
    calls = dict(sent.swarm)
    number, offset, uploaded = calls["upload"][0]
    assert (number, offset) == (0, 0)
    start, yaw, _ = calls["goTo"][0]
    np.testing.assert_allclose(start, plan.positions[0, 0], atol=1e-9)
    assert yaw == 0
    assert calls["start"] == ((0,), {"relative": False})
    for time in np.linspace(0.0, uploaded.duration, 301):
        now = uploaded.eval(time)
        assert np.linalg.norm(now.pos - plan.at(time, vehicle="courier").positions[0]) < 1e-4
        np.testing.assert_allclose(now.pos, read.at(time).positions[0, 0], atol=1e-9)
        assert now.yaw == 0.0


def test_setpoints_of_px4_are_those_of_the_plan_in_north_east_down(
    flown: tuple[rho.Plan, Sent, rho.Trajectories],
) -> None:
    plan, sent, _ = flown
    words = [call for _, call in sent.px4 if isinstance(call, str)]
    assert words == ["connect", "start", "hold"]
    setpoints = [(time, call) for time, call in sent.px4 if len(call) == 3]
    assert [call for _, call in sent.px4].index("start") == 2  # after connecting and a setpoint
    begin = setpoints[0][0]
    times = np.array([time - begin for time, _ in setpoints]) / 1e9
    assert np.diff(times).max() < 0.5  # PX4 leaves the mode below 2 Hz
    for time, (place, speed, change) in zip(times, [call for _, call in setpoints], strict=True):
        state = plan.at(min(plan.times[0] + time, plan.times[-1]), vehicle="courier")
        (east, north, up), velocity = state.positions[0], state.velocities[0]
        assert place.north_m == pytest.approx(north, abs=CLOCK)
        assert place.east_m == pytest.approx(east, abs=CLOCK)
        assert place.down_m == pytest.approx(-up, abs=CLOCK)
        assert [speed.north_m_s, speed.east_m_s, -speed.down_m_s] == pytest.approx(
            velocity[[1, 0, 2]], abs=CLOCK
        )
        at_knot = np.abs(plan.times - plan.times[0] - time).min() < CLOCK
        if not at_knot:  # where accelerations jump
            assert [change.north_m_s2, change.east_m_s2, -change.down_m_s2] == pytest.approx(
                state.accelerations[0][[1, 0, 2]], abs=CLOCK
            )
        assert place.yaw_deg == speed.yaw_deg == 90.0
    np.testing.assert_allclose(
        [place.east_m, place.north_m, -place.down_m], plan.positions[0, -1], atol=CLOCK
    )
