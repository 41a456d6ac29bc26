"""The commands `verify`, `certify` and `diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from drake_rho.analysis.certify import certified
from drake_rho.analysis.certify_time import certify_time
from drake_rho.analysis.diagnose import diagnose as diagnosis_of
from drake_rho.analysis.proof_scenario import of_scenario
from drake_rho.cli.campaigns import worker_pool
from drake_rho.cli.checks import check_outputs, check_writable
from drake_rho.cli.console import answer, stopping_early, working
from drake_rho.cli.options import (
    MaxAccelerationOption,
    OutputOption,
    ResultArgument,
    Solver,
    SolverOption,
    TimeLimitOption,
    TopicOption,
    TrajectoriesOption,
    WorkersOption,
)
from drake_rho.cli.reports import finish, finish_trajectories
from drake_rho.cli.sources import is_result, load_any, load_result, read
from drake_rho.motion.files import save
from drake_rho.motion.trajectories import Trajectories
from drake_rho.planning.programs.backend import SOLVERS
from drake_rho.verification.verify import verify as verify_any


def verify(
    file: ResultArgument,
    every_row: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Print every row, also of equalities, with values and limits.",
        ),
    ] = False,
    scenario: TrajectoriesOption = None,
    max_acceleration: MaxAccelerationOption = None,
    topic: TopicOption = None,
) -> int:
    """Verify a plan, flight, simulation or other trajectories.

    The exit status is 1 if a constraint is violated, and 6 if samples leave one undecided.
    """
    found = load_any(file, scenario, max_acceleration, topic)
    if not isinstance(found, Trajectories):
        return finish(found, every_row=every_row)
    with working("verifying"):
        report = verify_any(found)
    return finish_trajectories(report, every_row=every_row)


def certify(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="A file (.npz) saved by 'plan' or 'fly', or a plan exported as JSON.",
        ),
    ],
    time: Annotated[
        bool,
        typer.Option("--time", help="Bound the final time of a plan instead of its cost."),
    ] = False,
    gap: Annotated[
        str | None,
        typer.Option(
            metavar="GAP",
            help="Raise the bound on the cost by branch and bound until the gap is at most this, "
            "such as 1% or 0.01.",
        ),
    ] = None,
    output: OutputOption = None,
    proof: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Save the proof of the bound (.proof), which rho.check_certificate checks.",
        ),
    ] = None,
    workers: WorkersOption = None,
    solver: SolverOption = Solver.CLARABEL,
    time_limit: TimeLimitOption = None,
) -> int:
    """Bound how far a plan is from the optimum, in cost or in time.

    With --gap, --output saves the best plan that was found. The exit status is 0 even if a gap
    remains.
    """
    part = None if gap is None else _part(gap)
    for given, name in ((output, "--output"), (workers, "--workers")):
        if given is not None and part is None:
            raise ValueError(f"{name}: got {given}, expected none without --gap")
    check_outputs(output, None)
    check_writable(proof, (".proof",), "--proof")
    flown = load_result(file)
    if flown.simulation is not None:
        raise ValueError(f"{file}: got a simulation, expected a plan or a flight")
    if time:
        for given, name in ((gap, "--gap"), (proof, "--proof")):
            if given is not None:
                raise ValueError(f"{name}: got {given} with --time, expected one of them")
        if flown.flight is not None:
            raise ValueError(f"{file}: got a flight, expected a plan, whose time is bounded")
        with working("bounding the least time") as work, stopping_early():
            found = certify_time(flown.plan, progress=work, time_limit=time_limit)
        return answer(found, str(found))
    if proof is not None:
        of_scenario(flown.plan.scenario)  # raises what its file does not hold
    words = "computing a lower bound"
    with working(words) as work, stopping_early(), worker_pool(workers) as executor:
        certificate, best = certified(
            flown.flight or flown.plan,
            gap=part,
            solver=SOLVERS[solver](),
            executor=executor,
            progress=work,
            time_limit=time_limit,
        )
    saved = list[str]()
    if output is not None:
        save(best, output)
        saved.append(f"the best plan is saved to {output}")
    if proof is not None:
        saved.append(f"saved to {proof}: {certificate.save(proof)}")
    return answer(certificate, str(certificate), *saved)


def _part(gap: str) -> float:
    """Return a gap given in per cent or as a part of the cost."""
    digits, percent, after = gap.partition("%")
    try:
        if after:
            raise ValueError
        return float(digits) / (100.0 if percent else 1.0)
    except ValueError:
        raise ValueError(f"--gap: got {gap!r}, expected a gap such as 1% or 0.01") from None


def diagnose(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|FILE",
            help="A scenario, or a file (.npz) with a plan saved by 'fastest'.",
        ),
    ],
    solver: SolverOption = Solver.CLARABEL,
    time_limit: TimeLimitOption = None,
    planned: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO",
            help="For a plan: the scenario that it was planned for, whose times of waypoints are "
            "kept. Without it, all times of waypoints count as found.",
        ),
    ] = None,
) -> int:
    """Explain why there is no plan, or which limits make a plan so long.

    For a scenario, changes that would make it feasible follow; the exit status is 0 whether there
    is a plan or not. For a plan of 'fastest', it is the time that wider limits would save.
    """
    if is_result(source):
        return _diagnose_plan(source, planned, time_limit)
    if planned is not None:
        raise ValueError(f"--planned: got {planned!r} for a scenario, expected a file of a plan")
    problem = read(source)
    with working("looking for a plan") as work, stopping_early():
        diagnosis = diagnosis_of(
            problem, solver=SOLVERS[solver](), progress=work, time_limit=time_limit
        )
    return answer({"diagnosis": diagnosis}, str(diagnosis))


def _diagnose_plan(source: str, planned: str | None, time_limit: float | None) -> int:
    """Print the sensitivity of a plan's least time to limits."""
    flown = load_result(Path(source))
    if flown.kind != "plan":
        raise ValueError(f"{source}: got a {flown.kind}, expected a plan")
    scenario = None if planned is None else read(planned)
    with working("looking for less time near the plan") as work, stopping_early():
        found = diagnosis_of(flown.plan, planned=scenario, progress=work, time_limit=time_limit)
    return answer(found, str(found))
