"""Conversion of results into the documents that the commands print with `--json`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from drake_rho.analysis.certificate import Certificate
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.cli.documents import (
    Assigned,
    AssignedRow,
    Certified,
    CertifiedRow,
    CheckRow,
    ClaimRow,
    DiagnosisPart,
    ExampleRow,
    Exported,
    Reproduced,
    SightingRow,
    Verified,
    WindowRow,
)
from drake_rho.cli.summary import errors_of
from drake_rho.exports.record import Exported as Written
from drake_rho.motion.flown import Flown
from drake_rho.paper.study import Example, Study
from drake_rho.scenario.records import Scenario
from drake_rho.verification.report import Check, Report


def verified(
    flown: Flown,
    report: Report,
    *,
    wind: str | None = None,
    file: str | None = None,
    figures: Iterable[object] = (),
) -> Verified:
    """Return the document of a plan, flight or simulation and of its report.

    Args:
        flown: the plan, flight or simulation.
        report: the report of `verify` on it.
        wind: description of the wind; None if it is not known.
        file: path of the saved result; None if it was not saved.
        figures: paths of the figures.
    """
    statistics, simulation = flown.statistics, flown.simulation
    return Verified(
        status=0 if report.ok else 1,
        kind=flown.kind,
        scenario=flown.scenario.name,
        vehicles=len(flown.scenario.vehicles),
        knots=flown.scenario.grid.knots,
        step_s=flown.scenario.grid.step,
        ok=report.ok,
        cost=flown.cost,
        seconds=statistics.seconds,
        programs=statistics.programs,
        linearisations=statistics.linearisations,
        converged=statistics.converged,
        cut=statistics.cut,
        last_fall=statistics.last_fall,
        solver=statistics.solver,
        clearance_m=_least(report, "obstacle "),
        separation_m=_least(report, "separation"),
        windows=None if flown.flight is None else len(flown.windows),
        windows_without_plan=[
            WindowRow(first_knot=each.first_knot + 1, kept=each.kept, reason=each.infeasible)
            for each in flown.windows
            if each.infeasible
        ],
        sightings=[
            SightingRow(
                obstacle=each.obstacle,
                time_s=each.time,
                avoided=each.avoided,
                planned_for=each.planned_for,
            )
            for each in report.sightings
        ],
        errors=[] if simulation is None else errors_of(simulation),
        wind=wind,
        notes=list(report.notes),
        violations=[_check(each) for each in report.violations],
        tightest=[_check(each) for each in report.tightest],
        file=file,
        figures=[str(each) for each in figures],
    )


def diagnosis_part(diagnosis: Diagnosis) -> DiagnosisPart:
    """Return the part of a document that describes a diagnosis."""
    return DiagnosisPart(
        scenario=diagnosis.scenario.name,
        feasible=diagnosis.feasible,
        conflicts={name: list(names) for name, names in diagnosis.conflicts.items()},
        violations=[_check(each) for each in diagnosis.violations],
        premise=diagnosis.premise,
        shortest_duration_s=diagnosis.shortest_duration,
        longest_duration_s=diagnosis.longest_duration,
        is_monotone=diagnosis.is_monotone,
        acceleration_factor=diagnosis.acceleration_factor,
        bearable_wind_mps2=diagnosis.bearable_wind,
        cut=diagnosis.cut,
    )


def certified(certificate: Certificate) -> Certified:
    """Return the document of a certificate."""
    return Certified(
        scenario=certificate.scenario.name,
        cost=certificate.cost,
        lower_bound=certificate.lower_bound,
        gap=certificate.gap,
        planned_gap=certificate.planned_gap,
        is_globally_optimal=certificate.is_globally_optimal,
        holds=certificate.holds,
        left_out=list(certificate.left_out),
        cut=certificate.cut,
        vehicles=[
            CertifiedRow(
                vehicle=each.vehicle,
                cost=each.cost,
                lower_bound=each.lower_bound,
                gap=each.gap,
                least_eigenvalue=each.least_eigenvalue,
            )
            for each in certificate.vehicles
        ],
    )


def assigned(
    scenario: Scenario, given: Sequence[int], efforts: tuple[float, float], file: str | None
) -> Assigned:
    """Return the document of an assignment of goals.

    Args:
        scenario: the scenario with the original goals.
        given: for each vehicle, the index of the vehicle whose goal it is given.
        efforts: least costs before and after the exchange [m²/s⁴].
        file: path of the saved scenario; None if it was not saved.
    """
    goals = [scenario.vehicles[index] for index in given]
    before, after = efforts
    return Assigned(
        scenario=scenario.name,
        effort_before=before,
        effort=after,
        vehicles=[
            AssignedRow(
                vehicle=vehicle.name, goal_of=other.name, goal_m=other.goal.position.tolist()
            )
            for vehicle, other in zip(scenario.vehicles, goals, strict=True)
        ],
        file=file,
    )


def exported(written: Written) -> Exported:
    """Return the document of an export."""
    return Exported(
        path=str(written.path),
        files=[str(each) for each in written.files],
        content=written.words,
        deviations_m=dict(zip(written.names, written.deviations.tolist(), strict=True)),
        keeps_clear=None if written.spare is None else bool(written.spare.keeps_clear),
    )


def reproduced(study: Study, figures: Iterable[object]) -> Reproduced:
    """Return the document of the paper's study and its figures."""
    return Reproduced(
        status=0 if all(each.report.ok for each in study.examples) else 1,
        examples=[_example(each, study) for each in study.examples],
        claims=[
            ClaimRow(number=each.number, claim=each.text, evidence=each.evidence, found=each.found)
            for each in study.claims
        ],
        figures=[str(each) for each in figures],
    )


def _example(example: Example, study: Study) -> ExampleRow:
    return ExampleRow(
        number=example.number,
        method=example.method,
        obstacle=example.obstacle,
        ok=example.report.ok,
        cost=example.plan.cost,
        lower_bound=example.certificate.lower_bound,
        seconds=example.seconds,
        programs=example.plan.statistics.programs,
        clearance_m=float(np.min(study.clearances_at_all_times(example))),
    )


def _check(check: Check) -> CheckRow:
    return CheckRow(
        vehicle=check.vehicle,
        constraint=check.what,
        time_s=check.time,
        value=check.value,
        limit=check.limit,
        excess=check.excess,
        errors=check.errors,
        unit=check.unit,
        holds=check.holds,
        asked=check.asked,
    )


def _least(report: Report, constraint: str) -> float | None:
    """Return the least value of the required checks whose constraint's name begins so."""
    values = (
        each.value
        for each in report.checks
        if each.asked and each.constraint.startswith(constraint)
    )
    return min(values, default=None)
