"""Works of `against`, each for a process of its own.

`python -P -m benchmarks.against_works WORK TREE` does one and prints its times. The package is that
of TREE, the first folder of PYTHONPATH. It is imported by the works, since the first plan of a
process includes the import.
"""

from __future__ import annotations

import dataclasses
import json
import os
import statistics
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.stopwatch import Stopwatch, Taken

FOLDER = "BENCHMARKS_MISSIONS"
"""Variable of the environment with the folder of LSC's OctoMaps."""


@dataclasses.dataclass(frozen=True)
class Work:
    """A piece of work in a process of its own."""

    name: str
    """name in the table"""
    prepare: Callable[[], Callable[[], float]]
    """returns the work, which returns a cost [m²/s⁴] or another result"""
    inner: int = 1
    """runs in one process, of which the median counts"""
    pairs: int = 31
    """largest number of pairs of processes"""
    warm: bool = True
    """whether one run that does not count comes first"""


def _example_4(solver: str) -> Callable[[], float]:
    import drake_rho as rho

    def flown() -> float:
        flight = rho.plan_rho(rho.load_scenario("paper"), replan_every=5, solver=solver)
        assert rho.verify(flight).ok  # noqa: S101
        return flight.cost

    return flown


def _mpc(*, disturbed: bool) -> Callable[[], float]:
    import drake_rho as rho
    from benchmarks import mpc

    scenario = mpc.scenario()
    if disturbed:
        around = rho.Disturbance(0.2, feedback_every=0.05)
        scenario = dataclasses.replace(scenario, disturbance=around)
    states = mpc.measured(mpc.scenario())

    def windows() -> float:
        """Return the cost of the last of ten windows."""
        horizon = rho.RecedingHorizon(
            scenario, replan_every=1, reference=rho.tail_reference, fallback=None, solver="daqp"
        )
        for knot in range(10):
            given = horizon.planned(knot) if disturbed else states[knot : knot + 1]
            window = horizon.step(given, scenario.grid.times[knot])
        return window.plan.cost

    return windows


def _planned(make: Callable[[], object], **settings: object) -> Callable[[], float]:
    import drake_rho as rho

    def planned() -> float:
        plan = rho.plan(make(), **settings)  # type: ignore[arg-type]
        assert rho.verify(plan).ok  # noqa: S101
        return plan.cost

    return planned


def _crowd() -> Callable[[], float]:
    from benchmarks import fleet_b1

    return _planned(lambda: fleet_b1.scenario(20, 0))


def _thousand() -> Callable[[], float]:
    from benchmarks import fleet_b2

    return _planned(lambda: fleet_b2.scenario(1000, 0, fleet_b2.LONGER), solver="daqp")


def _field() -> Callable[[], float]:
    import numpy as np

    import drake_rho as rho

    return _planned(lambda: rho.random_field(30, np.random.default_rng(1)))


def _forest() -> Callable[[], float]:
    import drake_rho as rho

    folder = Path(os.environ[FOLDER])
    grid = rho.Grid.lasting(14.0, step=0.25)
    mission, world = folder / "forest1_20agents.json", folder / "forest1.bt"
    return _planned(lambda: rho.load_lsc_mission(mission, grid=grid, world=world))


def _five_spheres() -> Callable[[], float]:
    from benchmarks import five_spheres

    return _planned(five_spheres.scenario)


def _certified() -> Callable[[], float]:
    import drake_rho as rho
    from benchmarks import fleet_b1

    plans = [rho.plan(fleet_b1.scenario(8, seed)) for seed in range(3)]
    return lambda: sum(rho.certify(plan).lower_bound for plan in plans)


def _first_plan() -> Callable[[], float]:
    def planned() -> float:
        import drake_rho as rho

        return rho.plan(rho.load_scenario("paper")).cost

    return planned


WORKS = {
    "example_4": Work("Example 4, ten windows, verified", lambda: _example_4("clarabel"), 5),
    "example_4_daqp": Work("the same with DAQP", lambda: _example_4("daqp"), 5),
    "mpc": Work("ten windows of MPC past three balls", lambda: _mpc(disturbed=False), 3),
    "mpc_disturbed": Work("the same with a disturbance", lambda: _mpc(disturbed=True), 3),
    "five_spheres": Work("five spheres, 61 knots", _five_spheres, 3),
    "field": Work("field of 30 obstacles", _field, 3),
    "crowd": Work("B1, 20 vehicles", _crowd, pairs=15),
    "certify": Work("certify three fleets of 8 of B1", _certified, pairs=7),
    "forest": Work("LSC's forest 1, 20 vehicles", _forest, pairs=7, warm=False),
    "thousand": Work("B2, 1000 vehicles, DAQP", _thousand, pairs=5, warm=False),
    "first_plan": Work("import and first plan of a process", _first_plan, warm=False),
}
"""Works by name."""


def main(name: str, tree: str) -> None:
    """Do one work in this process, and print its times and its result."""
    work, times, result = WORKS[name], list[Taken](), 0.0
    run_once = work.prepare()
    if work.warm:
        run_once()
    for _ in range(work.inner):
        watch = Stopwatch()
        result = run_once()
        times.append(watch.taken())
    import drake_rho

    if not Path(drake_rho.__file__).is_relative_to(tree):
        raise RuntimeError(f"imported {drake_rho.__file__}, expected one of {tree}")
    answer = {
        "processor": statistics.median(each.processor for each in times),
        "wall": statistics.median(each.wall for each in times),
        "result": result,
    }
    print(json.dumps(answer))  # noqa: T201  # read by the parent process


if __name__ == "__main__":
    main(*sys.argv[1:])
