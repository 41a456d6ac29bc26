"""Records are complete, validated when created, and preserved by YAML."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given

import drake_rho as rho
from drake_rho.scenario.fields import unchecked
from tests.scenarios import fleet, scenarios, single, slow
from tests.written import as_yaml, from_yaml


def as_any(value: Any) -> Any:
    """Return the value with a type that lets mypy pass where it is wrong."""
    return value


STATE = rho.State([0, 0, 0])
VEHICLE = rho.Vehicle("a", STATE, rho.State([1, 0, 0]))
GRID = rho.Grid(1.0, 5)


@pytest.mark.parametrize(
    ("make", "field", "words"),
    [
        (lambda: rho.Grid(0.0, 5), "grid.step", "greater than 0"),
        (lambda: rho.Grid(float("nan"), 5), "grid.step", "nan"),
        (lambda: rho.Grid(float("inf"), 5), "grid.step", "finite"),
        (lambda: rho.Grid(1e155, 5), "grid.step", "between 1e-12 and 1e+12"),
        (lambda: rho.Grid(as_any(True), 5), "grid.step", "a number"),
        (lambda: rho.Grid(1.0, 10**6), "grid.knots", "100000"),
        (lambda: rho.State([10**400, 0, 0]), "state.position", "three finite numbers"),
        (lambda: rho.State([1e155, 0, 0]), "state.position", "at most 1e+12"),
        (lambda: rho.State([True, 0, 0]), "state.position", "three finite numbers"),
        (lambda: rho.Vehicle("a\x1b[2J", STATE, STATE), "vehicle.name", "printable"),
        (lambda: rho.Grid(1.0, 1), "grid.knots", "greater than or equal to 2"),
        (lambda: rho.Grid(1.0, as_any(2.5)), "grid.knots", "integer"),
        (lambda: as_any(rho.Grid)(1.0), "grid.knots", "nothing"),
        (lambda: as_any(rho.Grid)(step=1.0, knot=5), "grid.knot", "no field of this name"),
        (lambda: rho.State([0, 0]), "state.position", "three finite numbers"),
        (
            lambda: rho.Vehicle("a", as_any([0, 0, 0]), STATE),
            "vehicle.start",
            "got [0, 0, 0], expected State(position=...)",
        ),
        (lambda: as_any(rho.Grid)(duration=5.0), "grid.duration", "there are knots, start, step"),
        (lambda: rho.State([[0, 0, 0]]), "state.position", "three finite numbers"),
        (lambda: rho.State([0, 0, float("nan")]), "state.position", "nan"),
        (lambda: rho.State([0, 0, 0], [0, float("inf"), 0]), "state.velocity", "inf"),
        (lambda: rho.State("abc"), "state.position", "'abc'"),
        (lambda: rho.Box([0, 2, 0], [1, 1, 1]), "box.lower", "above upper [1.0, 1.0, 1.0]"),
        (lambda: rho.Sphere([0, 0, 0], 0.0), "sphere.radius", "greater than 0"),
        (lambda: rho.Sphere([0, 0, 0], -1.0), "sphere.radius", "-1"),
        *[
            (lambda most=most: rho.Limits(max_speed=as_any(most)), "limits.max_speed", words)
            for most, words in (
                (0.0, "greater than 0"),
                (-1.0, "-1"),
                (float("nan"), "nan"),
                (float("inf"), "finite"),
                (1e13, "between 1e-12 and 1e+12"),
                (True, "a number"),
                ([1, 1, 1], "[1, 1, 1]"),
                ("fast", "'fast'"),
            )
        ],
        *[
            (
                lambda ends=ends: rho.Scenario(
                    "s", GRID, (rho.Vehicle("a", *ends),), rho.Limits(max_speed=1.0)
                ),
                f"scenario.vehicles[0].{end}.velocity",
                "a norm of at most 1, not 1.131371",
            )
            for end, ends in {
                "start": (rho.State([0, 0, 0], [0.8, 0.8, 0.0]), STATE),
                "goal": (STATE, rho.State([0, 0, 0], [0.8, 0.0, -0.8])),
            }.items()
        ],
        (lambda: rho.Vehicle("", STATE, STATE), "vehicle.name", "at least 1 character"),
        (
            lambda: rho.Vehicle("a", STATE, rho.State([0, 0, 0], acceleration=[0, 0])),
            "state.acceleration",
            "three finite numbers",
        ),
        (lambda: rho.Scenario("s", GRID, ()), "scenario.vehicles", "at least 1"),
        (
            lambda: rho.Scenario("s", GRID, (VEHICLE, VEHICLE)),
            "scenario.vehicles[1].name",
            "no other vehicle",
        ),
        (
            lambda: rho.Scenario("s", GRID, (VEHICLE,), obstacles=(rho.Sphere([1, 0, 0], 0.5),)),
            "scenario.vehicles[0].goal.position",
            "outside obstacle 1",
        ),
        (
            lambda: rho.Scenario(
                "s", GRID, (VEHICLE,), rho.Limits(position=rho.Box([0.5, -1, -1], [2, 1, 1]))
            ),
            "scenario.vehicles[0].start.position",
            "within [0.5, -1.0, -1.0] to [2.0, 1.0, 1.0]",
        ),
        (
            lambda: rho.Scenario("s", GRID, (VEHICLE,), between_knots=as_any("perhaps")),
            "scenario.between_knots",
            "true or false",
        ),
        (
            lambda: rho.Scenario("s", GRID, (VEHICLE,), hold_at_goal=as_any("yes")),
            "scenario.hold_at_goal",
            "got 'yes', expected true or false",
        ),
    ],
)
def test_bad_input_names_field_value_and_expectation(
    make: Callable[[], object], field: str, words: str
) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        make()
    assert caught.value.field == field
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("grid:", "gird:", "gird"),
        ("  radius: 1000", "  colour: red\n  radius: 1000", "obstacles[0].colour"),
        ("knots: 50", "knots: fifty", "grid.knots"),
        ("name: UAV-2", "name: UAV-1", "vehicles[1].name"),
        ("[10.0, 20.0, 30.0]", "[10.0, 20.0, .nan]", "vehicles[1].start.velocity"),
        ("[10.0, 20.0, 30.0]", "[10.0, 200.1, 30.0]", "vehicles[1].start.velocity"),
        ("radius: 1000.0", "radius: 6000.0", "vehicles[0].start.position"),
        ("grid:", "name: twice\ngrid:", ""),
        ("grid:", "]grid:", ""),
        ("limits:", "limits:\n  max_speed: -3", "limits.max_speed"),
        ("limits:", "limits:\n  max_speed: 1", "vehicles[0].start.velocity"),
    ],
)
def test_bad_yaml_is_refused_by_name(old: str, new: str, field: str, paper: rho.Scenario) -> None:
    text = as_yaml(paper)
    assert old in text
    with pytest.raises(rho.ScenarioError) as caught:
        from_yaml(text.replace(old, new, 1))
    assert caught.value.field == field


def test_a_file_is_told_the_keys_of_a_part(paper: rho.Scenario) -> None:
    content = yaml.safe_load(as_yaml(paper))
    content["vehicles"][0]["goal"] = [5000, 4000, 3000]
    keys = "the keys position, velocity, acceleration"
    with pytest.raises(rho.ScenarioError, match=rf"vehicles\[0\]\.goal: .* a mapping with {keys}"):
        from_yaml(yaml.safe_dump(content))


@pytest.mark.parametrize(
    "text",
    [
        *("", "[1, 2]", "5", "a: 2020-13-50", "a: &x [*x]", "a: !!bool x", "a: !!int ''"),
        *("a: !!timestamp x", "a: " + "9" * 5000, "? [1]\n: 2", "? {a: 1}\n: 2", "\0"),
    ],
)
def test_text_that_is_no_scenario_is_refused(text: str) -> None:
    with pytest.raises(rho.ScenarioError) as caught:
        from_yaml(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize("brackets", [*slow("["), "{", "{? ", "- "])
def test_yaml_nested_too_deeply_is_refused_with_a_message(brackets: str) -> None:
    with pytest.raises(rho.ScenarioError, match="expected YAML that is less deeply nested"):
        from_yaml(brackets * 20_000)


def test_a_number_too_long_to_be_written_is_refused(paper: rho.Scenario) -> None:
    text = as_yaml(paper).replace("knots: 50", "knots: 0x" + "f" * 9000)
    with pytest.raises(
        rho.ScenarioError, match=r"grid\.knots: got a number of thousands of digits"
    ):
        from_yaml(text)


def test_the_error_of_a_duplicate_name_gives_its_place() -> None:
    names = [f"key{number}: {number}" for number in range(1000)]
    with pytest.raises(rho.ScenarioError, match=r"the key 'key7' once, not again .* line 1001"):
        from_yaml("\n".join([*names, "key7: 0"]))


def test_a_missing_file_and_a_wrong_name_are_named(tmp_path: Path) -> None:
    with pytest.raises(rho.ScenarioError, match="paper"):
        rho.load_scenario("papre")
    with pytest.raises(rho.ScenarioError, match="directory"):
        rho.load_scenario(tmp_path)
    (tmp_path / "s.yaml").write_text("grid: 5")
    with pytest.raises(rho.ScenarioError, match=r"s\.yaml: name"):
        rho.load_scenario(tmp_path / "s.yaml")


@given(scenario=scenarios())
def test_yaml_preserves_a_scenario(scenario: rho.Scenario) -> None:
    assert from_yaml(as_yaml(scenario)) == scenario


def test_files_preserve_a_scenario(paper: rho.Scenario, tmp_path: Path) -> None:
    own = dataclasses.replace(paper.vehicles[0], limits=rho.Limits(jerk=rho.Box([-1] * 3, [1] * 3)))
    changed = dataclasses.replace(paper, vehicles=(own, *paper.vehicles[1:]))
    rho.save_scenario(changed, tmp_path / "s.yaml")
    assert rho.load_scenario(tmp_path / "s.yaml") == changed != paper
    assert [path.name for path in tmp_path.iterdir()] == ["s.yaml"]


def test_every_library_scenario_loads() -> None:
    assert "paper" in rho.library()
    for name in rho.library():
        assert rho.load_scenario(name).name


def test_the_schema_describes_every_field_with_its_unit() -> None:
    schema = rho.scenario_schema()
    for record in (schema, *schema["$defs"].values()):
        assert record["additionalProperties"] is False
        assert all("description" in field for field in record["properties"].values())
    assert "[m/s]" in schema["$defs"]["State"]["properties"]["velocity"]["description"]
    assert "[m/s]" in schema["$defs"]["Limits"]["properties"]["max_speed"]["description"]


def test_records_cannot_be_changed(paper: rho.Scenario) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        paper.name = "other"  # type: ignore[misc]  # what is tested
    with pytest.raises(ValueError, match="read-only"):
        paper.vehicles[0].start.position[0] = 1.0
    given = np.zeros(3)
    state = rho.State(given)
    given[0] = 1.0
    assert state.position[0] == 0.0


def test_own_limits_replace_those_of_the_scenario() -> None:
    common = rho.Limits(velocity=rho.Box([-1] * 3, [1] * 3), jerk=rho.Box([-5] * 3, [5] * 3))
    own = rho.Limits(velocity=rho.Box([-2] * 3, [2] * 3))
    vehicle = dataclasses.replace(VEHICLE, limits=own)
    scenario = rho.Scenario("s", GRID, (vehicle,), common)
    merged = scenario.limits_of(vehicle)
    assert merged.velocity == own.velocity
    assert merged.jerk == common.jerk
    assert merged.acceleration is None


def test_an_own_largest_speed_replaces_that_of_the_scenario() -> None:
    """The vehicles are a faster one, a slower one, and one that has only a box of its own."""
    owns = (2.0, 0.5, None)
    box = rho.Box([-1] * 3, [1] * 3)
    vehicles = [
        rho.Vehicle(str(own), STATE, STATE, rho.Limits(velocity=box, max_speed=own)) for own in owns
    ]
    scenario = rho.Scenario("s", GRID, (*vehicles, VEHICLE), rho.Limits(max_speed=1.0))
    found = [scenario.limits_of(vehicle).max_speed for vehicle in scenario.vehicles]
    assert found == [2.0, 0.5, 1.0, 1.0]
    speeds = scenario.fleet.norms["max_speed"]
    np.testing.assert_array_equal(speeds.limits, found)
    alone = dataclasses.replace(scenario, limits=rho.Limits()).fleet
    np.testing.assert_array_equal(alone.norms["max_speed"].limits, [2.0, 0.5, np.inf, np.inf])
    assert from_yaml(as_yaml(scenario)) == scenario
    assert dataclasses.replace(scenario, vehicles=(VEHICLE,), limits=rho.Limits()) != scenario


def test_the_grid_of_the_paper(paper: rho.Scenario) -> None:
    assert paper.grid.duration == 49.0
    np.testing.assert_array_equal(paper.grid.times, np.arange(50.0))


def test_a_start_on_the_surface_is_allowed() -> None:
    touching = rho.Sphere([-2.0, 0.0, 0.0], 2.0)
    assert single(obstacles=(touching,)).obstacles == (touching,)


def test_copies_and_pickles_are_equal_and_read_only(paper: rho.Scenario) -> None:
    for other in (copy.deepcopy(paper), pickle.loads(pickle.dumps(paper))):  # noqa: S301  # own
        assert other == paper
        with pytest.raises(ValueError, match="read-only"):
            other.vehicles[0].start.position[0] = 1.0


def test_yaml_merge_keys_work_and_alias_bombs_are_refused_at_once(paper: rho.Scenario) -> None:
    text = as_yaml(paper)
    merged = text.replace(
        "  goal:\n    position: [5000.0, 4000.0, 3000.0]\n    velocity: [0.0, 0.0, 0.0]\n",
        "  goal: &goal\n    position: [5000.0, 4000.0, 3000.0]\n    velocity: [0.0, 0.0, 0.0]\n",
        1,
    ).replace(
        "  goal:\n    position: [5000.0, 4000.0, 3000.0]\n    velocity: [0.0, 0.0, 0.0]\n",
        "  goal: {<<: *goal, velocity: [0.0, 0.0, 0.0]}\n",
    )
    assert merged.count("<<") == 3
    assert from_yaml(merged) == paper
    for leaf, node in (("[1, 1, 1]", "[{}]"), ("{x: 1, y: 2}", "{{<<: [{}]}}")):
        lines = [f"a0: &a0 {leaf}"]
        for n in range(1, 20):
            lines.append(f"a{n}: &a{n} " + node.format(", ".join([f"*a{n - 1}"] * 9)))
        bomb = "\n".join(lines) + "\ngrid: *a19\nname: *a19\nvehicles: [{start: {position: *a19}}]"
        with pytest.raises(rho.ScenarioError):
            from_yaml(bomb)


def test_names_of_nested_merges_are_no_duplicates() -> None:
    text = """
name: two
grid: {step: 1, knots: 20}
vehicles:
- name: one
  start: {position: [0, 0, 0]}
  goal: {position: [9, 0, 0]}
  limits: &one {velocity: {lower: [-1, -1, -1], upper: [1, 1, 1]}}
- name: other
  start: {position: [0, 5, 0]}
  goal: {position: [9, 5, 0]}
  limits: &other {<<: *one, velocity: {lower: [-2, -2, -2], upper: [2, 2, 2]}}
limits: {<<: *other}
"""
    scenario = from_yaml(text)
    assert scenario.limits == scenario.vehicles[1].limits != scenario.vehicles[0].limits


def _every_field_set() -> rho.Scenario:
    """Return a scenario in which every field has a meaningful value."""
    bird = rho.Obstacle(rho.Sphere([5, 0, 9], 0.5), velocity=[0, 0.5, 0], known_from=2.0)
    return dataclasses.replace(
        fleet([[0, 0, 0], [3, 3, 3]], [[9, 9, 9], [12, 12, 12]]),
        obstacles=(rho.Sphere([5, 5, -9], 1.0), bird),
        limits=rho.Limits(max_speed=20.0),
        disturbance=rho.Disturbance(0.01),
        requirements=(rho.KeepIn(rho.Sphere([0, 0, 0], 99.0)),),
    )


CHANGES: dict[str, Any] = {
    "name": "other",
    "grid": rho.Grid(0.25, 61, 1.0),
    "vehicles": (rho.Vehicle("alone", rho.State([1, 2, 3]), rho.State([9, 1, 1]), radius=0.1),),
    "limits": rho.Limits(max_speed=30.0, max_acceleration=50.0),
    "obstacles": (rho.Obstacle(rho.Sphere([5, 0, -9], 2.5), velocity=[0, 9.0, 0]),),
    "separation": rho.Separation(0.1),
    "between_knots": False,
    "disturbance": None,
    "requirements": (rho.KeepIn(rho.HalfSpace([0, 0, 1], 90.0)),),
    "smoothing": None,  # none is allowed beside a disturbance, and nothing cached depends on it
    "hold_at_goal": False,
    "objective": rho.Objective(terminal_velocity=1.0),
    "frame": rho.Frame(47.0, 8.0),
}
"""Other values of every field."""


def _computed(scenario: rho.Scenario) -> list[object]:
    """Return the values that a scenario computes and caches."""
    arrays = [
        scenario.fleet.start_positions,
        scenario.fleet.radii,
        scenario.fleet.lengths,
        *(scenario.fleet.scale(quantity) for quantity in ("position", "jerk")),
        *(limit.limits for limit in scenario.fleet.norms.values()),
    ]
    reported = [scenario.bodies, scenario.bodies_in_flight, scenario.known, scenario.spheres]
    return [*reported, *(array.tolist() for array in arrays)]


def test_no_copy_of_a_scenario_keeps_cached_values_of_another() -> None:
    scenario = _every_field_set()
    assert CHANGES.keys() == {field.name for field in dataclasses.fields(scenario)}
    before = _computed(scenario)
    for field, value in CHANGES.items():
        values = {each: getattr(scenario, each) for each in CHANGES} | {field: value}
        asked = _computed(rho.Scenario(**values))
        copies = [
            dataclasses.replace(scenario, **{field: value}),
            unchecked(scenario, **{field: value}),
            scenario.derived(**{field: value}),
        ]
        if sys.version_info >= (3, 13):
            copies.append(copy.replace(scenario, **{field: value}))
        for each in copies:
            assert _computed(each) == asked, field
    assert _computed(scenario.without_obstacles()) == _computed(
        dataclasses.replace(scenario, obstacles=())
    )
    assert _computed(copy.copy(scenario)) == before


def test_copies_of_records_begin_without_cached_values() -> None:
    scenario = _every_field_set()
    records: list[Any] = [scenario, scenario.grid, rho.Box([0, 0, 0], [1, 1, 1])]
    records += [rho.Polytope([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), scenario.bodies[1]]
    for each in records:
        computed = [
            name
            for kind in type(each).__mro__
            for name, value in vars(kind).items()
            if isinstance(value, cached_property)
        ]
        for name in computed:
            getattr(each, name)
        assert set(computed) <= set(vars(each))
        for other in (unchecked(each), copy.copy(each), pickle.loads(pickle.dumps(each))):  # noqa: S301
            assert other == each
            assert not set(computed) & set(vars(other))
