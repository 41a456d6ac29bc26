"""What a run found, judged by `verify`: of a simulation, how its vehicles truly moved."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.plan import Flight, Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.verification.report import Report
from drake_rho.verification.verify import verify


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
    """the largest error of the position over the radius of its tube then; None if nothing
    disturbs"""
    programs: int
    """quadratic programs that were solved"""


def judge(flown: Plan | Flight | Simulation) -> Judgement:
    """Judge a plan, the whole of a flight, or the true motion of a simulation, by `verify`."""
    report, simulation = verify(flown), flown if isinstance(flown, Simulation) else None
    return Judgement(
        broken=_worst(report),
        cost=flown.flight.cost if isinstance(flown, Simulation) else flown.cost,
        obstacle_clearance=_least(report, "obstacle "),
        separation_clearance=_least(report, "separation"),
        tube_share=None if simulation is None else _share_of_tube(simulation),
        programs=flown.statistics.programs,
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


def _share_of_tube(simulation: Simulation) -> float | None:
    """The largest error of the position over the radius of its tube then; None without a tube."""
    if simulation.scenario.disturbance is None:
        return None
    errors, radii = simulation.errors().max(axis=1), simulation.radii()
    wide = radii > 0.0
    return float(np.max(errors[wide] / radii[wide], initial=0.0))
