"""One run: a pure function of what is asked, how, and a seed; whatever comes of it is a row."""

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

from drake_rho.campaigns.memory import peak
from drake_rho.campaigns.methods import AnyMethod, Found, Runs
from drake_rho.campaigns.sources import AnySource
from drake_rho.motion.files import save
from drake_rho.motion.threads import one_for_arrays
from drake_rho.planning.errors import InfeasibleError, OutOfTimeError, SolverError
from drake_rho.scenario.errors import ScenarioError
from drake_rho.scenario.records import Scenario

SOLVED, INFEASIBLE, FAILED, INVALID, ERROR = "solved", "infeasible", "failed", "invalid", "error"
"""What becomes of a run: planned or flown; without a plan; given up by the solvers; not a scenario
that makes sense, as it was drawn; and anything else."""


@dataclasses.dataclass(frozen=True)
class Run:
    """What is to be done, in a form that is quick to send."""

    key: str
    """hash of all that the result depends on"""
    scenario: str
    """name of the source"""
    method: str
    """name of the method"""
    source_json: str
    """the source"""
    method_json: str
    """the method"""
    seed: tuple[int, int, int]
    """the study's, the number of the source, and of the repetition, both from 0"""
    keep: bool = False
    """whether the plan is wanted too"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Row:
    """What came of a run: a row of the table `runs`."""

    key: str
    """hash of the scenario's source, the method and the seed"""
    scenario: str
    """name of the source"""
    method: str
    """name of the method"""
    repetition: int
    """from 0"""
    seed: str
    """entropy and spawn key of the seed sequence, as 0/2/17"""
    status: str
    """solved, infeasible, failed (the solvers), invalid (what was drawn), or error"""
    reason: str
    """why not solved, or what is broken; empty if all is well"""
    verified: bool
    """whether it was solved and every constraint holds"""
    vehicles: int | None = None
    """how many"""
    cost: float | None = None
    """f (13), the paper's index [m²/s⁴]"""
    bound: float | None = None
    """no plan costs less [m²/s⁴]"""
    obstacle_clearance: float | None = None
    """how much further from obstacles than asked, at the least [m]"""
    separation_clearance: float | None = None
    """how much further from each other than asked, at the least [m]"""
    tube_share: float | None = None
    """of a simulation: the largest error of the position over the largest radius of its tube"""
    programs: int | None = None
    """quadratic programs that were solved"""
    plan_seconds: float | None = None
    """what it took to plan or fly, or until that failed [s]"""
    verify_seconds: float | None = None
    """what it took to judge that [s]"""
    run_seconds: float | None = None
    """what the whole run took, making the scenario and judging included [s]"""
    megabytes: float | None = None
    """the most memory that the process had taken when it had planned and judged [MB]"""
    finished: str
    """when, in coordinated universal time"""
    versions: str
    """of what computed it"""


MEASURED = ("plan_seconds", "verify_seconds", "run_seconds", "megabytes", "finished")
"""The columns that may be others when a run is repeated: times and memory."""


@dataclasses.dataclass(frozen=True)
class Done:
    """A run's row, and its plan if it is kept."""

    row: Row
    plan: bytes | None = None


def run_keys(source: str, method: str, seed: int, index: int) -> Callable[[int], str]:
    """The keys of runs that differ in their repetition only, as a function of it."""
    begun = hashlib.sha256(json.dumps([source, method, seed, index]).encode())

    def key(repetition: int) -> str:
        ended = begun.copy()
        ended.update(b"%d" % repetition)
        return ended.hexdigest()[:32]

    return key


def generators(seed: tuple[int, int, int]) -> tuple[np.random.Generator, np.random.Generator]:
    """Where a scenario comes from, and all chance in its flight: the same for all methods.

    As `SeedSequence(entropy).spawn` and `spawn` again do, for the source and the repetition.
    """
    entropy, *place = seed
    of_the_run = np.random.SeedSequence(entropy, spawn_key=tuple(place))
    first, second = of_the_run.spawn(2)
    return np.random.default_rng(first), np.random.default_rng(second)


def do_all(runs: Sequence[Run], attempt: int = 0) -> list[Done]:
    """Do some runs one after another, with one thread for the arithmetic.

    Args:
        runs: what is to be done.
        attempt: how often it was tried before, so that no executor takes it for the same task.
    """
    with one_for_arrays():
        return [do(run) for run in runs]


def do(run: Run) -> Done:
    """Do one run. Whatever goes wrong in it is told in its row."""
    began = time.perf_counter()
    told: dict[str, Any] = {"status": SOLVED, "reason": "", "verified": False}
    plan = None
    try:
        chance, later = generators(run.seed)
        scenario = _drawn(run, chance, told)
        if scenario is not None:
            method = _method(run.method_json)
            with _measured(told):
                found = method.run(scenario, later)
            told |= _told(found)
            plan = _packed(found) if run.keep else None
    except InfeasibleError as error:
        told |= {"status": INFEASIBLE, "reason": _words(error)}
    except (SolverError, OutOfTimeError) as error:
        told |= {"status": FAILED, "reason": _words(error)}
    except Exception as error:  # one run must not end the others
        told |= {"status": ERROR, "reason": f"{type(error).__name__}: {_words(error)}"}
    return Done(row_of(run, **told, run_seconds=time.perf_counter() - began), plan)


def row_of(run: Run, **told: Any) -> Row:
    """The row of a run of which some columns are known."""
    return Row(
        key=run.key,
        scenario=run.scenario,
        method=run.method,
        repetition=run.seed[2],
        seed="/".join(map(str, run.seed)),
        finished=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        versions=versions(),
        **told,
    )


@cache
def versions() -> str:
    """Versions of what a result depends on, as one line."""
    packages = ("drake-rho", "drake", "numpy", "scipy")
    found = [f"{package} {importlib.metadata.version(package)}" for package in packages]
    return ", ".join([*found, f"Python {platform.python_version()}"])


@cache
def package_version() -> str:
    """That of drake_rho."""
    return importlib.metadata.version("drake-rho")


def _drawn(run: Run, chance: np.random.Generator, told: dict[str, Any]) -> Scenario | None:
    """The scenario of a run; None, and why is told, if what was drawn makes none."""
    try:
        scenario: Scenario = _source(run.source_json).drawn(chance)
    except ScenarioError as error:
        told |= {"status": INVALID, "reason": _words(error)}
        return None
    told["vehicles"] = len(scenario.vehicles)
    return scenario


def _told(found: Found) -> dict[str, Any]:
    judged = dataclasses.asdict(found.judgement)
    broken = judged.pop("broken")
    return {
        **judged,
        "reason": broken,
        "verified": not broken,
        "bound": found.bound,
        "plan_seconds": found.seconds,
        "verify_seconds": found.verify_seconds,
    }


@contextmanager
def _measured(told: dict[str, Any]) -> Iterator[None]:
    """Tell how long a block takes, which is all that is known where it fails, and the memory."""
    began = time.perf_counter()
    try:
        yield
    finally:
        told |= {"plan_seconds": time.perf_counter() - began, "megabytes": peak()}


def _packed(found: Found) -> bytes:
    """The file that `drake_rho.load` reads."""
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
def _method(text: str) -> Runs:
    method: Runs = _adapters()[1].validate_json(text)
    return method


@cache
def _adapters() -> tuple[TypeAdapter[Any], TypeAdapter[Any]]:
    return TypeAdapter(AnySource), TypeAdapter(AnyMethod)
