"""What is said of something planned or flown: whether it holds, and how it came about."""

from __future__ import annotations

from collections.abc import Iterator

from rich.markup import escape
from rich.table import Table

from drake_rho.cli import described
from drake_rho.cli.checks import Drawing
from drake_rho.cli.console import out, tell, working
from drake_rho.cli.summary import simulation_table
from drake_rho.display.common.drawable import Flown
from drake_rho.motion.files import save
from drake_rho.motion.plan import Flight
from drake_rho.motion.simulation import Simulation
from drake_rho.verification.report import Report, verdict
from drake_rho.verification.verify import verify


def finish(
    flown: Flown, output: str | None, drawing: Drawing | None, wind: str | None = None
) -> int:
    """Keep and draw what was planned, whether or not it holds, and report on it."""
    if output is not None:  # before anything is said: a closed pipe must not lose the work
        save(flown, output)
    drawn = []
    if drawing is not None:
        # matplotlib takes longer to load than the other commands take to run
        from drake_rho.display.plots.figures import write_figures

        with working("drawing"):
            drawn = write_figures(
                flown, drawing.folder, file_format=drawing.file_format, width=drawing.width
            )
    kept = [f"kept in {output}"] if output is not None else []
    if drawing is not None:
        kept += [f"{', '.join(path.name for path in drawn)} in {drawing.folder}"]
    with working("verifying"):
        judged = verify(flown)
    document = described.judged(flown, judged, wind=wind, file=output, figures=drawn)
    heading = [f"wind: {wind}"] if wind is not None else []
    return tell(document, *heading, *_words(flown, judged), *kept)


def report(flown: Flown) -> int:
    """Judge what was planned and say how it came about; the status is 0 if all of it holds."""
    return finish(flown, None, None)


def _words(flown: Flown, judged: Report) -> Iterator[str | Table]:
    """A report, and what it took."""
    yield from _report(judged)
    if isinstance(flown, Simulation):
        yield from _why(flown.flight)
        yield simulation_table(flown)
        return
    whole = flown.plan if isinstance(flown, Flight) else flown
    numbers = whole.statistics
    yield (
        f"cost {whole.cost:.6f} m²/s⁴; step {whole.scenario.grid.step:g} s; "
        f"{numbers.programs} programs, {numbers.seconds:.3f} s, {numbers.solver or 'no solver'}"
    )
    if isinstance(flown, Flight):
        kept = sum(bool(window.infeasible) for window in flown.windows)
        yield f"{len(flown.windows)} windows, {kept} of them without a plan of their own"
        yield from _why(flown)
    if numbers.tolerance is not None and numbers.converged:
        yield f"converged: the last linearisation saved less than {100 * numbers.tolerance:g} %"
    if numbers.cut:
        fell = "was not lowered yet"
        if numbers.last_fall is not None:
            fell = f"last fell by {100 * numbers.last_fall:.2g} %"
        yield f"cut: time was up before the cost settled; it {fell}"
    elif not numbers.converged:
        yield "not converged: the iteration was stopped before the cost settled"


def _report(judged: Report) -> Iterator[str | Table]:
    """A report as it prints, or folded for a terminal that is narrower than that."""
    if not out.is_terminal or max(map(len, str(judged).splitlines())) <= out.width:
        yield str(judged)
        return
    printed = judged.printed()
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for name in ("vehicle", "constraint"):
        table.add_column(name)
    for name in ("time \\[s]", "value", "limit", "excess"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("")
    for check in printed.rows:
        numbers = (f"{each:.4g}" for each in (check.time, check.value, check.limit))
        words = (f"{check.excess:+.1e}", check.unit, verdict(check))
        table.add_row(escape(check.vehicle), escape(check.what), *numbers, *words)
    yield printed.title
    yield table
    yield from printed.below


def _why(flight: Flight) -> Iterator[str]:
    """Why windows had no plan of their own."""
    for window in flight.windows:
        if window.infeasible:
            flown = "along the previous" if window.kept else "breaking least"
            yield f"  from knot {window.first_knot + 1}, {flown}: {window.infeasible}"
