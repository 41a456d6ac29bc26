"""Files of certificates: an independent check of numbers proves the bound, and nothing higher."""

from __future__ import annotations

import copy
import dataclasses
import gzip
import hashlib
import inspect
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import drake_rho as rho
from tests.maps import Array, l_mesh, wall_with_gap
from tests.scenarios import box, fleet, single
from tests.test_global_optimum import balls

CLOSE = 1e-6
"""Largest relative difference of the bound in a file from the certificate's."""

AHEAD = rho.State([10.0, 0.0, 0.0])
"""Goal straight ahead of the obstacles."""


def _crossing() -> rho.Scenario:
    """Return two vehicles of different weights that meet, with limits and a waypoint."""
    scenario = fleet(
        [[0.0, 0.0, 0.0], [8.0, 0.1, 0.0]],
        [[8.0, 0.0, 0.1], [0.0, 0.0, 0.0]],
        limits=rho.Limits(max_speed=3.0, position=box(9.0), acceleration=box(1.5)),
    )
    first = scenario.vehicles[0]
    near = rho.Waypoint(3.3, [4.0, 0.3, 0.5], within=0.2)
    vehicle = rho.Vehicle(first.name, first.start, first.goal, weight=2.0, waypoints=[near])
    return scenario.derived(vehicles=(vehicle, scenario.vehicles[1]))


def _through_gates() -> rho.Scenario:
    """Return a vehicle past a capsule, on a clock far from zero, through two waypoints."""
    scenario = single(
        obstacles=[rho.Capsule([4.0, -1.0, -0.5], [6.0, 1.0, 0.5], 0.7)],
        goal=AHEAD,
        grid=rho.Grid(0.5, 17, start=1.7e9 + 0.3),
    )
    gates = [
        rho.Waypoint(1.7e9 + 2.4, [2.0, 0.5, 0.2], velocity=[1.5, 0.2, 0.0]),
        rho.Waypoint(1.7e9 + 6.61, [8.0, 0.0, 0.5], within=0.3),
    ]
    vehicle = scenario.vehicles[0]
    made = rho.Vehicle(vehicle.name, vehicle.start, vehicle.goal, radius=0.2, waypoints=gates)
    return scenario.derived(vehicles=(made,))


def _past_a_wall() -> rho.Scenario:
    wall = rho.Box([2.0, -1.0, -1.3], [7.0, 1.1, 1.2])
    return single(
        obstacles=[wall],
        start=rho.State([0, 0, 0]),
        goal=rho.State([9, 0, 0]),
        grid=rho.Grid(0.5, 17),
    )


def _past_three_in_a_row() -> rho.Scenario:
    """Return a vehicle with a radius whose cheapest plan needs branches at every obstacle."""
    rng, obstacles = np.random.default_rng(2), list[rho.Obstacle]()
    for x in (2.5, 5.0, 7.5):
        center = np.array([x, *rng.uniform(-0.2, 0.2, 2)])
        shape = (
            rho.Ellipsoid(center, rng.uniform(0.6, 1.6, 3))
            if rng.integers(0, 2)
            else rho.Polytope(center + rng.uniform(-1.2, 1.2, (10, 3)))
        )
        obstacles.append(rho.Obstacle(shape))
    vehicle = rho.Vehicle("v", rho.State([0.0, 0.0, 0.0]), AHEAD, radius=0.3)
    return single(obstacles=obstacles, goal=AHEAD).derived(vehicles=(vehicle,))


def _hurried() -> rho.Scenario:
    """Return a vehicle at its limits of every kind."""
    limits = rho.Limits(
        position=box(11.0),
        velocity=box(3.4),
        acceleration=box(1.5),
        jerk=box(4.0),
        max_speed=3.5,
        max_acceleration=2.0,
        max_thrust=10.5,
        max_tilt=0.16,
        max_jerk=3.9,
    )
    return single(limits=limits, goal=rho.State([10.0, 0.0, 3.0]), grid=rho.Grid(0.25, 25))


def _required() -> rho.Scenario:
    """Return two linked vehicles, one of them near a moving point and in convex sets for a time."""
    point = rho.Track(
        [0.0, 4.0, 8.0], [[0.0, 0.0, 0.0], [4.0, 1.5, 0.0], [8.0, 0.0, 0.0]], deviation=0.05
    )
    scenario = fleet([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]], [[8.0, 0.0, 0.0], [8.0, 1.0, 2.0]])
    one, other = scenario.names
    turned = rho.Posed(rho.Capsule([-2, 0, 0], [2, 0, 0], 0.5), [0, 0, 0.1], [4.0, 2.5, 0.6])
    ahead = rho.Cone([0.0, 0.0, 0.0], [1.0, 0.3, 0.0], 0.2)
    return scenario.derived(
        requirements=[
            rho.KeepIn(rho.Sphere([0, 0, 0], 2.3), vehicles=one, relative_to=other),
            rho.KeepIn(rho.Ellipsoid([0, 0, 0], [1, 2, 0.6]), vehicles=one, relative_to=point),
            rho.KeepIn(turned, vehicles=other, active=(4.0, 4.61)),
            rho.KeepIn(ahead, vehicles=other, of="velocity", active=(1.05, 2.33)),
            rho.KeepIn(rho.Cylinder([0, 0, 9.8], 0.3, 1.0), of="thrust", active=(3.0, 7.1)),
            rho.KeepIn(rho.Box([-0.4] * 3, [0.4] * 3), of="jerk", vehicles=one, active=(1.0, 5.0)),
            rho.KeepIn(rho.HalfSpace([0.0, 0.0, -2.0], 0.4)),
        ]
    )


def _to_a_set() -> rho.Scenario:
    """Return a vehicle that dwells, leaves a gate in a cone, and arrives anywhere in a set."""
    gates = [
        rho.Waypoint(3.0, [3.0, 1.0, 0.0], dwell=0.5),
        rho.Waypoint(6.5, [6.0, 0.0, 0.0], velocity=rho.Cone([0, 0, 0], [1, -1, 0], 0.2)),
    ]
    goal = rho.Goal(rho.Sphere([9.0, 1.0, -1.0], 0.5), velocity=None)
    vehicle = rho.Vehicle("v", rho.State([0.0, 0.0, 0.0]), goal, waypoints=gates)
    return single().derived(vehicles=(vehicle,))


def _posed() -> rho.Scenario:
    tube = rho.Posed(
        rho.Cylinder([0, 0, 0], 1.0), rotation=[0.3, 0.1, 0.5], translation=[5, 0.2, 0]
    )
    seen = rho.Obstacle(rho.Sphere([7.5, 0.3, 0.0], 0.4), velocity_error=0.05, seen_at=-1.0)
    return single(obstacles=[tube, seen], goal=AHEAD)


def _past_a_map(given: rho.Mesh | rho.Voxels) -> rho.Scenario:
    ends = rho.State([0.0, 0.0, 1.5]), rho.State([10.0, 0.0, 1.5])
    vehicle = rho.Vehicle("v", *ends, radius=0.3)
    return single().derived(vehicles=(vehicle,), obstacles=(given,))


def _turned_wall() -> rho.Scenario:
    cos, sin = np.cos(0.2), np.sin(0.2)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return _past_a_map(
        dataclasses.replace(wall_with_gap(), rotation=turn, origin=np.array([4.75, 0.4, 0.0]))
    )


def _mesh() -> rho.Scenario:
    vertices = l_mesh().vertices + np.array([4.5, -0.5, -0.4])
    return _past_a_map(rho.Mesh(vertices, l_mesh().triangles))


SCENES: dict[str, Callable[[], rho.Scenario]] = {
    "the paper's": lambda: rho.load_scenario("paper"),
    "two that meet": _crossing,
    "balls": balls,
    "a box that moves": lambda: single(
        obstacles=[
            rho.Obstacle(rho.Box([3.5, -1.0, -2.0], [5.0, 0.5, 2.0]), velocity=[0.1, 0.1, 0.0])
        ],
        goal=AHEAD,
        between_knots=True,
    ),
    "gates": _through_gates,
    "a polytope": lambda: single(
        obstacles=[
            rho.Polytope(
                [
                    [4.0, -1.0, -1.0],
                    [6.0, -1.5, -1.0],
                    [5.0, 1.0, -1.0],
                    [5.0, 0.0, 1.5],
                    [5.0, 0.2, 0.0],
                ]
            )
        ],
        goal=AHEAD,
    ),
    "a cylinder for a while": lambda: single(
        obstacles=[
            rho.Obstacle(rho.Cylinder([3.5, 0.3, 0.0], 1.2, 6.0), active=(1.0, 6.0)),
            rho.Obstacle(rho.Ellipsoid([7.0, -0.2, 0.1], [1.0, 1.5, 0.5]), position_error=0.1),
        ],
        goal=AHEAD,
    ),
    "a wall": _past_a_wall,
    "three in a row": _past_three_in_a_row,
    "limits of every kind": _hurried,
    "requirements": _required,
    "a goal in a set": _to_a_set,
    "posed": _posed,
    "a map of cells": _turned_wall,
    "a mesh": _mesh,
}
"""Scenes whose bounds are saved."""

GAPS = {"balls": 0.01, "a wall": 0.002, "three in a row": 0.01, "a map of cells": 0.01}
"""Gaps for which they need branches."""


@pytest.fixture(scope="module", params=list(SCENES))
def saved(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[rho.Certificate, Path]:
    """Return a certificate of a scene, and its file."""
    path = tmp_path_factory.mktemp("proofs") / "mission.proof"
    gap = GAPS.get(request.param)
    certificate = rho.certify(rho.plan(SCENES[request.param]()), gap=gap)
    assert (certificate.nodes > 1) == (gap is not None)
    certificate.save(path)
    return certificate, path


def test_a_file_proves_the_bound(saved: tuple[rho.Certificate, Path]) -> None:
    certificate, path = saved
    found = rho.check_certificate(path)
    assert found.lower_bound == pytest.approx(certificate.lower_bound, rel=CLOSE)
    assert found.lower_bound <= certificate.cost * (1 + 1e-9)
    assert (found.branches > len(found.groups)) == (certificate.nodes > 1)
    assert certificate.scenario.name in str(found)


def test_the_checker_runs_without_the_package(tmp_path: Path) -> None:
    path = tmp_path / "paper.proof"
    certificate = rho.certify(rho.plan(rho.load_scenario("paper")))
    certificate.save(path)
    copied = tmp_path / "alone.py"
    source = inspect.getsourcefile(rho.check_certificate) or "none"
    copied.write_text(Path(source).read_text())
    code = (
        "import alone, sys; print(alone.check_certificate(sys.argv[1]).lower_bound); "
        "assert not {'drake_rho', 'scipy', 'pydrake', 'pydantic'} & set(sys.modules)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert float(run.stdout) == pytest.approx(certificate.lower_bound, rel=CLOSE)


def _content(path: Path) -> dict[str, Any]:
    with gzip.open(path, "rt") as file:
        content: dict[str, Any] = json.load(file)["content"]
    return content


def _check(content: dict[str, Any], path: Path) -> rho.CheckedBound:
    """Return the bound of other content, whose digest is made anew."""
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    stored = {"format": "drake_rho certificate 2", "digest": digest, "content": content}
    path.write_bytes(gzip.compress(json.dumps(stored).encode()))
    return rho.check_certificate(path)


def _places(content: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path to every value in nested lists and mappings."""
    if isinstance(content, (dict, list)):
        pairs = content.items() if isinstance(content, dict) else enumerate(content)
        for key, each in pairs:
            yield from _places(each, (*at, key))
    else:
        yield at


def _changed(content: dict[str, Any], at: tuple[Any, ...], rng: np.random.Generator) -> Any:
    """Return a copy in which one value is changed."""
    changed = copy.deepcopy(content)
    inner: Any = changed
    for key in at[:-1]:
        inner = inner[key]
    value = inner[at[-1]]
    if isinstance(value, str):
        inner[at[-1]] = str(rng.choice(["velocity", "acceleration", "position", "no quantity"]))
    elif isinstance(value, int):
        inner[at[-1]] = int(rng.integers(-2, 4))
    else:
        other = [value * rng.uniform(0.0, 3.0), value + rng.normal(), -value, 1e6, np.nan, None]
        inner[at[-1]] = other[rng.integers(len(other))]
    return changed


def test_no_change_of_a_proof_raises_the_bound_above_the_cost(
    saved: tuple[rho.Certificate, Path], tmp_path: Path
) -> None:
    """A file in which branches or multipliers are changed proves less, or is refused."""
    certificate, path = saved
    content, rng = _content(path), np.random.default_rng(1)
    places = [("groups", *each) for each in _places(content["groups"])]
    chosen = rng.permutation(len(places))[:60]
    refused = lower = 0
    for at in (places[index] for index in chosen):
        try:
            found = _check(_changed(content, at, rng), tmp_path / "changed.proof")
        except ValueError:
            refused += 1
        else:
            assert found.lower_bound <= certificate.cost * (1 + 1e-9), at
            lower += found.lower_bound < certificate.lower_bound * (1 - CLOSE)
    assert refused > 0
    assert lower > 0


def test_no_row_beyond_its_set_raises_the_bound_above_the_cost(
    saved: tuple[rho.Certificate, Path], tmp_path: Path
) -> None:
    """Rows touch the sets of limits, waypoints and requirements: beyond, they are refused.

    Unless another set implies them too.
    """
    content, raised, refused = _content(saved[1]), 0, 0
    for tree in _leaves(content):
        for row in tree["rows"]:
            before, row[5] = row[5], row[5] + 1e-3 * (1.0 + abs(row[5]))
            try:
                found = _check(content, tmp_path / "changed.proof")
            except ValueError:  # nothing implies it
                refused += 1
            else:
                assert found.lower_bound <= saved[0].cost * (1 + 1e-9)
            row[5], raised = before, raised + 1
    assert 2 * refused >= raised


def _leaves(content: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the branches that are not split, of which few have rows."""
    trees = [each["tree"] for each in content["groups"]]
    while trees:
        tree = trees.pop()
        trees += tree.get("parts", [])
        if "rows" in tree:
            yield tree


@pytest.mark.parametrize("column", [6, 7], ids=["radius", "multiplier"])
def test_negative_radii_and_multipliers_are_refused(column: int, tmp_path: Path) -> None:
    path = tmp_path / "paper.proof"
    rho.certify(rho.plan(rho.load_scenario("paper"))).save(path)
    content = _content(path)
    balls = [ball for each in content["groups"] for ball in each["tree"]["curved"]]
    assert balls
    for ball in balls:
        ball[column] *= -1.0
    with pytest.raises(ValueError, match=r"paper\.proof: "):
        _check(content, path)


def test_cones_that_do_not_cover_all_directions_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "balls.proof"
    rho.plan_global(balls(), gap=0.01).certificate.save(path)
    content = _content(path)
    tree = content["groups"][0]["tree"]
    cones, parts = tree["cones"], tree["parts"]
    assert len(cones) == 8  # octants

    def refused(changed: list[Any], bounded: list[Any]) -> str:
        tree.update(cones=changed, parts=bounded)
        with pytest.raises(ValueError, match="cone") as error:
            _check(content, path)
        return str(error.value)

    assert "do not meet" in refused(cones[1:], parts[1:])
    assert "do not meet" in refused([cones[0], *cones], [parts[0], *parts])
    moved = [[[x + 0.1, y, z] for x, y, z in cones[0]], *cones[1:]]
    assert "do not meet" in refused(moved, parts)
    assert "right-handed" in refused([each[::-1] for each in cones], parts)
    assert "do not meet" in refused([], [])
    del tree["cones"]
    with pytest.raises(ValueError, match="without cones"):
        _check(content, path)


def test_a_part_beside_a_box_that_is_left_out_is_missed(tmp_path: Path) -> None:
    path = tmp_path / "wall.proof"
    rho.certify(rho.plan(_past_a_wall()), gap=0.002).save(path)
    content = _content(path)
    tree = content["groups"][0]["tree"]
    assert len(tree["parts"]) == 26  # sides, edges and corners
    tree["parts"] = tree["parts"][1:]
    with pytest.raises(ValueError, match="25 parts of 26"):
        _check(content, path)


def test_a_branch_that_is_left_out_is_missed(tmp_path: Path) -> None:
    certificate = rho.plan_global(balls(), gap=0.01).certificate
    ((group, tree),) = certificate.proofs
    cut = {**tree, "parts": tree["parts"][1:]}
    short = rho.Certificate(
        certificate.scenario, certificate.vehicles, certificate.holds, proofs=((group, cut),)
    )
    with pytest.raises(ValueError, match="parts of 8"):
        short.save(tmp_path / "never.proof")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("change", ["radius", "center", "goal", "weight"])
def test_a_changed_scenario_is_another_scenario(change: str, tmp_path: Path) -> None:
    """The bound of a file is one of the scenario in it: plans of that one cost no less."""
    scenario = single(obstacles=[rho.Sphere([4.0, 4.0, 0.0], 1.5)], between_knots=True)
    rho.certify(rho.plan(scenario)).save(tmp_path / "ball.proof")
    content = _content(tmp_path / "ball.proof")
    vehicle, ball = scenario.vehicles[0], [4.0, 4.0, 0.0]
    stored, obstacle = content["scenario"]["vehicles"][0], content["scenario"]["obstacles"]["1"]
    radius, weight, goal = 1.5, 1.0, vehicle.goal
    if change == "radius":
        radius = obstacle["shape"]["radius"] = 0.7
    elif change == "center":
        ball = obstacle["positions"][0] = [4.0, 3.0, 1.0]
    elif change == "weight":
        weight = stored["weight"] = 0.5
    else:
        goal = rho.State([7.0, 5.0, 1.0])
        stored["given"][0][2] = [7.0, 5.0, 1.0]
    other = rho.Vehicle(vehicle.name, vehicle.start, goal, weight=weight)
    meant = scenario.derived(vehicles=(other,), obstacles=(rho.Sphere(ball, radius),))
    try:
        found = _check(content, tmp_path / "changed.proof")
    except ValueError:
        return  # a ball is outside of the smaller obstacle
    assert found.lower_bound <= rho.plan(meant).cost * (1 + 1e-9)


@dataclasses.dataclass(frozen=True)
class _Floor:
    """Half-space z >= -1, as a user's own set."""

    def support(self, n: Array) -> Array:
        off = np.linalg.norm(n - [0.0, 0.0, -1.0], axis=-1)
        return np.where(off < 1e-9, 1.0, np.inf)

    def signed_distance(self, x: Array) -> Array:
        return -1.0 - x[..., 2]

    def outward(self, x: Array) -> Array:
        return np.broadcast_to([0.0, 0.0, -1.0], x.shape)


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "paper.proof"
    rho.certify(rho.plan(rho.load_scenario("paper"))).save(path)
    stored = json.loads(gzip.decompress(path.read_bytes()))
    stored["content"]["scenario"]["step"] *= 2.0
    path.write_bytes(gzip.compress(json.dumps(stored).encode()))
    with pytest.raises(ValueError, match="digest"):
        rho.check_certificate(path)
    stored["format"] = "drake_rho certificate 1"
    path.write_bytes(gzip.compress(json.dumps(stored).encode()))
    with pytest.raises(ValueError, match="got the format 'drake_rho certificate 1'"):
        rho.check_certificate(path)
    for damaged in (b"", b"no gzip", gzip.compress(b"{}"), gzip.compress(b"[1"), b"\x1f\x8b\x08"):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"paper\.proof"):
            rho.check_certificate(path)
    with pytest.raises(FileNotFoundError):
        rho.check_certificate(tmp_path / "none.proof")


@pytest.mark.parametrize(
    ("scenario", "named"),
    [
        (lambda: single().derived(objective=rho.Objective(jerk=1.0)), "objective"),
        (lambda: single().derived(disturbance=rho.Disturbance(0.1)), "disturbance"),
        (
            lambda: single().derived(requirements=[rho.KeepIn(_Floor(), name="floor")]),
            r"requirement 1 \(floor\) with a set of one's own",
        ),
        (
            lambda: single().derived(
                requirements=[
                    rho.KeepIn(
                        rho.Sphere([0, 0, 0], 9.0),
                        of="velocity",
                        relative_to=rho.Track([0.0, 8.0], [[0, 0, 0], [8, 0, 0]]),
                    )
                ]
            ),
            "a velocity relative to a track",
        ),
    ],
)
def test_what_files_do_not_hold_is_named(
    scenario: Callable[[], rho.Scenario], named: str, tmp_path: Path
) -> None:
    certificate = rho.certify(rho.plan(scenario()))
    with pytest.raises(ValueError, match=named):
        certificate.save(tmp_path / "mission.proof")
    assert list(tmp_path.iterdir()) == []
