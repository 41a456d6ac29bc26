"""The disturbance of a scenario: wind, estimation errors and the feedback against them."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from pathlib import Path
from typing import Any

import pytest

import drake_rho as rho
from tests.disturbed import tracked
from tests.scenarios import single
from tests.written import as_yaml, from_yaml, in_plan_file

EVERY_FIELD = rho.Disturbance(0.3, 0.02, 0.05, 0.05, 1, 0.4, dropouts=2)


def _with(disturbance: rho.Disturbance | None, grid: rho.Grid | None = None) -> rho.Scenario:
    return dataclasses.replace(single(grid=grid), disturbance=disturbance)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("acceleration", -0.1, "greater than or equal to 0"),
        ("acceleration", float("nan"), "finite"),
        ("acceleration", float("inf"), "finite"),
        ("acceleration", True, "a number"),
        ("acceleration", "strong", "number"),
        ("position_error", -1e-9, "greater than or equal to 0"),
        ("velocity_error", -1.0, "greater than or equal to 0"),
        ("feedback_every", 0.0, "greater than 0"),
        ("feedback_every", -0.1, "greater than 0"),
        ("delay", -1, "greater than or equal to 0"),
        ("delay", 0.5, "integer"),
        ("delay", True, "a number"),
        ("delay", 51, "less than or equal to 50"),
        ("dropouts", -1, "greater than or equal to 0"),
        ("dropouts", 1.5, "integer"),
        ("dropouts", True, "a number"),
        ("prediction", 1, "true or false"),
        ("share", 0.0, "greater than 0"),
        ("share", 1.1, "less than or equal to 1"),
        ("shares", 0.5, "did you mean share"),
    ],
)
def test_bad_input_is_one_error_with_field_value_and_expectation(
    field: str, value: Any, words: str
) -> None:
    given: dict[str, Any] = {"acceleration": 1.0, field: value}
    with pytest.raises(rho.ScenarioError) as caught:
        rho.Disturbance(**given)
    assert caught.value.field == f"disturbance.{field}"
    assert caught.value.value is value
    assert words in str(caught.value)


def test_lost_measurements_need_a_prediction() -> None:
    with pytest.raises(
        rho.ScenarioError, match="true or none, since measurements may be lost"
    ) as caught:
        rho.Disturbance(1.0, dropouts=1, prediction=False)
    assert caught.value.field == "disturbance.prediction"
    text = as_yaml(_with(EVERY_FIELD)).replace("share:", "prediction: false, share:")
    with pytest.raises(rho.ScenarioError, match="got False") as caught:
        from_yaml(text)
    assert caught.value.field == "disturbance.prediction"


def test_the_first_error_counts_delay_and_lost_measurements() -> None:
    grid, age = rho.Grid(0.5, 9), 5 * 0.1
    around = rho.Disturbance(0.3, 0.02, 0.05, 0.1, delay=2, dropouts=3)
    expected = 0.02 + age * 0.05 + 0.3 * age**2 / 2, 0.05 + 0.3 * age
    assert around.first_error(grid) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("every", [0.3, 0.6, 1.0, 0.5 / 1001, 0.2500001])
def test_the_feedback_divides_the_step(every: float) -> None:
    with pytest.raises(rho.ScenarioError, match=r"divides the step, 0\.5 s") as caught:
        _with(rho.Disturbance(1.0, feedback_every=every))
    assert (caught.value.field, caught.value.value) == (
        "scenario.disturbance.feedback_every",
        every,
    )


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 1000])
def test_samples_of_a_flight(parts: int) -> None:
    grid = rho.Grid(0.1, 17)
    disturbance = _with(rho.Disturbance(1.0, feedback_every=grid.step / parts), grid).disturbance
    assert disturbance is not None
    assert disturbance.samples(grid) == 16 * parts
    assert disturbance.sample(grid) == pytest.approx(grid.step / parts, rel=1e-15)
    assert rho.Disturbance(1.0).sample(grid) == grid.step  # null means the step


def test_yaml_json_copies_and_pickles_preserve_the_disturbance(tmp_path: Path) -> None:
    scenario = _with(EVERY_FIELD)
    rho.save_scenario(scenario, tmp_path / "s.yaml")
    assert rho.load_scenario(tmp_path / "s.yaml") == scenario != _with(None)
    assert copy.deepcopy(scenario) == scenario
    assert pickle.loads(pickle.dumps(scenario)) == scenario  # noqa: S301  # our own
    assert '"share":0.4' in in_plan_file(scenario)[0]
    assert "disturbance" not in as_yaml(_with(None))
    text = as_yaml(_with(None)) + "disturbance: {acceleration: 0.3, feedback_every: null}"
    assert from_yaml(text).disturbance == rho.Disturbance(0.3)


def test_the_schema_has_units() -> None:
    kinds = rho.scenario_schema()["$defs"]
    units = {
        "acceleration": "[m/s²]",
        "position_error": "[m]",
        "velocity_error": "[m/s]",
        "feedback_every": "[s]",
        "delay": "samples",
        "share": "part",
        "tracking": "a plan under way",
        "dropouts": "in a row",
        "prediction": "predicts",
    }
    tracking = {"since": "[s]", "gains": "[1/s²]", "position": "[m]", "velocity": "[m/s]"}
    tracking["prediction"] = "predicts"
    for kind, expected in (("Disturbance", units), ("Tracking", tracking)):
        fields = kinds[kind]["properties"]
        assert set(fields) == set(expected)
        for name, unit in expected.items():
            assert unit in fields[name]["description"].replace("\n", " ")


def test_derived_scenarios_keep_the_disturbance(paper: rho.Scenario) -> None:
    scenario = dataclasses.replace(paper, disturbance=EVERY_FIELD)
    made = (
        scenario.without_obstacles(),
        scenario.without_separation(),
        scenario.of_vehicles([0]),
    )
    assert all(each.disturbance == EVERY_FIELD for each in made)
    alone = dataclasses.replace(single(), disturbance=EVERY_FIELD)
    rest = rho.plan_convex(alone).tail(3).scenario
    assert rest.disturbance is not None  # with the tube of the plan since its first knot
    assert dataclasses.replace(rest.disturbance, tracking=None) == EVERY_FIELD
    assert rest.disturbance.tracking == rho.error_tube(alone).tracking


def test_on_another_grid_the_feedback_is_at_least_as_frequent() -> None:
    scenario = _with(rho.Disturbance(1.0, feedback_every=0.25))
    for step, every in ((0.25, 0.25), (1.0, 0.25), (0.1, 0.1), (0.6, 0.2)):
        other = scenario.on_grid(rho.Grid(step, 9)).disturbance
        assert other is not None
        assert other.feedback_every == pytest.approx(every, rel=1e-12)
    many = _with(rho.Disturbance(1.0, feedback_every=0.0005)).on_grid(rho.Grid(5.0, 9)).disturbance
    assert many is not None
    assert many.samples_per_step(5.0) == 1000  # and no more
    assert _with(rho.Disturbance(1.0)).on_grid(rho.Grid(0.1, 9)).disturbance == rho.Disturbance(1.0)
    bound = dataclasses.replace(scenario, limits=rho.Limits(max_speed=20.0))
    assert rho.shortest_plan(bound).scenario.disturbance is not None  # it tries other steps


def test_gains_given_by_a_scenario_are_used() -> None:
    own = (0.5, 1.0)
    around = rho.Disturbance(0.3, 0.02, 0.02, 0.1, tracking=tracked(0.0, own))
    limits = rho.Limits(max_acceleration=2.0)
    windy = dataclasses.replace(
        single(grid=rho.Grid(0.5, 21), goal=rho.State([5, 0, 0]), limits=limits),
        disturbance=around,
    )
    assert rho.error_tube(windy).gains == own
    assert rho.error_tube(windy, gains=(1.0, 2.0)).gains == (1.0, 2.0)
    worst = rho.worst_case(windy, [1, 0, 0], 10.0)
    flown = rho.simulate(windy, replan_every=100, wind=worst)
    filled = flown.errors()[1:, 0] / flown.radii()[1:]
    assert filled.max() == pytest.approx(1.0, abs=1e-9)
    begun = dataclasses.replace(around, tracking=tracked(-1.0, own, 0.1, 0.2))
    under_way = dataclasses.replace(windy, disturbance=begun)
    tube = rho.error_tube(under_way)
    assert (tube.gains, tube.initial, tube.grid.start) == (own, (0.1, 0.2), -1.0)
    again = from_yaml(as_yaml(under_way))
    assert again.disturbance == begun
