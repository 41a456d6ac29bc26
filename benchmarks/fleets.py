"""Planning of fleets one after another: time, memory and verdict of each."""

from __future__ import annotations

import dataclasses
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.campaigns import planned
from benchmarks.sampling import Sampled, sample
from benchmarks.stopwatch import Stopwatch, Taken
from benchmarks.tables import Cell
from drake_rho.campaigns.evaluation import evaluate
from drake_rho.campaigns.memory import peak_memory
from drake_rho.campaigns.runs import Row

SAMPLED = 1e-6
"""Violation of the separation allowed for sampled pairs [m]: the verifier's, and rounding."""

TOUCHING = 2e-6
"""Violation allowed for obstacles [m], whose extent is up to 1.25 m here, and for boxes, as a
fraction of their sides."""

THIS_PACKAGE = "this package"


@dataclasses.dataclass(frozen=True)
class Trial:
    """One fleet, planned or not."""

    name: str
    """name of its scenario"""
    vehicles: int
    """number of vehicles"""
    seconds: float
    """wall time from the scenario record to the verified plan, or to the failure [s]"""
    megabytes: float
    """largest memory of the process until then [MB]"""
    processor: float = np.nan
    """processor time of planning [s]"""
    index: float = np.nan
    """f (13) [m²/s⁴]; NaN without a plan"""
    sampled: Sampled | None = None
    """evaluation of dense samples of the plan; None without a plan"""
    fault: str = ""
    """reason why the plan does not count; empty if it does"""
    bound: float = np.nan
    """lower bound of the index of any plan [m²/s⁴]; NaN if not requested, or not found"""

    @property
    def counts(self) -> bool:
        """True if there is a plan that satisfies every constraint."""
        return not self.fault

    @property
    def metres(self) -> float:
        """Total distance flown [m]; NaN if there is no plan."""
        return np.nan if self.sampled is None else self.sampled.metres

    @property
    def gap(self) -> float:
        """Gap between index and bound, over the index; NaN if one is unknown."""
        return 1.0 - self.bound / self.index


Planner = Callable[[rho.Scenario], rho.Plan]
Bound = Callable[[rho.Plan], float]


def unbounded(plan: rho.Plan) -> float:
    """Return no bound on the index of the plan's scenario."""
    return np.nan


def attempt(
    scenario: rho.Scenario,
    planner: Planner = rho.plan_scp,
    bound: Bound = unbounded,
    memory: Callable[[], float] = peak_memory,
) -> Trial:
    """Plan a fleet, and verify the plan by the package's verifier and by dense samples.

    Samples are not used for scenarios that constrain the knots only.

    Args:
        scenario: the scenario to be planned.
        planner: planner; one that gives up in time raises `TimeoutError`.
        bound: lower bound on the index, computed for plans that count; not timed.
        memory: function that returns the largest memory of all planning processes so far [MB].
    """
    watch, plan = Stopwatch(), None
    try:
        plan = planner(scenario)
        processor = watch.taken().processor
        broken = evaluate(plan).violated
    except (rho.InfeasibleError, rho.SolverError, TimeoutError) as error:
        plan, broken = None, f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')}"
        processor = watch.taken().processor
    return _trial(scenario, plan, broken, Taken(watch.taken().wall, processor), memory(), bound)


def _trial(
    scenario: rho.Scenario,
    plan: rho.Plan | None,
    broken: str,
    taken: Taken,
    megabytes: float,
    bound: Bound,
) -> Trial:
    """Return the trial of a fleet, evaluated by samples too.

    `broken` is the violated constraint, or the reason why there is no plan; `taken` has the wall
    time with `verify`, and the processor time without.
    """
    reported = scenario.name, len(scenario.vehicles), taken.wall, megabytes, taken.processor
    if plan is None:
        return Trial(*reported, fault=broken)
    found = sample(plan)
    fault = f"{broken} is violated" if broken else ""
    fault = fault or (_fault(found, scenario) if scenario.between_knots else "")
    return Trial(*reported, plan.cost, found, fault, np.nan if fault else bound(plan))


def _fault(found: Sampled, scenario: rho.Scenario) -> str:
    """Describe the violation found by the samples; empty if there is none."""
    separation = scenario.separation
    if separation is not None and found.least < separation.distance - SAMPLED:
        return f"two vehicles are {found.least:.7g} m apart at the samples"
    if found.clearance < -TOUCHING:
        return f"an obstacle is {-found.clearance:.7g} m too close at the samples"
    if found.beyond > TOUCHING:
        return f"a box is left by {found.beyond:.2g} of its side at the samples"
    return ""


def attempts(
    makes: Iterable[Callable[[], rho.Scenario]],
    what: str,
    planner: Planner = rho.plan_scp,
    bound: Bound = unbounded,
    stores: Path | None = None,
) -> list[Trial]:
    """Plan fleets one after another as a campaign; evaluate the plans when all are there.

    Args:
        makes: functions that create the scenarios.
        what: their description, for `planned`.
        planner: planner, for `planned`.
        bound: lower bound on the index, as in `attempt`.
        stores: folder from which an interrupted campaign resumes, for `planned`.
    """
    given = [make() for make in makes]
    done = planned(given, what, planner, stores)
    return [_of_run(each, *found, bound) for each, found in zip(given, done, strict=True)]


def _of_run(
    scenario: rho.Scenario, row: Row, plan: rho.Plan | None, processor: float, bound: Bound
) -> Trial:
    broken = row.reason if plan is not None else f"{row.status}: {row.reason}"
    wall = (row.plan_seconds or 0.0) + (row.verify_seconds or 0.0)
    return _trial(scenario, plan, broken, Taken(wall, processor), row.megabytes or np.nan, bound)


COLUMNS = (
    "vehicles",
    "method",
    "fleets",
    "success_percent",
    "median_processor_s",
    "median_wall_s",
    "worst_wall_s",
    "mean_index",
    "mean_distance_m",
    "peak_megabytes",
)
"""Columns of tables with a row for each size of fleet. Wall times include `verify`, processor times
are of planning alone."""


def summary(trials: Sequence[Trial], method: str = THIS_PACKAGE) -> tuple[Cell, ...]:
    """Return the row of one size; times are of all fleets, the rest of those that count."""
    good = [trial for trial in trials if trial.counts]
    seconds = [trial.seconds for trial in trials]
    return (
        trials[0].vehicles,
        method,
        len(trials),
        percent(trials),
        statistics.median(trial.processor for trial in trials),
        statistics.median(seconds),
        max(seconds),
        statistics.fmean(trial.index for trial in good) if good else None,
        statistics.fmean(trial.metres for trial in good) if good else None,
        max(trial.megabytes for trial in trials),
    )


def percent(trials: Sequence[Trial]) -> float:
    """Return the percentage of fleets that count."""
    return 100.0 * sum(trial.counts for trial in trials) / len(trials)


def findings(trials: Sequence[Trial]) -> str:
    """Return a note on the fleets that do not count, and on the slowest."""
    slowest = max(trials, key=lambda trial: trial.seconds)
    reported = [f"The slowest: {slowest.name}, {slowest.seconds:.3g} s."]
    reported += [f"- {trial.name}: {trial.fault}" for trial in trials if not trial.counts]
    if len(reported) == 1:
        return f"Every fleet was planned and satisfies every constraint. {reported[0]}"
    reported[1:1] = ["", "Fleets without a plan that satisfies every constraint:", ""]
    return "\n".join(reported)
