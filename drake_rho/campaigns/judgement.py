"""What a run found, judged: by `verify`, and a simulation by how its vehicles truly moved."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.assurance.report import Report
from drake_rho.assurance.verification import verify
from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.shapes import TOLERANCE


@dataclasses.dataclass(frozen=True, kw_only=True)
class Judgement:
    """How good something flown is."""

    broken: str = ""
    """the constraint that is broken most; empty if all hold"""
    cost: float
    """f (13) [m²/s⁴]"""
    obstacle_clearance: float | None = None
    """how much further from every obstacle than asked, at the least [m]; negative if too close;
    None without obstacles"""
    separation_clearance: float | None = None
    """how much further from each other than asked, at the least [m]; None if not asked"""
    tube_share: float | None = None
    """the largest error of the position over the largest radius of its tube; None if nothing
    disturbs"""
    programs: int
    """quadratic programs that were solved"""


def judge_plan(flown: Plan | Flight) -> Judgement:
    """Judge a plan, or the whole of a flight, by `verify`."""
    report = verify(flown)
    return Judgement(
        broken=_worst(report),
        cost=flown.cost,
        obstacle_clearance=_least(report, "obstacle "),
        separation_clearance=_least(report, "separation"),
        programs=flown.statistics.programs,
    )


def judge_simulation(simulation: Simulation) -> Judgement:
    """Judge the plan of every window by `verify`, and the true motion at the times of its record.

    The true motion has to keep clear of obstacles from when they are known, apart and in the tube
    around the plan in force.
    """
    scenario = simulation.scenario
    obstacles, apart = _clearance(simulation), _separation(simulation)
    share, inside = _share_of_tube(simulation)
    reports = (verify(window.plan) for window in simulation.flight.windows)
    broken = next((f"a window's {_worst(each)}" for each in reports if not each.ok), "")
    if obstacles is not None and obstacles < -_slack(simulation):
        broken = "obstacle, as flown"
    elif apart is not None and scenario.separation and apart < -scenario.separation.tolerance:
        broken = "separation, as flown"
    elif not inside:
        broken = "tube, as flown"
    return Judgement(
        broken=broken,
        cost=simulation.flight.cost,
        obstacle_clearance=obstacles,
        separation_clearance=apart,
        tube_share=share,
        programs=simulation.statistics.programs,
    )


def _worst(report: Report) -> str:
    violations = report.violations
    return f"{violations[0].constraint} of {violations[0].vehicle}" if violations else ""


def _least(report: Report, constraint: str) -> float | None:
    """The least clearance of the checks of a constraint that are asked for [m]."""
    excess = [
        check.excess
        for check in report.checks
        if check.asked and check.constraint.startswith(constraint)
    ]
    return -max(excess) if excess else None


def _clearance(simulation: Simulation) -> float | None:
    """How much further from all obstacles than asked, at the least [m]."""
    scenario, least = simulation.scenario, np.inf
    for obstacle in scenario.bodies:
        late = simulation.times >= obstacle.known_from
        centers = obstacle.centers(simulation.times[late])
        away = obstacle.shape.signed_distance(simulation.positions[late] - centers[:, None])
        left = away - scenario.fleet.radii - obstacle.deviation
        least = min(least, float(np.min(left, initial=np.inf)))
    return least if np.isfinite(least) else None


def _slack(simulation: Simulation) -> float:
    """What is put down to rounding in a distance from obstacles [m]."""
    return max(obstacle.shape.tolerance for obstacle in simulation.scenario.bodies)


def _separation(simulation: Simulation) -> float | None:
    """How much further from each other than asked, at the least [m]."""
    separation = simulation.scenario.separation
    if separation is None or len(simulation.scenario.vehicles) < 2:
        return None
    scaled = separation.scaled(simulation.positions)
    least = min(_nearest(scaled[:, i], scaled[:, i + 1 :]) for i in range(scaled.shape[1] - 1))
    return least - separation.distance


def _nearest(one: FloatArray, others: FloatArray) -> float:
    return float(np.min(np.linalg.norm(others - one[:, None], axis=2)))


def _share_of_tube(simulation: Simulation) -> tuple[float | None, bool]:
    """The largest error of the position over the largest radius; whether none is beyond its own."""
    if simulation.scenario.disturbance is None:
        return None, True
    errors, radii = simulation.errors().max(axis=1), simulation.radii()
    rounding = TOLERANCE * simulation.scenario.fleet.scale("position").max()
    share = float(errors.max() / radii.max()) if radii.max() > 0.0 else None
    return share, bool(np.all(errors <= radii + rounding))
