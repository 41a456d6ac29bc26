"""Runs: pure functions from a scenario's source, a method and a seed to one row of results."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import platform
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from drake_rho.campaigns.memory import peak_memory
from drake_rho.campaigns.methods import AnyMethod, Found, Method
from drake_rho.campaigns.sources import AnySource
from drake_rho.motion.files import save
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Scenario
from drake_rho.system.threads import single_threaded_blas

SOLVED, INFEASIBLE, FAILED, INVALID, ERROR = "solved", "infeasible", "failed", "invalid", "error"
"""Status of a run: planned or flown; no plan; failure of the solvers; draw that is not a valid
scenario; any other error."""


@dataclasses.dataclass(frozen=True)
class Run:
    """Task of one run, in a form that is quick to send."""

    key: str
    """hash of everything that the result depends on"""
    scenario: str
    """name of the source"""
    method: str
    """name of the method"""
    source_json: str
    """source as JSON"""
    method_json: str
    """method as JSON"""
    seed: tuple[int, int, int]
    """seed of the study, number of the source, and number of the repetition, both from 0"""
    keep: bool = False
    """whether to keep the plan"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """Result of a run: a row of the table `runs`."""

    key: str
    """hash of the scenario's source, the method and the seed"""
    scenario: str
    """name of the source"""
    method: str
    """name of the method"""
    repetition: int
    """number of the repetition, from 0"""
    seed: str
    """entropy and spawn key of the seed sequence, as 0/2/17"""
    status: str
    """solved, infeasible, failed (the solvers), invalid (the drawn scenario), or error"""
    reason: str
    """why the run was not solved, or the constraint with the worst violation; else empty"""
    verified: bool
    """whether it was solved and every constraint holds"""
    vehicles: int | None = None
    """number of vehicles"""
    cost: float | None = None
    """cost f (13), the paper's performance index [m²/s⁴]"""
    duration: float | None = None
    """time from the first knot to the last [s], which `plan_minimum_time` finds"""
    bound: float | None = None
    """lower bound on the cost of every plan [m²/s⁴]"""
    obstacle_clearance: float | None = None
    """least distance from an obstacle beyond the required distance [m]"""
    separation_clearance: float | None = None
    """least distance between vehicles beyond the required separation [m]"""
    tube_share: float | None = None
    """for a simulation, the largest ratio of position error to tube radius"""
    largest_deviation: float | None = None
    """for a flight with measurements, the largest deviation from the planned motion [m]"""
    measured_clearance: float | None = None
    """for such a flight, the least measured distance from an obstacle beyond that required [m]"""
    without_contingency: int | None = None
    """number of windows without a contingency, if contingencies are on"""
    programs: int | None = None
    """number of quadratic programs solved"""
    plan_seconds: float | None = None
    """time to plan or fly, or until that failed [s]"""
    verify_seconds: float | None = None
    """time to verify [s]"""
    run_seconds: float | None = None
    """time of the whole run, including drawing the scenario and verification [s]"""
    megabytes: float | None = None
    """peak memory of the process after planning and verification [MB]"""
    finished: str
    """time at which the run finished, in UTC"""
    versions: str
    """versions of the packages that computed it"""


MEASURED = ("plan_seconds", "verify_seconds", "run_seconds", "megabytes", "finished")
"""Columns that may differ when a run is repeated: times and memory."""


@dataclasses.dataclass(frozen=True)
class Done:
    """Row of a finished run, and its plan if it is kept."""

    row: Row
    plan: bytes | None = None


def run_keys(source: str, method: str, seed: int, index: int) -> Callable[[int], str]:
    """Return a function from the repetition to the key of a run; all else is fixed."""
    prefix = hashlib.sha256(json.dumps([source, method, seed, index]).encode())

    def key(repetition: int) -> str:
        digest = prefix.copy()
        digest.update(b"%d" % repetition)
        return digest.hexdigest()[:32]

    return key


def generators(seed: tuple[int, int, int]) -> tuple[np.random.Generator, np.random.Generator]:
    """Return the generators that draw a scenario and the randomness of its flight.

    They are the same for all methods. Their seeds are those of `SeedSequence(entropy)` after
    `spawn` for the source and `spawn` again for the repetition.
    """
    entropy, *place = seed
    of_the_run = np.random.SeedSequence(entropy, spawn_key=tuple(place))
    first, second = of_the_run.spawn(2)
    return np.random.default_rng(first), np.random.default_rng(second)


@single_threaded_blas
def do_all(runs: Sequence[Run], attempt: int = 0) -> list[Done]:
    """Carry out runs sequentially, with one thread for the arithmetic.

    Args:
        runs: the runs.
        attempt: number of earlier attempts, which keeps executors from merging equal tasks.
    """
    return [do(run) for run in runs]


def do(run: Run) -> Done:
    """Carry out one run. Any error in it is reported in its row."""
    began = time.perf_counter()
    columns: dict[str, Any] = {"status": SOLVED, "reason": "", "verified": False}
    plan = None
    try:
        of_scenario, of_flight = generators(run.seed)
        scenario = _drawn(run, of_scenario, columns)
        if scenario is not None:
            method = _method(run.method_json)
            with _measured(columns):
                found = method.run(scenario, of_flight)
            columns |= _columns(found)
            plan = _packed(found) if run.keep else None
    except InfeasibleError as error:
        columns |= {"status": INFEASIBLE, "reason": _words(error)}
    except (SolverError, OutOfTimeError) as error:
        columns |= {"status": FAILED, "reason": _words(error)}
    except Exception as error:  # one run must not end the others
        columns |= {"status": ERROR, "reason": f"{type(error).__name__}: {_words(error)}"}
    return Done(row_of(run, **columns, run_seconds=time.perf_counter() - began), plan)


def row_of(run: Run, **columns: Any) -> Row:
    """Return the row of a run with the given columns and defaults for the others."""
    return Row(
        key=run.key,
        scenario=run.scenario,
        method=run.method,
        repetition=run.seed[2],
        seed="/".join(map(str, run.seed)),
        finished=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        versions=versions(),
        **columns,
    )


@cache
def versions() -> str:
    """Return the versions of the packages that a result depends on, as one line."""
    packages = ("drake-rho", "drake", "numpy", "scipy")
    found = [f"{package} {importlib.metadata.version(package)}" for package in packages]
    return ", ".join([*found, f"Python {platform.python_version()}"])


@cache
def package_version() -> str:
    """Return the version of drake_rho."""
    return importlib.metadata.version("drake-rho")


def _drawn(run: Run, rng: np.random.Generator, columns: dict[str, Any]) -> Scenario | None:
    """Draw the scenario of a run.

    If it is not valid, the reason is noted in `columns` and None is returned.
    """
    try:
        scenario: Scenario = _source(run.source_json).drawn(rng)
    except ScenarioError as error:
        columns |= {"status": INVALID, "reason": _words(error)}
        return None
    columns["vehicles"] = len(scenario.vehicles)
    return scenario


def _columns(found: Found) -> dict[str, Any]:
    evaluation = dataclasses.asdict(found.evaluation)
    violated = evaluation.pop("violated")
    return {
        **evaluation,
        "reason": violated,
        "verified": not violated,
        "bound": found.bound,
        "plan_seconds": found.seconds,
        "verify_seconds": found.verify_seconds,
    }


@contextmanager
def _measured(columns: dict[str, Any]) -> Iterator[None]:
    """Record a block's duration in `columns`, even if it fails, and the peak memory."""
    began = time.perf_counter()
    try:
        yield
    finally:
        columns |= {"plan_seconds": time.perf_counter() - began, "megabytes": peak_memory()}


def _packed(found: Found) -> bytes:
    """Return the contents of a file that `drake_rho.load` reads."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.npz"
        save(found.planned, path)
        return path.read_bytes()


def _words(error: Exception) -> str:
    return " ".join(str(error).split())


@lru_cache(maxsize=64)
def _source(text: str) -> Any:
    return _adapters()[0].validate_json(text)


@lru_cache(maxsize=64)
def _method(text: str) -> Method:
    method: Method = _adapters()[1].validate_json(text)
    return method


@cache
def _adapters() -> tuple[TypeAdapter[Any], TypeAdapter[Any]]:
    return TypeAdapter(AnySource), TypeAdapter(AnyMethod)
