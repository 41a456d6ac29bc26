"""Reports on plans, flights and simulations: their verification and the work they took."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.markup import escape
from rich.table import Table

from drake_rho.cli import described
from drake_rho.cli.checks import Drawing
from drake_rho.cli.console import out, tell, working
from drake_rho.cli.summary import simulation_table
from drake_rho.motion.files import save
from drake_rho.motion.flight import Window
from drake_rho.motion.flown import Flown
from drake_rho.verification.report import Report, verdict
from drake_rho.verification.verify import verify


def finish(
    flown: Flown, output: str | None, drawing: Drawing | None, wind: str | None = None
) -> int:
    """Save, draw and verify a result, print the report and return the exit status.

    A result that violates constraints is saved and drawn too. The status is 0 if it holds, else 1.

    Args:
        flown: the plan, flight or simulation.
        output: file to save it to, if any.
        drawing: figures to draw, if any.
        wind: description of the wind, if any.
    """
    if output is not None:  # before anything is printed: a closed pipe must not lose the work
        save(flown, output)
    drawn = []
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
        verified = verify(flown)
    document = described.verified(flown, verified, wind=wind, file=output, figures=drawn)
    heading = [f"wind: {wind}"] if wind is not None else []
    return tell(document, *heading, *_text(flown, verified), *written)


def report(flown: Flown) -> int:
    """Verify a result, print the report and return the exit status, 0 if it holds, else 1."""
    return finish(flown, None, None)


def _text(flown: Flown, verified: Report) -> Iterator[str | Table]:
    """Yield the report, then the cost and the work of planning, or the errors of a simulation."""
    yield from _report(verified)
    if flown.simulation is not None:
        yield from _windows_without_plan(flown.windows)
        yield simulation_table(flown.simulation)
        return
    numbers = flown.statistics
    yield (
        f"cost {flown.cost:.6f} m²/s⁴; step {flown.scenario.grid.step:g} s; "
        f"{numbers.programs} programs, {numbers.seconds:.3f} s, {numbers.solver or 'no solver'}"
    )
    if flown.flight is not None:
        without = sum(bool(window.infeasible) for window in flown.windows)
        yield f"{len(flown.windows)} windows, {without} of them without a plan of their own"
        yield from _windows_without_plan(flown.windows)
    if numbers.tolerance is not None and numbers.converged:
        decrease = f"less than {100 * numbers.tolerance:g} %"
        yield f"converged: the last linearisation lowered the cost by {decrease}"
    if numbers.cut:
        last = "no linearisation had lowered it yet"
        if numbers.last_fall is not None:
            last = f"the last linearisation lowered it by {100 * numbers.last_fall:.2g} %"
        yield f"cut: time ended before the cost converged; {last}"
    elif not numbers.converged:
        yield "not converged: the iteration stopped before the cost converged"


def _report(verified: Report) -> Iterator[str | Table]:
    """Yield the report as text, or as a table that fits where a terminal is narrower than that."""
    if not out.is_terminal or max(map(len, str(verified).splitlines())) <= out.width:
        yield str(verified)
        return
    printed = verified.printed()
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("vehicle", "constraint"):
        table.add_column(name)
    for name in ("time \\[s]", "value", "limit", "excess"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("")
    for check in printed.rows:
        numbers = (f"{each:.4g}" for each in (check.time, check.value, check.limit))
        result = (f"{check.excess:+.1e}", check.unit, verdict(check))
        table.add_row(escape(check.vehicle), escape(check.what), *numbers, *result)
    yield printed.title
    yield table
    yield from printed.below


def _windows_without_plan(windows: Sequence[Window]) -> Iterator[str]:
    """Yield a line for each window without a plan of its own: what was flown, and the reason."""
    for window in windows:
        if window.infeasible:
            flown = "previous plan" if window.kept else "least-violation motion"
            yield f"  from knot {window.first_knot + 1}, {flown}: {window.infeasible}"
