"""Evaluation of a run's plan, flight or simulation by `verify`."""

from __future__ import annotations

import dataclasses

from drake_rho.motion.flown import Flown
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.tube_shares import largest_shares
from drake_rho.verification.report import Report
from drake_rho.verification.verify import verify


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Measures of a plan, flight or simulation."""

    violated: str = ""
    """constraint with the worst violation, or one that is undecided; empty if all hold"""
    cost: float
    """cost f (13) [m²/s⁴]"""
    duration: float
    """time from the first knot to the last [s]"""
    obstacle_clearance: float | None = None
    """least distance from an obstacle beyond the required distance [m]; negative if too close;
    None without obstacles"""
    separation_clearance: float | None = None
    """least distance between vehicles beyond the required separation [m]; negative if too close;
    None without a separation"""
    tube_share: float | None = None
    """largest ratio of position error to tube radius; None for a plan or a flight, or without a
    disturbance"""
    largest_deviation: float | None = None
    """largest deviation of measured positions from the planned motion [m]; None without
    measurements"""
    measured_clearance: float | None = None
    """least distance of measured positions from an obstacle beyond the required distance [m];
    negative if too close; None without obstacles or measurements"""
    without_contingency: int | None = None
    """number of windows without a contingency; None if contingencies are off"""
    programs: int
    """number of quadratic programs solved"""


def evaluate(flown: Flown) -> Evaluation:
    """Evaluate a plan, a flight as flown, or the true motion of a simulation."""
    report, simulation = verify(flown), flown.simulation
    deviation = report.summary.largest_deviation
    return Evaluation(
        violated=_worst(report),
        cost=flown.cost,
        duration=flown.scenario.grid.duration,
        obstacle_clearance=_least(report, "obstacles"),
        separation_clearance=_least(report, "separation"),
        tube_share=None if simulation is None else _share_of_tube(simulation),
        largest_deviation=None if deviation is None else deviation.position,
        measured_clearance=_least(report, "obstacles", measured=True),
        without_contingency=_without_contingency(flown),
        programs=flown.statistics.programs,
    )


def _worst(report: Report) -> str:
    wrong, word = report.violations, ""
    if not wrong and report.undecided:
        wrong, word = report.undecided, ", undecided"
    return f"{wrong[0].constraint} of {wrong[0].vehicle}{word}" if wrong else ""


def _least(report: Report, kind: str, *, measured: bool = False) -> float | None:
    """Return the least clearance over the required checks of a kind [m].

    Args:
        report: the report.
        kind: kind of the checks.
        measured: whether it is that of measured samples, not of the motion.
    """
    checks = [each for each in report.checks if each.kind == kind and each.asked]
    excess = [check.excess for check in checks if check.is_measured == measured]
    return -max(excess) if excess else None


def _share_of_tube(simulation: Simulation) -> float | None:
    """Return the largest ratio of position error to tube radius; None without a tube."""
    if simulation.scenario.disturbance is None:
        return None
    return float(largest_shares(simulation.errors(), simulation.radii()).max())


def _without_contingency(flown: Flown) -> int | None:
    """Return the number of windows without a contingency; None if contingencies are off."""
    windows = () if flown.flight is None else flown.flight.windows
    missing = [window.contingency is None for window in windows]
    are_used = not all(missing) or any(window.no_contingency for window in windows)
    return sum(missing) if are_used else None
