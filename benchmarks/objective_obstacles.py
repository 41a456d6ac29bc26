"""Least jerk and tracking among obstacles: falling costs, bounds, and IPOPT from many starts."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from rich.progress import track

import drake_rho as rho
from benchmarks.objective_scenes import among_obstacles
from benchmarks.peers import casadi_objective
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray

STARTS = 200
"""Random starts of IPOPT on each scene."""

COLUMNS = (
    "objective",
    "scenes",
    "verified",
    "costs that rise",
    "bounds above IPOPT's least cost",
    "median gap of the bound",
    "largest gap of the bound",
    "dearer than IPOPT's least, median",
    "dearer than IPOPT's least, largest",
)


@dataclasses.dataclass(frozen=True)
class Lap:
    """One scene."""

    tracking: bool
    """whether a path is followed; least jerk otherwise"""
    ok: bool
    """whether the plan is verified"""
    rises: int
    """linearisations from a plan after which the cost had risen"""
    cost: float
    """cost of the plan [m²/s⁴]"""
    bound: float
    """lower bound of `rho.certify` [m²/s⁴]"""
    peer: float
    """least cost that IPOPT found from all starts [m²/s⁴]"""


def run(seeds: int = 60) -> Table:
    """Plan and certify `seeds` scenes, and solve each by IPOPT from many starts."""
    laps = [_lap(seed) for seed in track(range(seeds), "among obstacles")]
    jerk = [each for each in laps if not each.tracking]
    following = [each for each in laps if each.tracking]
    above = sum(each.bound > each.peer * (1.0 + 1e-6) for each in laps)
    return Table(
        name="objective_obstacles",
        title="Least jerk and tracking among obstacles",
        columns=COLUMNS,
        rows=(_row("least jerk", jerk), _row("tracking", following), _row("both", laps)),
        notes=(_WORK,),
        goals=(
            Goal("plans that are not verified", 0, sum(not each.ok for each in laps)),
            Goal("linearisations after which the cost rose", 0, sum(e.rises for e in laps)),
            Goal("bounds above a cost that IPOPT found", 0, above),
        ),
        packages=("drake-rho", "drake", "numpy", "scipy", "casadi"),
    )


def _lap(seed: int) -> Lap:
    scenario = among_obstacles(seed)
    plan, rises = rho.plan(scenario), 0
    step = plan
    for _ in range(3):
        after = rho.scp_step(step)
        rises += after.cost > step.cost * (1.0 + 1e-7)
        step = after
    return Lap(
        tracking=scenario.objective.reference is not None,
        ok=rho.verify(plan).ok,
        rises=rises,
        cost=plan.cost,
        bound=rho.certify(plan).lower_bound,
        peer=_by_ipopt(scenario, seed),
    )


def _by_ipopt(scenario: rho.Scenario, seed: int) -> float:
    """Return the least cost of IPOPT from random starts."""
    program, guess = casadi_objective.Program(scenario), rho.plan(scenario.without_obstacles())
    rng, best = np.random.default_rng([7, seed]), math.inf
    size = np.abs(guess.accelerations).max()
    for number in range(STARTS):
        bumps = _smooth(rng, scenario.grid.knots - 1) * size * (number > 0)
        start = rho.Plan.from_accelerations(scenario, guess.accelerations + bumps)
        best = min(best, program.cost_from(start))
    return best


def _smooth(rng: np.random.Generator, steps: int) -> FloatArray:
    """Return random slow accelerations, (1, K-1, 3)."""
    phases = np.pi * (np.arange(steps) + 0.5) / steps
    waves = np.sin(np.arange(1, 5)[:, None] * phases)
    return np.asarray(np.einsum("wc,wk->kc", rng.normal(size=(4, 3)), waves)[None])


def _row(kind: str, laps: list[Lap]) -> tuple[Cell, ...]:
    gaps = [1.0 - each.bound / each.cost for each in laps]
    dearer = [each.cost / each.peer - 1.0 for each in laps]
    return (
        kind,
        len(laps),
        sum(each.ok for each in laps),
        sum(each.rises for each in laps),
        sum(each.bound > each.peer * (1.0 + 1e-6) for each in laps),
        float(np.median(gaps)),
        max(gaps),
        float(np.median(dearer)),
        max(dearer),
    )


_WORK = f"""\
One vehicle, 10 m in 5 to 12 s on 41 knots past one to three balls, avoided at the knots; half with
least jerk, half along a random path through them. The cost is watched over three more
linearisations of the plan found. IPOPT avoids the balls at the knots too, from {STARTS} random
starts on each scene."""
