"""Bags of ROS 2, read back by rosbags and by mcap."""

from __future__ import annotations

import importlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

import drake_rho as rho
from tests.disturbed import disturbed, winds_for
from tests.scenarios import single, straight
from tests.test_export import rough
from tests.test_headings_flown import turning

PLACES = 1e-9
"""Rounding of positions [m]."""
STORE = get_typestore(Stores.ROS2_JAZZY)


def _messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Return the stamps and messages of each topic, by rosbags."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with Reader(path) as bag:
        for connection, stamp, data in bag.messages():
            message = STORE.deserialize_cdr(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


def _time(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


@pytest.mark.parametrize("name", ["flight.mcap", "bag"])
@pytest.mark.parametrize("start", [0.0, 1.5, 1.7e9])
def test_stamps_are_exact_and_places_are_those_of_the_plan(
    name: str, start: float, tmp_path: Path
) -> None:
    plan = rough(step=0.1, steps=7, start=start)
    written = rho.export(plan, tmp_path / name, format="mcap", rate=13.0)
    assert all(file.exists() for file in written.files)
    found = _messages(tmp_path / name)
    begin = round(1000 * start) * 10**6
    knots = {begin + k * 10**8 for k in range(8)}
    transforms = found["/tf"]
    stamps = [stamp for stamp, _ in transforms]
    assert knots <= set(stamps)
    assert stamps == sorted(set(stamps))
    assert max(np.diff(stamps)) <= 1e9 / 13.0 + 1.0
    for stamp, message in transforms:
        expected = plan.sampled(np.array([(stamp - begin) / 1e9])).positions[:, 0]
        places = [_xyz(each.transform.translation) for each in message.transforms]
        np.testing.assert_allclose(places, expected, rtol=0, atol=PLACES)
        assert {_time(each.header.stamp) for each in message.transforms} == {stamp}
        assert [each.child_frame_id for each in message.transforms] == ["v0", "v1", "v2"]
    for i, vehicle in enumerate(plan.scenario.names):
        ((stamp, path),) = found[f"/{vehicle}/path"]
        assert stamp == begin
        assert [_time(each.header.stamp) for each in path.poses] == stamps
        ((stamp, trajectory),) = found[f"/{vehicle}/trajectory"]
        assert (stamp, trajectory.joint_names) == (begin, [vehicle])
        since = [_time_of(each.time_from_start) for each in trajectory.points]
        assert since == [each - begin for each in stamps]
        states = plan.sampled(np.array(since) / 1e9)
        for point, pose, p, v, a in zip(
            trajectory.points,
            path.poses,
            states.positions[i],
            states.velocities[i],
            states.accelerations[i],
            strict=True,
        ):
            np.testing.assert_allclose(_xyz(pose.pose.position), p, rtol=0, atol=PLACES)
            translation = _xyz(point.transforms[0].translation)
            np.testing.assert_allclose(translation, p, rtol=0, atol=PLACES)
            np.testing.assert_allclose(_xyz(point.velocities[0].linear), v, rtol=0, atol=PLACES)
            if point.time_from_start.nanosec % 10**8:  # the acceleration jumps at knots
                np.testing.assert_allclose(_xyz(point.accelerations[0].linear), a, atol=PLACES)


def _time_of(duration: Any) -> int:
    return _time(duration)


def test_another_reader_finds_the_same_messages(tmp_path: Path) -> None:
    rho.export(rough(), tmp_path / "x.mcap", heading="velocity")
    ours = _messages(tmp_path / "x.mcap")
    counts: dict[str, int] = {}
    with open(tmp_path / "x.mcap", "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            number = counts.get(channel.topic, 0)
            counts[channel.topic] = number + 1
            stamp, own = ours[channel.topic][number]
            assert message.log_time == message.publish_time == stamp
            if channel.topic == "/tf":  # the first transform, decoded by hand
                at = 4 + 4 + 8 + 4 + 4 + 4 + 4 + 3  # encapsulation to child_frame_id, "map", "v0"
                at += -(at - 4) % 8
                found = struct.unpack_from("<3d", message.data, at)
                assert list(found) == _xyz(own.transforms[0].transform.translation)
    assert counts == {topic: len(each) for topic, each in ours.items()}


def test_a_flight_that_begins_before_zero_is_stamped_from_zero(tmp_path: Path) -> None:
    rho.export(rough(start=-3.0), tmp_path / "x.mcap")
    assert _messages(tmp_path / "x.mcap")["/tf"][0][0] == 0


def test_stamps_beyond_the_type_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"grid: got an end at .* expected one before 2147483648 s"
    ):
        rho.export(rough(start=2.0**31 - 1.0), tmp_path / "x.mcap")
    assert not list(tmp_path.iterdir())


SHAPES: list[tuple[Any, list[int], float]] = [
    (rho.Sphere([1, 2, 3], 0.5), [2], 4 / 3 * np.pi * 0.5**3),
    (rho.Ellipsoid([1, 2, 3], [1, 2, 0.5]), [2], 4 / 3 * np.pi),
    (rho.Box([1, 2, 3], [2, 4, 6]), [1], 6.0),
    (rho.Cylinder([1, 2, 3], 0.5, 2.0, "x"), [3], np.pi * 0.25 * 2.0),
    (rho.Cylinder([1, 2, 3], 0.5), [3], np.pi * 0.25 * 1000.0),
    (rho.Capsule([1, 2, 3], [1, 5, 3], 0.5), [3, 2, 2], np.pi * (0.25 * 3.0 + 8 / 3 * 0.5**3)),
    (rho.Posed(rho.Box([0, 0, 0], [2, 1, 1]), [0, 0, np.pi / 2], [5, 0, 0]), [1], 2.0),
    (rho.Polytope([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), [11], 4.0),
    (
        rho.Mesh(
            [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
            [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        ),
        [11],
        4.0,
    ),
    (rho.Voxels([[0, 0, 0], [3, 1, 2]], resolution=0.5, origin=[1, 1, 1]), [6], 2.0),
]
"""Shapes with the kinds of their markers, and their volumes [m³] or the counts of list items."""


@pytest.mark.parametrize(("shape", "kinds", "size"), SHAPES)
def test_obstacles_are_markers_of_their_shape(
    shape: Any, kinds: list[int], size: float, tmp_path: Path
) -> None:
    ends = rho.State([-9, -9, -9]), rho.State([9, 9, 9])
    vehicle = rho.Vehicle("v0", *ends, radius=0.1)
    scenario = rho.Scenario("one", rho.Grid(0.5, 3), [vehicle], obstacles=[shape])
    plan = rho.Plan.from_accelerations(scenario, np.zeros((1, 2, 3)))
    rho.export(plan, tmp_path / "x.mcap")
    ((_, array),) = _messages(tmp_path / "x.mcap")["/obstacles"]
    assert [each.type for each in array.markers] == kinds
    scales = [np.array(_xyz(each.scale)) for each in array.markers]
    if kinds[0] in (6, 11):
        per = {6: 1, 11: 3}[kinds[0]]
        assert len(array.markers[0].points) == per * size
    else:
        factors = {1: 1.0, 2: np.pi / 6.0, 3: np.pi / 4.0}
        volume = sum(factors[k] * np.prod(scale) for k, scale in zip(kinds, scales, strict=True))
        assert volume == pytest.approx(size)
    corners = np.array([p for each in array.markers for p in _outline(each)])
    if np.isfinite(shape.extent).all():
        center = (corners.max(axis=0) + corners.min(axis=0)) / 2.0
        np.testing.assert_allclose(center, shape.center, atol=1e-9)
        np.testing.assert_allclose(np.ptp(corners, axis=0), 2.0 * shape.extent, atol=1e-9)


def _outline(marker: Any) -> list[np.ndarray]:
    """Return points of a marker that reach as far as it does along every axis, in the map."""
    q = marker.pose.orientation
    x, y, z, w = q.x, q.y, q.z, q.w
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    half = np.array(_xyz(marker.scale)) / 2.0
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)
    points = np.array([_xyz(each) for each in marker.points]).reshape(-1, 3)
    if marker.type == 2:  # an ellipsoid reaches to the tangent planes, and all here are unturned
        local = np.concatenate([np.diag(half), -np.diag(half)])
    elif marker.type == 6:
        local = (points[:, None] + half * signs).reshape(-1, 3)
    elif marker.type == 11:
        local = points
    else:  # cylinders too, whose axes are along those of the map
        local = half * signs
    return list(np.array(_xyz(marker.pose.position)) + local @ turn.T)


def test_moving_obstacles_are_where_they_are_and_go_when_they_end(tmp_path: Path) -> None:
    moving = rho.Obstacle(rho.Sphere([9, 9, 0], 1.0), velocity=[1, 0, 0], active=(0.4, 1.0))
    scenario = single(obstacles=[moving, rho.Box([7, 7, 7], [8, 8, 8])])
    plan = rho.Plan.from_accelerations(scenario, np.zeros((1, scenario.grid.knots - 1, 3)))
    rho.export(plan, tmp_path / "x.mcap", rate=10.0)
    arrays = _messages(tmp_path / "x.mcap")["/obstacles"]
    assert [each.ns for each in arrays[0][1].markers] == ["obstacle 2"]  # not active yet
    later = [(stamp, each) for stamp, array in arrays[1:] for each in array.markers]
    assert {each.ns for _, each in later} == {"obstacle 1"}
    assert [each.action for _, each in later] == [0] * (len(later) - 1) + [2]
    for stamp, each in later[:-1]:
        np.testing.assert_allclose(_xyz(each.pose.position), [9 + stamp / 1e9, 9, 0], atol=PLACES)
        assert 0.4 <= stamp / 1e9 <= 1.0
    assert later[-1][0] / 1e9 > 1.0


def test_tubes_are_balls_around_the_planned_positions(tmp_path: Path) -> None:
    scenario = disturbed(2)
    wind = winds_for(scenario, 2)["constant"]
    flown = rho.simulate(scenario, wind=wind, rng=np.random.default_rng(2), replan_every=3)
    start = scenario.grid.start
    for name, each in (("plan.mcap", rho.plan(scenario)), ("flown.mcap", flown)):
        rho.export(each, tmp_path / name)
        found = _messages(tmp_path / name)
        begin = found["/tf"][0][0]
        assert len(found["/tubes"]) > 10
        for stamp, array in found["/tubes"]:
            time = start + (stamp - begin) / 1e9
            balls = np.array([[*_xyz(m.pose.position), m.scale.x / 2.0] for m in array.markers])
            if isinstance(each, rho.Plan):
                expected = each.at(time).positions[:, 0]
                radius = float(rho.error_tube(scenario).position(time))
                np.testing.assert_allclose(balls[:, 3], radius)
            else:
                expected = each.nominal("position", time)[0]
                true = each.at(time).positions[:, 0]
                assert np.all(np.linalg.norm(true - balls[:, :3], axis=1) <= balls[:, 3] + 1e-6)
            np.testing.assert_allclose(balls[:, :3], expected, rtol=0, atol=PLACES)


def test_names_become_valid_and_distinct_topics(tmp_path: Path) -> None:
    names = ["UAV-1", "UAV 1", "1", "飛行機", "UAV_1_2"]
    rho.export(straight(5, names), tmp_path / "x.mcap")
    topics = [each for each in _messages(tmp_path / "x.mcap") if each.endswith("/path")]
    assert topics == [f"/{each}/path" for each in ("UAV_1", "UAV_1_2", "v1", "v", "UAV_1_2_2")]


def test_headings_are_quaternions(tmp_path: Path) -> None:
    rho.export(rough(), tmp_path / "x.mcap", heading={"v1": 1.0})
    for _, message in _messages(tmp_path / "x.mcap")["/tf"]:
        for each, angle in zip(message.transforms, (0.0, 1.0, 0.0), strict=True):
            q = each.transform.rotation
            np.testing.assert_allclose(
                [q.x, q.y, q.z, q.w], [0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)], atol=1e-15
            )


def test_headings_of_a_simulation_are_the_flown_ones_unless_others_are_given(
    tmp_path: Path,
) -> None:
    flown = rho.simulate(turning(1), plant="quadrotor", heading=2.0)
    for heading, angle in ((None, 2.0), (0.5, 0.5)):
        rho.export(flown, tmp_path / "x.mcap", heading=heading)
        for _, message in _messages(tmp_path / "x.mcap")["/tf"]:
            q = message.transforms[0].transform.rotation
            assert abs(2.0 * np.arctan2(q.z, q.w) - angle) < 1e-2


def test_without_rosbags_one_line_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> Any:
        raise ModuleNotFoundError(name)

    plan = rough()
    monkeypatch.setattr(importlib.import_module("drake_rho.formats.mcap"), "import_module", missing)
    with pytest.raises(ValueError, match=r"without rosbags, expected the extra ros: pip install"):
        rho.export(plan, tmp_path / "x.mcap")
    assert not list(tmp_path.iterdir())
