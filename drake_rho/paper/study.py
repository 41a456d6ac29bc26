"""The paper's study: its four examples and its six claims."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from drake_rho.analysis.certificate import Certificate
from drake_rho.analysis.certify import certify
from drake_rho.motion.flight import Flight, Window
from drake_rho.motion.obstacle_clearances import closest
from drake_rho.motion.plan import Plan
from drake_rho.planning.horizon.plan_rho import plan_rho
from drake_rho.planning.planners.convex import plan_convex
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.files import load_scenario
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.records import Scenario
from drake_rho.verification.verify import Report, verify

REPEATS = 5
"""Number of runs of each example; the median time is reported."""

ROLLING = 20.0
"""Time that windows of one length plan ahead [s], for the other reading of the sixth claim."""


@dataclasses.dataclass(frozen=True)
class Example:
    """Example of the paper, planned, verified and certified.

    The plan is from the run of median wall time out of `REPEATS`; the runs differ only in time.
    """

    number: int
    """number in the paper, 1 to 4"""
    method: str
    """"convex" or "RHO" """
    obstacle: str
    """"ignored" or "avoided" """
    plan: Plan
    """plan of the convex method, or flown motion of the receding horizon"""
    flight: Flight | None
    """flight with its windows for the receding horizon, None for the convex method"""
    report: Report
    """verification of `plan` against the scenario it was made for"""
    certificate: Certificate
    """lower bound of the cost of every plan of that scenario, beside the cost of `plan`"""

    @property
    def seconds(self) -> float:
        """Wall time of the median run [s]."""
        return self.plan.statistics.seconds

    @property
    def title(self) -> str:
        """Title in figures and progress bars."""
        return f"{self.method}, obstacle {self.obstacle}"

    @property
    def windows(self) -> tuple[Window, ...]:
        """Windows of the receding horizon; none for the convex method."""
        return self.flight.windows if self.flight else ()


@dataclasses.dataclass(frozen=True)
class Claim:
    """Claim of the paper, checked against the reproduced examples."""

    number: int
    """number of the claim in docs/paper.md"""
    text: str
    """text of the claim"""
    evidence: str
    """numbers that decide whether the claim is found"""
    found: bool
    """true if the reproduced examples confirm the claim"""


@dataclasses.dataclass(frozen=True)
class Study:
    """The four examples and the scenario that they share."""

    scenario: Scenario
    """scenario with its obstacles, which Examples 1 and 3 ignore"""
    examples: tuple[Example, ...]
    """Examples 1 to 4"""
    rolling: Flight
    """Example 4 with windows of one length, the other reading of the sixth claim"""

    def clearances_at_all_times(self, example: Example) -> FloatArray:
        """Compute each vehicle's least distance from any sphere's surface over all time.

        The distances are exact [m], shape (N,), and negative inside a sphere.
        """
        obstacles = [Obstacle(sphere) for sphere in self.scenario.spheres]
        nearest = [closest(example.plan, obstacle).distances for obstacle in obstacles]
        clearances: FloatArray = np.min(nearest, axis=0)
        return clearances

    def clearances(self, example: Example) -> FloatArray:
        """Compute each vehicle's least distance from any sphere's surface at the knots.

        The distances [m], shape (N,), are negative inside a sphere. They are measured from the
        scenario's spheres even in the examples that ignore them.
        """
        positions = example.plan.positions
        nearest = [
            sphere.signed_distance(positions).min(axis=1) for sphere in self.scenario.spheres
        ]
        clearances: FloatArray = np.min(nearest, axis=0)
        return clearances

    @property
    def claims(self) -> tuple[Claim, ...]:
        """The paper's six claims, checked."""
        checks = (
            _obstacle_ignored,
            _obstacle_avoided,
            _replanned_in_every_window,
            _obstacle_avoided_with_windows,
            _windows_lower_the_cost,
            _windows_reduce_the_time,
        )
        return tuple(check(self) for check in checks)


def run_study(advance: Callable[[str], None] = lambda done: None) -> Study:
    """Plan, verify and certify the four examples.

    Args:
        advance: called with the name of the example after each of the 4 x `REPEATS` runs.

    Raises:
        DrakeRhoError: an example has no solution.
    """
    scenario = load_scenario("paper")
    free = scenario.without_obstacles()
    methods: tuple[tuple[str, str, Callable[[], Plan | Flight]], ...] = (
        ("convex", "ignored", lambda: plan_convex(free)),
        ("convex", "avoided", lambda: plan_convex(scenario)),
        ("RHO", "ignored", lambda: plan_rho(free)),
        ("RHO", "avoided", lambda: plan_rho(scenario)),
    )
    plan_convex(scenario)  # not counted: the first solve of a process also starts its threads
    runs: list[list[Plan | Flight]] = [[] for _ in methods]
    rolling = list[Flight]()
    for _ in range(REPEATS):  # in turn, so that a slow phase of the machine affects all examples
        for number, (method, obstacle, make) in enumerate(methods, start=1):
            runs[number - 1].append(make())
            advance(f"Example {number}: {method}, obstacle {obstacle}")
        rolling.append(plan_rho(scenario, horizon=ROLLING))
    examples = [
        _example(number, method, obstacle, runs[number - 1])
        for number, (method, obstacle, _) in enumerate(methods, start=1)
    ]
    rolling.sort(key=lambda flight: flight.statistics.seconds)
    return Study(scenario, tuple(examples), rolling[len(rolling) // 2])


def _example(number: int, method: str, obstacle: str, runs: list[Plan | Flight]) -> Example:
    runs = sorted(runs, key=lambda run: run.statistics.seconds)
    result = runs[len(runs) // 2]  # the median; the runs differ only in time
    plan = result.plan
    return Example(number, method, obstacle, plan, result.flight, verify(plan), certify(plan))


def _obstacle_ignored(study: Study) -> Claim:
    example = study.examples[0]
    clearances = study.clearances(example)
    return Claim(
        1,
        "Example 1: bounds hold, the paths pass through the obstacle, all arrive at T",
        f"all constraints hold: {_yes(example)}; clearance {_list(clearances)} m",
        example.report.ok and bool(np.all(clearances < 0)),
    )


def _obstacle_avoided(study: Study) -> Claim:
    example = study.examples[1]
    clearances = study.clearances(example)
    return Claim(
        2,
        "Example 2: all vehicles avoid the obstacle (at the knots) and arrive at T; bounds hold",
        f"all constraints hold: {_yes(example)}; clearance {_list(clearances)} m",
        example.report.ok,
    )


def _replanned_in_every_window(study: Study) -> Claim:
    example = study.examples[2]
    replanned = sum(not window.infeasible for window in example.windows)
    jump = max(
        float(np.max(np.abs(window.plan.velocities[:, 0] - example.plan.velocities[:, k])))
        for window, k in ((window, window.first_knot) for window in example.windows)
    )
    return Claim(
        3,
        "Example 3: replanned in every window, each piece smooth, the constraints hold",
        f"{replanned} of {len(example.windows)} windows replanned; largest velocity jump "
        f"between windows {jump:.1e} m/s; all constraints hold: {_yes(example)}; "
        f"index {example.plan.cost:.3f}, Example 1 {study.examples[0].plan.cost:.3f}",
        example.report.ok and replanned == len(example.windows) and jump < 1e-6,
    )


def _obstacle_avoided_with_windows(study: Study) -> Claim:
    example = study.examples[3]
    return Claim(
        4,
        "Example 4: all constraints hold with the obstacle avoided",
        f"all constraints hold: {_yes(example)}; clearance {_list(study.clearances(example))} m",
        example.report.ok,
    )


def _windows_lower_the_cost(study: Study) -> Claim:
    once, horizon = study.examples[1].plan.cost, study.examples[3].plan.cost
    return Claim(
        5,
        "The index of Example 4 is smaller than that of Example 2",
        f"{horizon:.3f} against {once:.3f}: {100 * (1 - horizon / once):.1f} % less",
        horizon < once,
    )


def _windows_reduce_the_time(study: Study) -> Claim:
    once, example = study.examples[1].seconds, study.examples[3]
    windows = [window.statistics.seconds for window in example.windows]
    rolling = [1e3 * window.statistics.seconds for window in study.rolling.windows]
    arrival = max(
        waypoint.time or 0.0
        for window in study.rolling.windows
        for vehicle in window.plan.scenario.vehicles
        for waypoint in vehicle.waypoints
    )
    return Claim(
        6,
        "Splitting into windows greatly reduces the calculation time",
        f"all windows {1e3 * example.seconds:.1f} ms, one plan of the whole flight "
        f"{1e3 * once:.1f} ms: {example.seconds / once:.1f} times as long; one window "
        f"{1e3 * min(windows):.1f} to {1e3 * max(windows):.1f} ms; windows that roll, each "
        f"{ROLLING:g} s ahead: {min(rolling):.1f} to {max(rolling):.1f} ms, arrival at "
        f"{arrival:g} s",
        example.seconds < once,
    )


def _yes(example: Example) -> str:
    return "yes" if example.report.ok else "no"


def _list(values: FloatArray) -> str:
    return ", ".join(f"{value:.1f}" for value in values + 0.0).replace("-0.0", "0.0")
