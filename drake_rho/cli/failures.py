"""What goes wrong, in words or as a document, and the status that a command leaves with."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

from drake_rho.analysis.diagnose import diagnose
from drake_rho.cli.console import err, manner, say, stopping_early, working, write
from drake_rho.cli.described import why
from drake_rho.cli.documents import Failed
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.scenario.errors import DrakeRhoError

BAD_INPUT, NO_PLAN, SOLVERS_FAILED, OUT_OF_TIME, INTERRUPTED = 2, 3, 4, 5, 130

_LOOK = 15.0
"""Longest look for what would mend a scenario, where nothing but a plan was asked for [s]."""


class InterruptedByUserError(Exception):
    """Ctrl-C; typer would make an end of it that no one can say a word about."""


def status_of(command: Callable[[], int | None]) -> int:
    """Run a command to its exit status; what it raises on purpose is said in a line or a few."""
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
        return _complain("interrupted", INTERRUPTED)  # while a part of Drake was being loaded
    except MemoryError:
        return _complain("out of memory: the scenario is too large for this machine", BAD_INPUT)
    except Exception as error:
        # A word on the command line that typer does not accept. Its exceptions have no public
        # name that holds from version to version; this method sets them apart.
        if not hasattr(error, "format_message"):
            raise
        return _complain(error.format_message() or "see drake-rho --help", BAD_INPUT)


def _without_plan(error: InfeasibleError) -> int:
    """Say why there is no plan, at once; then what would mend it, which may take long to find."""
    if error.scenario is None or (manner.quiet and not manner.as_json):
        return _complain(error, NO_PLAN)
    if not manner.as_json:
        say(f"drake-rho: {_line(error)}", err)
    diagnosis = None
    look = working("looking for what would mend it")
    with suppress(SolverError, OutOfTimeError), look as work, stopping_early():
        diagnosis = diagnose(error.scenario, progress=work, time_limit=_LOOK)
    if manner.as_json:
        found = None if diagnosis is None else why(diagnosis)
        write(Failed(status=NO_PLAN, error=_line(error), diagnosis=found).to_json())
    elif diagnosis is not None:
        if diagnosis.conflicts != error.conflicts:
            say(diagnosis.reason, err)
        if not diagnosis.feasible:
            say(diagnosis.remedy, err)
    return NO_PLAN


def _complain(error: object, status: int) -> int:
    if manner.as_json:
        write(Failed(status=status, error=_line(error)).to_json())
    else:
        say(f"drake-rho: {_line(error)}", err)
    return status


def _line(error: object) -> str:
    return " ".join(str(error).split())
