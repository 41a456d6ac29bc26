"""What the commands say and wait for, and the status they leave with."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable

from rich.console import Console

from drake_rho.assurance.feasibility import diagnose
from drake_rho.assurance.verification import verify
from drake_rho.cli.checks import Drawing
from drake_rho.cli.summary import simulation_table
from drake_rho.display.flown import Flown
from drake_rho.motion.files import save
from drake_rho.motion.plan import Flight
from drake_rho.motion.simulation import Simulation
from drake_rho.planning.errors import InfeasibleError, SolverError
from drake_rho.scenario.errors import DrakeRhoError

out = Console()
err = Console(stderr=True)


def say(text: str, console: Console = out) -> None:
    """Print text unchanged on a console of any width: no markup in names, no folded tables."""
    console.file.write(f"{text}\n")
    console.file.flush()


def finish(
    planned: Flown, output: str | None, drawing: Drawing | None = None, heading: str | None = None
) -> int:
    """Report on what was planned, keep it and draw it, whether or not it holds."""
    if output is not None:  # before anything is said: a closed pipe must not lose the work
        save(planned, output)
    if heading is not None:
        say(heading)
    status = report(planned)
    if output is not None:
        say(f"kept in {output}")
    if drawing is not None:
        # matplotlib takes longer to load than the other commands take to run
        from drake_rho.display.figures import write_figures

        with err.status("drawing"):
            drawn = write_figures(
                planned, drawing.folder, file_format=drawing.file_format, width=drawing.width
            )
        say(f"{', '.join(path.name for path in drawn)} in {drawing.folder}")
    return status


def report(planned: Flown) -> int:
    """Judge what was planned and say how it came about; the status is 0 if all of it holds."""
    if isinstance(planned, Simulation):
        return _report_simulation(planned)
    judged = verify(planned)
    say(str(judged))
    whole = planned.plan if isinstance(planned, Flight) else planned
    numbers = whole.statistics
    say(
        f"cost {whole.cost:.6f} m²/s⁴; step {whole.scenario.grid.step:g} s; "
        f"{numbers.programs} programs, {numbers.seconds:.3f} s, {numbers.solver or 'no solver'}"
    )
    if isinstance(planned, Flight):
        _say_windows(planned)
    if numbers.tolerance is not None and numbers.converged:
        say(f"converged: the last linearisation saved less than {100 * numbers.tolerance:g} %")
    if not numbers.converged:
        say("not converged: the iteration was stopped before the cost settled")
    return 0 if judged.ok else 1


def _report_simulation(simulation: Simulation) -> int:
    """Judge the true motion, and say how far it was off its plans."""
    judged = verify(simulation)
    say(str(judged))
    _say_why(simulation.flight)
    out.print(simulation_table(simulation))
    return 0 if judged.ok else 1


def _say_windows(flight: Flight) -> None:
    """How many windows there were, and why some had no plan of their own."""
    kept = sum(bool(window.infeasible) for window in flight.windows)
    say(f"{len(flight.windows)} windows, {kept} of them without a plan of their own")
    _say_why(flight)


def _say_why(flight: Flight) -> None:
    """Why windows had no plan of their own."""
    for window in flight.windows:
        if window.infeasible:
            flown = "along the previous" if window.kept else "breaking least"
            say(f"  from knot {window.first_knot + 1}, {flown}: {window.infeasible}")


def on_interrupt() -> Callable[[], None]:
    """From now on Ctrl-C, or a request to end, ends nothing but the wait that is returned.

    Also where a shell in the background has them ignored.
    """
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())

    def wait() -> None:
        while not ended.wait(3600.0):
            pass

    return wait


def status_of(command: Callable[[], int | None]) -> int:
    """Run a command to its exit status; what it raises on purpose is said in a line or a few."""
    try:
        status = command()
    except InfeasibleError as error:
        with err.status("finding out why"):
            reason = None if error.scenario is None else diagnose(error.scenario)
        say(str(reason or error), err)
        return 3
    except SolverError as error:
        return _complain(error, 4)
    except (DrakeRhoError, ValueError, OSError) as error:
        return _complain(error, 2)
    except MemoryError:
        return _complain("out of memory: the scenario is too large for this machine", 2)
    except Exception as error:
        # A word on the command line that typer does not accept. Its exceptions have no public
        # name that holds from version to version; this method sets them apart.
        if not hasattr(error, "format_message"):
            raise
        return _complain(error.format_message() or "see drake-rho --help", 2)
    return int(status or 0)


def _complain(error: object, status: int) -> int:
    words = " ".join(str(error).split())
    say(f"drake-rho: {words}", err)
    return status
