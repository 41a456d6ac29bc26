"""Studies for tests: small ones whose runs take milliseconds, and the rows of their stores."""

from __future__ import annotations

import dataclasses
import sqlite3
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

import drake_rho as rho

MEASURED = {"plan_seconds", "verify_seconds", "run_seconds", "megabytes", "finished"}
"""Columns of times and memory, which differ when a run is repeated."""


def small(repetitions: int = 4, **changes: Any) -> rho.Study:
    """Return two methods on two sources: a fleet of two, and one vehicle past a sphere.

    Half of the durations drawn for the vehicle past the sphere have no plan.
    """
    vehicle = {"name": "solo", "start": {"position": [0, 0, 0]}, "goal": {"position": [8, 0, 0]}}
    past = {
        "name": "past",
        "grid": {"step": 0.5, "knots": 13},
        "vehicles": [vehicle],
        "limits": {"acceleration": {"lower": [-3, -3, -3], "upper": [3, 3, 3]}},
        "obstacles": [{"center": [4, 0.5, 0], "radius": 1.0}],
    }
    fields: dict[str, Any] = {
        "name": "small",
        "scenarios": [
            {
                "name": "pair",
                "generator": "random_transitions",
                "parameters": {"n": 2, "duration": {"choice": [4.0, 5.0]}},
            },
            {
                "name": "past",
                "scenario": past,
                "vary": {
                    "grid.step": {"choice": [0.5, 0.25]},
                    "obstacles[0].center[1]": {"uniform": [-3.0, 3.0]},
                },
            },
        ],
        "methods": [
            {"name": "best", "planner": "plan"},
            {"name": "convex", "planner": "plan_convex"},
        ],
        "repetitions": repetitions,
        "seed": 7,
    }
    return rho.Study(**(fields | changes))


def own(scenario: rho.Scenario, *, megabytes: int = 0, wrong: str = "") -> rho.Plan:
    """Plan as a function that is none of the package's methods: take memory, fail as told."""
    taken = np.ones(megabytes * 2**17)
    if wrong == "late":
        raise TimeoutError(f"not done in {len(taken)} s")
    if wrong == "nothing":
        return None  # type: ignore[return-value]  # to be noticed by the campaign
    independent = rho.plan_convex(scenario.without_separation())
    if wrong == "another":
        return independent
    if wrong == "separation":
        return dataclasses.replace(independent, scenario=scenario)
    return rho.plan(scenario)


def own_trajectories(scenario: rho.Scenario, *, sampled: bool) -> rho.Trajectories:
    """Plan as another planner that returns polynomials, or too few samples to decide anything."""
    plan = rho.plan(scenario)
    if not sampled:
        return rho.Trajectories.of({name: plan.trajectory(name) for name in scenario.names})
    rows = {
        name: np.column_stack([plan.times, plan.at(plan.times, name).positions])
        for name in scenario.names
    }
    return rho.Trajectories.of_samples(rows, max_acceleration=100.0)


def held(scenario: rho.Scenario, *, until: str) -> rho.Plan:
    """Plan once a file exists."""
    while not Path(until).exists():
        time.sleep(0.01)
    return rho.plan(scenario)


def text_of(study: rho.Study) -> str:
    """Return the text of a study's file: JSON, which is YAML."""
    return TypeAdapter(rho.Study).dump_json(study, exclude_none=True).decode()


def table(path: Path, columns: tuple[str, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the rows of a store, ordered by key, by default without the measured columns."""
    connection = sqlite3.connect(path)
    if not columns:
        named = connection.execute("SELECT name FROM pragma_table_info('runs')")
        columns = tuple(name for (name,) in named if name not in MEASURED)
    query = f"SELECT {', '.join(columns)} FROM runs ORDER BY key"  # noqa: S608
    rows = connection.execute(query).fetchall()
    connection.close()
    return rows
