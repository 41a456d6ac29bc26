"""Conversion of results into the documents that the commands print with `--json`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from drake_rho.analysis.certificate import Certificate
from drake_rho.analysis.changes import NewNumbers
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.sensitivity import TimeSensitivity
from drake_rho.analysis.time_certificate import TimeCertificate
from drake_rho.cli.analysis_documents import (
    Certified,
    CertifiedRow,
    ChangeRow,
    DiagnosisPart,
    LimitRow,
    NumbersRow,
    TimeBoundRow,
    TimeCertified,
    TimeDiagnosed,
)
from drake_rho.cli.document import read_off
from drake_rho.cli.documents import (
    Assigned,
    AssignedRow,
    ClaimRow,
    ExampleRow,
    Exported,
    Reproduced,
)
from drake_rho.cli.result_documents import CheckRow, SightingRow, Verified, WindowRow
from drake_rho.cli.summary import errors_of
from drake_rho.exports.record import Exported as Written
from drake_rho.motion.flown import Flown
from drake_rho.paper.study import Example, Study
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Check
from drake_rho.verification.report import Report


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
    return read_off(
        Verified,
        statistics,
        status=0 if report.ok else 1,
        kind=flown.kind,
        scenario=flown.scenario.name,
        vehicles=len(flown.scenario.vehicles),
        knots=flown.scenario.grid.knots,
        step_s=flown.scenario.grid.step,
        ok=report.ok,
        cost=flown.cost,
        clearance_m=_least(report, "obstacles"),
        separation_m=_least(report, "separation"),
        top_speed_mps=report.summary.top_speed,
        least_effort=report.summary.least_effort,
        cost_bound=report.summary.cost_bound,
        windows=None if flown.flight is None else len(flown.windows),
        windows_without_plan=[
            read_off(WindowRow, each, first_knot=each.first_knot + 1, reason=each.infeasible)
            for each in flown.windows
            if each.infeasible
        ],
        sightings=[read_off(SightingRow, each, time_s=each.time) for each in report.sightings],
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
    return read_off(
        DiagnosisPart,
        diagnosis,
        scenario=diagnosis.scenario.name,
        conflicts={name: list(names) for name, names in diagnosis.conflicts.items()},
        violations=[_check(each) for each in diagnosis.violations],
        changes=[
            ChangeRow(numbers=[_numbers(one) for one in each.numbers]) for each in diagnosis.changes
        ],
        shortest_duration_s=diagnosis.shortest_duration,
        longest_duration_s=diagnosis.longest_duration,
        bearable_wind_mps2=diagnosis.bearable_wind,
    )


def _numbers(new: NewNumbers) -> NumbersRow:
    """Return the row of a limit's new numbers."""
    return read_off(NumbersRow, new, now=list(new.now), needed=list(new.needed))


def time_diagnosed(found: TimeSensitivity) -> TimeDiagnosed:
    """Return the document of the sensitivity of a plan's final time."""
    return read_off(
        TimeDiagnosed,
        found,
        scenario=found.scenario.name,
        duration_s=found.duration,
        limits=[read_off(LimitRow, each, vehicles=list(each.vehicles)) for each in found.limits],
    )


def certified(certificate: Certificate) -> Certified:
    """Return the document of a certificate."""
    return read_off(
        Certified,
        certificate,
        scenario=certificate.scenario.name,
        left_out=list(certificate.left_out),
        vehicles=[read_off(CertifiedRow, each) for each in certificate.vehicles],
    )


def time_certified(certificate: TimeCertificate) -> TimeCertified:
    """Return the document of a certificate of a final time."""
    return read_off(
        TimeCertified,
        certificate,
        scenario=certificate.scenario.name,
        duration_s=certificate.duration,
        bound_s=certificate.bound,
        left_out=list(certificate.left_out),
        vehicles=[
            TimeBoundRow(vehicle=each.vehicle, bound_s=each.bound) for each in certificate.vehicles
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
        claims=[read_off(ClaimRow, each, claim=each.text) for each in study.claims],
        figures=[str(each) for each in figures],
    )


def _example(example: Example, study: Study) -> ExampleRow:
    return read_off(
        ExampleRow,
        example,
        ok=example.report.ok,
        cost=example.plan.cost,
        lower_bound=example.certificate.lower_bound,
        programs=example.plan.statistics.programs,
        clearance_m=float(np.min(study.clearances_at_all_times(example))),
    )


def _check(check: Check) -> CheckRow:
    return read_off(CheckRow, check, constraint=check.what, time_s=check.time)


def _least(report: Report, kind: str) -> float | None:
    """Return the least value of the required checks of a kind."""
    values = (each.value for each in report.checks if each.asked and each.kind == kind)
    return min(values, default=None)
