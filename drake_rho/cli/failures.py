"""Errors of the commands, printed as text or as a document, and their exit statuses."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from drake_rho.analysis.diagnose import diagnose
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.cli.console import err, output_mode, say, stopping_early, working, write
from drake_rho.cli.documents import json_of
from drake_rho.planning.call.time_limit import within_time
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.scenario.errors import DrakeRhoError

BAD_INPUT, NO_PLAN, SOLVERS_FAILED, OUT_OF_TIME, INTERRUPTED = 2, 3, 4, 5, 130

_DIAGNOSIS_TIME = 15.0
"""Time limit of the diagnosis after a planning command has found no plan, beside the bound on its
work [s]."""


class InterruptedByUserError(Exception):
    """Ctrl-C during a command.

    It replaces KeyboardInterrupt, for which typer would exit before the message can be printed.
    """


def status_of(command: Callable[[], int | None]) -> int:
    """Run a command and return its exit status; print expected errors in one or a few lines."""
    try:
        try:
            return int(command() or 0)
        except InfeasibleError as error:
            return _without_plan(error)
    except (InterruptedByUserError, KeyboardInterrupt) as error:
        return _complain(str(error) or "interrupted", INTERRUPTED)
    except SolverError as error:
        return _complain(error, SOLVERS_FAILED)
    except OutOfTimeError as error:
        return _complain(error, INTERRUPTED if error.time_limit is None else OUT_OF_TIME)
    except (DrakeRhoError, ValueError, OSError) as error:
        return _complain(error, BAD_INPUT)
    except ImportError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        return _complain("interrupted", INTERRUPTED)  # Ctrl-C while a part of Drake was imported
    except MemoryError:
        return _complain("out of memory: the scenario is too large for this machine", BAD_INPUT)
    except Exception as error:
        # A command line that typer rejects. The exceptions of typer have no public name that is
        # the same in all versions; this method distinguishes them.
        if not hasattr(error, "format_message"):
            raise
        return _complain(error.format_message() or "see drake-rho --help", BAD_INPUT)


def _without_plan(error: InfeasibleError) -> int:
    """Print at once why there is no plan; then diagnose, which takes longer, and print remedies."""
    if error.scenario is None or (output_mode.quiet and not output_mode.as_json):
        return _complain(error, NO_PLAN)
    if not output_mode.as_json:
        say(f"drake-rho: {_line(error)}", err)
    diagnosis = None
    status = working("looking for changes that make the scenario feasible")
    cut = suppress(SolverError, OutOfTimeError)
    with cut, status as work, stopping_early(), within_time(_DIAGNOSIS_TIME):
        diagnosis = diagnose(error, progress=work)
    if output_mode.as_json:
        write(_document(NO_PLAN, error, diagnosis))
    elif diagnosis is not None:
        say(str(diagnosis), err)
    return NO_PLAN


def _complain(error: object, status: int) -> int:
    if output_mode.as_json:
        write(_document(status, error))
    else:
        say(f"drake-rho: {_line(error)}", err)
    return status


def _document(status: int, error: object, diagnosis: Diagnosis | None = None) -> str:
    """Return the document of a command that fails."""
    return json_of({"status": status, "error": _line(error), "diagnosis": diagnosis})


def _line(error: object) -> str:
    return " ".join(str(error).split())
