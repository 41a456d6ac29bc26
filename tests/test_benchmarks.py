"""The benchmarks: all that are named exist, times are complete, tables state their conditions."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Iterable
from importlib.util import find_spec

import numpy as np
import pytest

pytest.importorskip("benchmarks")  # a source archive has the tests without them

import drake_rho as rho
from benchmarks import __main__ as names
from benchmarks.stopwatch import Stopwatch, Taken, median, reported
from benchmarks.tables import Table, to_markdown


def test_every_benchmark_that_is_named_exists() -> None:
    groups: list[Iterable[str]] = [names.RACES, names.STUDIES, names.EARLIER, names.DRAWN]
    groups += [names.MISSIONS, names.FILES, names.SCALE, names.SWAPS, names.FLIGHT, names.WORLDS]
    groups += [names.MAPS, names.TIMES, names.OPEN, names.OBJECTIVE, names.ONLINE, names.CLIENTS]
    groups += [names.FLOWN_MISSIONS, names.MIXED, names.SHOWS, names.BOUNDS]
    for name in {each for group in groups for each in group}:
        assert find_spec(f"benchmarks.{name}"), name


def test_processor_time_includes_processes() -> None:
    watch = Stopwatch()
    busy = "import time\nwhile time.process_time() < 0.1: pass"
    subprocess.run([sys.executable, "-I", "-S", "-c", busy], check=True)
    reported(5.0)
    taken = watch.taken()
    assert taken.processor >= 5.1
    assert median([Taken(1.0, 4.0), Taken(3.0, 2.0), Taken(2.0, 9.0)]) == Taken(2.0, 4.0)


def test_tables_begin_with_their_conditions() -> None:
    words = to_markdown(Table("none", "Title", ("a",), ((1,),), packages=("numpy",)), 0.5)
    title, conditions, *_ = words.split("\n\n")
    assert title == "# Title"
    for each in ("Commit ", "0.5 before", "Threads of BLAS", f"numpy {np.__version__}"):
        assert each in conditions


def test_a_window_of_mpc_starts_from_the_one_before() -> None:
    pytest.importorskip("casadi")
    from benchmarks import mpc
    from benchmarks.peers import casadi_mpc

    scenario = mpc.scenario()
    short = dataclasses.replace(scenario, grid=rho.Grid(0.5, 11), between_knots=False)
    planned, programs = rho.plan(short), casadi_mpc.Programs(short, casadi_mpc.METHODS["IPOPT"], 2)
    state = np.concatenate([planned.positions[0], planned.velocities[0]], axis=1)
    first = programs.solve(0, state[0], None)
    assert np.sum(first.accelerations**2) == pytest.approx(planned.cost, rel=1e-3)
    after = programs.solve(1, state[1], first)
    assert after.success
    assert after.accelerations.shape == (1, 9, 3)
    start = first.shifted(len(scenario.obstacles))
    for name in ("variables", "of_bounds", "of_rows"):
        assert getattr(start, name).shape == getattr(after, name).shape
