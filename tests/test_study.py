"""Studies: distributions, dependences of runs, and refused input."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

import drake_rho as rho
from drake_rho.campaigns.distributions import AnyDistribution
from drake_rho.campaigns.runs import do, generators
from drake_rho.campaigns.sources import FromFile, Generated, Given
from drake_rho.campaigns.study import (
    continues,
    example_study,
    study_from_yaml,
    study_schema,
)
from tests.scenarios import single
from tests.studies import small, text_of


@pytest.mark.parametrize(
    ("described", "mean", "deviation"),
    [
        ({"uniform": [2.0, 5.0]}, 3.5, 3.0 / np.sqrt(12.0)),
        ({"uniform": [[0.0, 2.0], [1.0, 2.0]]}, [0.5, 2.0], [1.0 / np.sqrt(12.0), 0.0]),
        ({"normal": [1.0, 0.5]}, 1.0, 0.5),
        ({"normal": [[1.0, -2.0], [0.0, 3.0]]}, [1.0, -2.0], [0.0, 3.0]),
        ({"log_uniform": [1.0, np.e]}, np.e - 1.0, np.sqrt((np.e**2 - 1) / 2 - (np.e - 1) ** 2)),
        ({"integers": [1, 3]}, 2.0, np.sqrt(2.0 / 3.0)),
        ({"choice": [1.0, 5.0]}, 3.0, 2.0),
    ],
)
def test_draws_have_the_moments_of_their_distribution(
    described: dict[str, Any], mean: Any, deviation: Any
) -> None:
    rng, kind = np.random.default_rng(0), TypeAdapter(AnyDistribution)
    distribution = kind.validate_python(described)
    drawn = np.array([distribution.draw(rng) for _ in range(20_000)])
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=0.03)
    np.testing.assert_allclose(drawn.std(axis=0), deviation, atol=0.03)


def test_only_the_drawn_field_is_changed() -> None:
    base = single(obstacles=[rho.Sphere([5.0, 2.0, -1.0], 0.5)])
    source = Given(
        "shaken",
        base,
        {
            "vehicles[0].start.position": {"uniform": [[-1, -1, 0], [1, 1, 0]]},
            "obstacles[0].radius": {"uniform": [0.2, 0.4]},
            "disturbance": {"choice": [{"acceleration": 0.1}]},
        },
    )
    drawn = [source.drawn(np.random.default_rng(seed)) for seed in range(5)]
    starts = np.array([each.vehicles[0].start.position for each in drawn])
    assert np.all(np.abs(starts[:, :2]) <= 1.0)
    assert np.all(starts[:, 2] == 0.0)
    assert len({tuple(start) for start in starts}) == 5
    for each in drawn:
        assert each.disturbance == rho.Disturbance(0.1)
        (sphere,) = each.spheres
        assert 0.2 <= sphere.radius <= 0.4
        back = dataclasses.replace(
            each, vehicles=base.vehicles, obstacles=base.obstacles, disturbance=None
        )
        assert back == base


def test_an_offset_is_added_to_the_given_value() -> None:
    base = single(obstacles=[rho.Sphere([5.0, 2.0, -1.0], 0.5)])
    center = "obstacles[0].center"
    shifted = Given(
        "shifted",
        base,
        vary={f"{center}[0]": {"choice": [6.0]}},
        offset={
            center: {"uniform": [[-1, -2, 0], [1, 2, 0]]},
            f"{center}[2]": {"choice": [0.25]},
            "grid.knots": {"integers": [1, 2]},
        },
    )
    drawn = [shifted.drawn(np.random.default_rng(seed)) for seed in range(20)]
    centers = np.array([each.spheres[0].center for each in drawn])
    away = centers - [6.0, 2.0, -0.75]  # `vary` first, then the offsets in order
    assert np.all(np.abs(away) <= [1.0, 2.0, 1e-12])
    assert np.all(np.ptp(away[:, :2], axis=0) > 0.5)
    assert {each.grid.knots - base.grid.knots for each in drawn} == {1, 2}
    for each in drawn:
        assert dataclasses.replace(each, grid=base.grid, obstacles=base.obstacles) == base


def test_parameters_of_generators_and_records_may_be_drawn() -> None:
    source = Generated(
        "some",
        "random_transitions",
        {"n": {"integers": [2, 4]}, "volume": rho.flight_cube(8.0), "separation": None},
    )
    drawn = [source.drawn(np.random.default_rng(seed)) for seed in range(20)]
    assert {len(each.vehicles) for each in drawn} == {2, 3, 4}
    assert all(each.separation is None for each in drawn)
    assert all(each.limits.position == rho.flight_cube(8.0) for each in drawn)


def test_seeds_are_those_of_spawning() -> None:
    children = np.random.SeedSequence(9).spawn(4)[3].spawn(6)[5].spawn(2)
    for child, made in zip(children, generators((9, 3, 5)), strict=True):
        expected = np.random.default_rng(child).random(4)
        np.testing.assert_array_equal(made.random(4), expected)


def test_a_run_depends_only_on_its_key() -> None:
    runs = list(small(2).runs())
    forwards = [do(run).row for run in runs]
    backwards = [do(run).row for run in reversed(runs)][::-1]
    for one, other in zip(forwards, backwards, strict=True):
        assert (one.key, one.status, one.reason, one.cost) == (
            other.key,
            other.status,
            other.reason,
            other.cost,
        )
    assert len({run.key for run in runs}) == len(runs) == len(small(2))
    of_pairs = [row.cost for row in forwards if row.scenario == "pair" and row.method == "best"]
    assert len(set(of_pairs)) == 2


def test_methods_are_given_the_same_scenarios() -> None:
    by_place: dict[tuple[str, str], set[tuple[int, int, int]]] = {}
    for run in small(3).runs():
        by_place.setdefault((run.scenario, run.method), set()).add(run.seed)
    assert by_place["pair", "best"] == by_place["pair", "convex"]
    assert not by_place["pair", "best"] & by_place["past", "best"]


@given(st.integers(0, 3), st.booleans(), st.booleans())
def test_an_extended_study_has_all_runs_of_the_original(
    more: int, scenario: bool, method: bool
) -> None:
    before = small(2)
    grown = dataclasses.replace(
        before,
        repetitions=2 + more,
        scenarios=(*before.scenarios, Generated("new", "circle_swap", _CIRCLE))
        if scenario
        else before.scenarios,
        methods=(study_from_yaml(example_study()).methods[2], *before.methods)
        if method
        else before.methods,
    )
    keys = [{run.key for run in each.runs()} for each in (before, grown)]
    assert keys[0] <= keys[1]
    texts = [text_of(each.resolved()) for each in (before, grown)]
    assert continues(texts[1], texts[0])
    assert continues(texts[0], texts[1]) == (not (more or scenario or method))


_CIRCLE = {"n": 3, "radius": 2.0, "duration": 4.0, "step": 0.5}


@pytest.mark.parametrize("other", [small(2, seed=8), small(2, plans=True), small(1)])
def test_a_different_study_does_not_resume_a_campaign(other: rho.Study) -> None:
    assert not continues(text_of(other), text_of(small(2)))


def test_stored_campaigns_that_fly_in_windows_keep_their_keys() -> None:
    """Keys are hashes of a method's JSON, and so depend on the order of its fields."""
    flown = {"name": "m", "latency": 0.2, "reference": "tail", "options": {"max_iterations": 5}}
    own: dict[str, dict[str, Any]] = {
        "plan_rho": {"certify": True},
        "simulate": {"wind": {"wind": "constant"}},
    }
    orders = [
        list(json.loads(next(study.runs()).method_json))[5:]
        for study in (small(methods=[{"planner": each, **flown, **own[each]}]) for each in own)
    ]
    assert [" ".join(order) for order in orders] == [
        "reference solver contingencies bounded_cost certify latency options",
        "wind estimates contingencies bounded_cost latency reference options",
    ]


def test_the_example_is_a_study_that_its_schema_accepts() -> None:
    study = study_from_yaml(example_study()).resolved()
    assert len(study) == sum(1 for _ in study.runs()) >= 100
    jsonschema.validate(yaml.safe_load(example_study()), study_schema())


def test_files_of_a_study_are_relative_to_it(tmp_path: Path) -> None:
    rho.save_scenario(single(), tmp_path / "own.yaml")
    text = (
        "name: s\nscenarios: [{name: a, file: own.yaml}, {name: b, file: paper}]\n"
        "methods: [{name: m, planner: plan}]\n"
    )
    (tmp_path / "study.yaml").write_text(text)
    first, second = rho.load_study(tmp_path / "study.yaml").scenarios
    assert isinstance(first, Given)
    assert first.scenario == single()
    assert isinstance(second, Given)
    assert second.scenario == rho.load_scenario("paper")


def _function(name: str, **arguments: Any) -> dict[str, Any]:
    return {"name": "m", "planner": "function", "function": name, "arguments": arguments}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seeed": 1}, "study.seeed: got 1, expected no field of this name; did you mean seed?"),
        ({"repetitions": 0}, "study.repetitions: got 0, expected greater than or equal to 1"),
        ({"methods": []}, "study.methods: got [], expected"),
        (
            {"methods": [{"name": "m", "planner": "plann"}]},
            "study.methods[0].planner: got 'plann', expected one of plan, plan_convex, plan_rho, "
            "plan_minimum_time, simulate, function; did you mean plan?",
        ),
        (
            {"methods": [{"name": "m"}]},
            "study.methods[0].planner: got nothing, expected one of plan, plan_convex, plan_rho",
        ),
        (
            {"methods": [{"name": "m", "planner": "simulate", "wind": {"wind": "gusts"}}]},
            "study.methods[0].wind.wind: got 'gusts', expected one of constant, gust, "
            "coloured_noise; did you mean gust?",
        ),
        (
            {"methods": [{"name": "m", "planner": "plan", "solver": "gurobi"}]},
            "study.methods[0].solver: got 'gurobi', expected 'clarabel', 'daqp' or 'osqp'",
        ),
        (
            {"methods": [{"name": "m", "planner": "plan", "tolerance": 1}]},
            "study.methods[0].tolerance: got 1, expected no field of this name",
        ),
        (
            {"methods": [_function("drake_rho:plann")]},
            "function: got 'drake_rho:plann', expected a function that can be imported, as "
            "package.module:function; AttributeError:",
        ),
        (
            {"methods": [_function("nowhere.planners:mine")]},
            "package.module:function; ModuleNotFoundError: No module named 'nowhere'",
        ),
        ({"methods": [_function("<lambda>")]}, "function: got '<lambda>', expected a function"),
        ({"methods": [_function("drake_rho:__version__")]}, "expected a function that can be"),
        (
            {"methods": [_function("drake_rho:plan_convex", tolerance=1)]},
            "arguments: got {'tolerance': 1}, expected those that the function takes after the "
            "scenario; got an unexpected keyword argument 'tolerance'",
        ),
        (
            {"scenarios": [{"name": "a", "generator": "random_transitions"}]},
            "study.scenarios[0].parameters: got {}, expected",
        ),
        (
            {
                "scenarios": [
                    {"name": "a", "generator": "random_field", "parameters": {"obstacle": 3}}
                ]
            },
            "parameters.obstacle: got 3, expected no parameter of this name for random_field; did "
            "you mean obstacles?",
        ),
        (
            {"scenarios": [{"name": "a", "file": "paper", "vary": {"grid.stp": {"choice": [1]}}}]},
            "study.scenarios[0].vary: got 'grid.stp', expected a field that exists: grid has step, "
            "knots, start; did you mean step?",
        ),
        (
            {
                "scenarios": [
                    {"name": "a", "file": "paper", "vary": {"vehicles[4]": {"choice": [1]}}}
                ]
            },
            "vary: got 'vehicles[4]', expected a field that exists: vehicles has 4 entries",
        ),
        (
            {
                "scenarios": [
                    {"name": "a", "file": "paper", "offset": {"limits.velocty": {"choice": [1]}}}
                ]
            },
            "study.scenarios[0].offset: got 'limits.velocty', expected a field that exists",
        ),
        (
            {
                "scenarios": [
                    {"name": "a", "file": "paper", "offset": {"vehicles[0].name": {"choice": [1]}}}
                ]
            },
            "offset: got 'vehicles[0].name', expected the path of a number or of a list of "
            "numbers; 'UAV-1' stands there",
        ),
        (
            {
                "scenarios": [
                    {
                        "name": "a",
                        "file": "paper",
                        "offset": {"vehicles[0].start.position": {"choice": [50.0]}},
                    }
                ]
            },
            "study.scenarios[0].offset.vehicles[0].start.position: got 50.0, expected a list of 3 "
            "numbers, as the field to which it is added",
        ),
        (
            {"scenarios": [{"name": "a", "file": "paper", "vary": {"name": {"unifrm": [0, 1]}}}]},
            "expected a distribution: a mapping with one of uniform, log_uniform, normal",
        ),
        (
            {"scenarios": [{"name": "a", "file": "paper", "vary": {"name": {"uniform": [1, 0]}}}]},
            "uniform: got [1.0, 0.0], expected the lower end first",
        ),
        (
            {"scenarios": [{"name": "a", "file": "papr"}]},
            "study.scenarios[0].scenario: got 'papr', expected a library scenario",
        ),
        (
            {"scenarios": [{"name": "a", "file": "paper"}, {"name": "a", "file": "paper"}]},
            "study.scenarios[1].name: got 'a', expected a name of its own",
        ),
    ],
)
def test_invalid_arguments_are_refused_by_name(change: dict[str, Any], words: str) -> None:
    content = {
        "name": "s",
        "scenarios": [{"name": "a", "file": "paper"}],
        "methods": [{"name": "m", "planner": "plan"}],
    }
    with pytest.raises(rho.ScenarioError) as refused:
        study_from_yaml(yaml.safe_dump(content | change)).resolved()
    assert words.removeprefix("study.") in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_mission_needs_a_grid_in_the_study(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text('{"agents": []}')
    with pytest.raises(rho.ScenarioError, match=re.escape("a duration and a step")):
        FromFile("a", "m.json").given(tmp_path)
