"""Large fleets, one vehicle in every cubic metre: how long they take, with each of two solvers."""

from __future__ import annotations

from functools import partial

import numpy as np

import drake_rho as rho
from benchmarks.fleet_b2 import LARGEST, LONGER, scenario
from benchmarks.fleets import COLUMNS, Planner, Trial, attempts, summary
from benchmarks.tables import Goal, Table

VEHICLES = (200, LARGEST)
"""Sizes, all with the flight time of the largest."""


def run() -> Table:
    """Plan a fleet of each size with each solver, and verify it."""
    planners: dict[str, Planner] = {"Clarabel": rho.plan, "Daqp": with_daqp}
    found = {
        name: [_planned(count, name, planner) for count in VEHICLES]
        for name, planner in planners.items()
    }
    exponents = {name: _exponent(*trials) for name, trials in found.items()}
    return Table(
        name="scale_fleets",
        title="Large fleets, one vehicle in every cubic metre",
        columns=COLUMNS,
        rows=tuple(summary([each], name) for name, trials in found.items() for each in trials),
        notes=(_ABOUT,),
        goals=(
            Goal("1000 vehicles with Clarabel [s]", 25.0, found["Clarabel"][-1].seconds),
            Goal("1000 vehicles with Daqp [s]", 10.0, found["Daqp"][-1].seconds),
            Goal(
                "fleets without a plan that holds",
                0.0,
                float(sum(not each.counts for trials in found.values() for each in trials)),
            ),
            Goal("exponent in the number of vehicles, Clarabel", 1.15, exponents["Clarabel"]),
            Goal("exponent in the number of vehicles, Daqp", 1.15, exponents["Daqp"]),
        ),
    )


def with_daqp(scenario: rho.Scenario) -> rho.Plan:
    """`rho.plan` with DAQP for its programs."""
    return rho.plan(scenario, solver=rho.Daqp())


def _planned(count: int, name: str, planner: Planner) -> Trial:
    (trial,) = attempts([partial(scenario, count, 0, LONGER)], f"{count} with {name}", planner)
    return trial


def _exponent(small: Trial, large: Trial) -> float:
    """By what power of the number of vehicles the time grows."""
    more = np.log(large.vehicles / small.vehicles)
    return float(np.log(large.seconds / small.seconds) / more)


_ABOUT = f"""\
Random transitions in a cube with a cubic metre for each vehicle, in {LONGER:g} s, by `rho.plan`
with each solver for its programs; times are from the scenario to the verified plan, memory is that
of the process. Plans are judged by dense samples as well."""
