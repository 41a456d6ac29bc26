"""Reports on plans, flights and simulations: verification and computational effort."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from drake_rho.cli.checks import Drawing
from drake_rho.cli.console import columns, plain_table, tell, working
from drake_rho.cli.documents import content_of
from drake_rho.cli.summary import errors_of, simulation_text
from drake_rho.motion.files import save
from drake_rho.motion.flight import Window
from drake_rho.motion.flown import Planned
from drake_rho.shows.certificate import ShowCertificate
from drake_rho.verification.printed import TEXTS, Printed
from drake_rho.verification.report import Report
from drake_rho.verification.verify import verify

VIOLATED, UNDECIDED = 1, 6
"""Exit statuses after a report that is not all right."""


def finish(
    flown: Planned,
    output: str | None = None,
    drawing: Drawing | None = None,
    wind: str | None = None,
    *,
    every_row: bool = False,
    certificate: ShowCertificate | None = None,
) -> int:
    """Save, draw and verify a result, print the report and return the exit status.

    A result that violates constraints is saved and drawn too. The status is then 1, otherwise 0.

    Args:
        flown: the plan, flight or simulation.
        output: file to save it to, if any.
        drawing: figures to draw, if any.
        wind: description of the wind, if any.
        every_row: whether to print every row of the report.
        certificate: bounds of a show's assignment and times, if it is one.
    """
    if output is not None:  # before anything is printed: a closed pipe must not lose the work
        save(flown, output)
    drawn = list[Path]()
    if drawing is not None:
        # importing matplotlib takes longer than most commands
        from drake_rho.display.plots.figures import write_figures

        with working("drawing"):
            drawn = write_figures(
                flown, drawing.folder, file_format=drawing.file_format, width=drawing.width
            )
    written = [f"saved to {output}"] if output is not None else []
    if drawing is not None:
        written += [f"{', '.join(path.name for path in drawn)} in {drawing.folder}"]
    with working("verifying"):
        report = verify(flown)
    document = _document(flown, report, wind, output, drawn) | {"certificate": certificate}
    heading = [f"wind: {wind}"] if wind is not None else []
    text = list(_text(flown, report.printed(every_row=every_row)))
    if certificate is not None:
        text = [*text, "", str(certificate)]
    return tell(document, *heading, *text, *written, status=_exit_status(report))


def finish_trajectories(report: Report, *, every_row: bool = False) -> int:
    """Print the report on trajectories of another program and return the exit status.

    Args:
        report: the report.
        every_row: whether to print every row of it.
    """
    document = {
        "kind": "trajectories",
        "scenario": report.scenario,
        "vehicles": len(report.scenario.vehicles),
        "ok": report.ok,
        "cost": report.summary.cost,
        "clearance_m": _least(report, "obstacles"),
        "separation_m": _least(report, "separation"),
        **content_of(report.summary),
        "notes": report.notes,
        "violations": report.violations,
        "undecided": report.undecided,
        "tightest": report.tightest,
    }
    text = _report(report.printed(every_row=every_row))
    return tell(document, *text, status=_exit_status(report))


def _exit_status(report: Report) -> int:
    """Return the exit status of a report: all holds, is violated, or is undecided at most."""
    if report.ok:
        return 0
    return VIOLATED if report.violations else UNDECIDED


def _document(
    flown: Planned, report: Report, wind: str | None, file: str | None, figures: list[Path]
) -> dict[str, object]:
    """Return the document of a plan, flight or simulation and of its report."""
    scenario = flown.scenario
    return {
        "kind": flown.kind,
        "scenario": scenario,
        "vehicles": len(scenario.vehicles),
        "knots": scenario.grid.knots,
        "step_s": scenario.grid.step,
        "ok": report.ok,
        "cost": flown.cost,
        **content_of(flown.statistics),
        "clearance_m": _least(report, "obstacles"),
        "separation_m": _least(report, "separation"),
        **content_of(report.summary),
        "windows": None if flown.flight is None else len(flown.windows),
        "windows_without_plan": [
            {**content_of(each), "first_knot": each.first_knot + 1}
            for each in flown.windows
            if each.infeasible
        ],
        "sightings": report.sightings,
        "errors": [] if flown.simulation is None else errors_of(flown.simulation),
        "wind": wind,
        "notes": report.notes,
        "violations": report.violations,
        "tightest": report.tightest,
        "file": file,
        "figures": figures,
    }


def _least(report: Report, kind: str) -> float | None:
    """Return the least value of a kind of required checks; measured samples do not count."""
    checks = [each for each in report.checks if each.kind == kind and not each.is_measured]
    return min((each.value for each in checks if each.asked), default=None)


def _text(flown: Planned, printed: Printed) -> Iterator[str | Table]:
    """Yield the report, then the work of planning, or the errors of a simulation."""
    yield from _report(printed)
    if flown.simulation is not None:
        yield from _windows_without_plan(flown.windows)
        yield from simulation_text(flown.simulation)
        return
    numbers = flown.statistics
    yield (
        f"planned in {numbers.seconds:.3f} s: {numbers.programs} programs, "
        f"{numbers.solver or 'no solver'}; step {flown.scenario.grid.step:g} s"
    )
    if numbers.minimised == "time" and numbers.time_bound is None:
        yield "`drake-rho certify --time` bounds the gap to the least time"
    if flown.flight is not None:
        without = sum(bool(window.infeasible) for window in flown.windows)
        yield f"{len(flown.windows)} windows, {without} of them without a plan of their own"
        yield from _windows_without_plan(flown.windows)
    if numbers.tolerance is not None and numbers.converged:
        digits = math.floor(-math.log10(numbers.tolerance) + 1e-9)
        yield f"converged: the cost has settled to {digits} digits"
    if numbers.cut:
        last = "no linearisation had lowered it yet"
        if numbers.last_fall is not None:
            last = f"the last linearisation lowered it by {100 * numbers.last_fall:.2g} %"
        yield f"cut: time ended before the cost converged; {last}"
    elif not numbers.converged:
        yield "not converged: the iteration stopped before the cost converged"


def _report(printed: Printed) -> Iterator[str | Table]:
    """Yield the report as text, or as tables that fit a narrower screen."""
    text = str(printed)
    if max(map(len, text.splitlines())) <= columns():
        yield text
        return
    facts = plain_table()
    for fact in printed.facts:
        facts.add_row(*map(escape, fact))
    table = plain_table(*printed.heads, texts=TEXTS)
    for row in printed.rows:
        table.add_row(*map(escape, row))
    yield printed.title
    yield facts
    yield table
    yield from printed.below


def _windows_without_plan(windows: Sequence[Window]) -> Iterator[str]:
    """Yield a line for each window without its own plan: the plan flown instead, and the reason."""
    for window in windows:
        if window.infeasible:
            flown = "previous plan" if window.kept else "least-violation motion"
            flown = "contingency" if window.stopping else flown
            yield f"  from knot {window.first_knot + 1}, {flown}: {window.infeasible}"
        if window.no_contingency:
            yield f"  from knot {window.first_knot + 1}, no contingency: {window.no_contingency}"
