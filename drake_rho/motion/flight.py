"""Records of flights with a receding horizon: `Window`, `Sighting`, `Flight`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from drake_rho.motion.measurements import Measurements
from drake_rho.motion.plan import Plan, summary
from drake_rho.motion.remainders import goes_on
from drake_rho.motion.samples import Samples
from drake_rho.motion.statistics import Statistics
from drake_rho.scenario.described import Described, ShownInNotebooks
from drake_rho.scenario.fields import Count, Finite, FloatArray, NotNegative, Ordinal, unchecked
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.rest_of_flight import going_on


@dataclasses.dataclass(frozen=True, eq=False)
class Window(metaclass=Described):
    """Window of a receding horizon: a prediction from one knot on, to the goal or to rest."""

    first_knot: int
    """first knot of the window, counted from 0"""
    plan: Plan
    """the whole prediction: up to the goal or, of a horizon that rolls, to a place of rest"""
    reference: Plan
    """motion around which obstacles were linearised"""
    infeasible: str = ""
    """empty, or the reason why no new plan was found; `plan` is then the remainder of the previous
    plan or, if that violates constraints known by now, a contingency or a plan of minimum
    violation"""
    learned: tuple[Ordinal, ...] = ()
    """numbers of the obstacles, from 1, that became known with this window"""
    not_avoided: tuple[Ordinal, ...] = ()
    """numbers of the obstacles, from 1, that its plan does not avoid"""
    kept: bool = False
    """true if its plan is the remainder of the previous one, which still satisfies all constraints
    in its old tube"""
    off_tube: tuple[str, ...] = ()
    """names of the vehicles that deviated from the previous plan by more than its tube and the
    estimation errors allow, and so were disturbed more than the scenario states"""
    unseen: tuple[str, ...] = ()
    """names of the vehicles whose states were not measured but predicted"""
    contingency: Plan | None = None
    """motion that follows `plan` up to the next window and then brakes to rest, clear of everything
    known; its goals are the stopping positions. None if not requested or not found"""
    no_contingency: str = ""
    """empty, or the reason why a requested contingency was not found"""
    stopping: bool = False
    """true if `plan` is a contingency that brakes to rest, flown because nothing else keeps
    clear"""
    skipped: Count = 0
    """number of steps by which it began later than it should have after the window before"""
    rest_until: Finite | None = None
    """time until which vehicles can stay where a window of a rolling horizon ends [s], as errors of
    obstacles grow; None if they can stay for ever, or for another horizon"""
    unreachable: tuple[str, ...] = ()
    """names of the vehicles whose goals no path was found to, with a rolling horizon"""
    cost_bound: NotNegative | None = None
    """upper bound on the cost of the flight from this window on [m²/s⁴], for any allowed
    disturbance, as long as nothing new becomes known; None if not requested"""

    def __repr__(self) -> str:
        """Return a short text, such as '<Window from knot 6: a new plan, cost 12.5 m²/s⁴>'."""
        kind = "a new plan" if not self.infeasible else "a plan of minimum violation"
        kind = "the rest of the previous plan" if self.kept else kind
        kind = "a contingency" if self.stopping else kind
        return f"<Window from knot {self.first_knot + 1}: {kind}, cost {self.plan.cost:.6g} m²/s⁴>"

    @property
    def braking(self) -> Plan | None:
        """Contingency from the step where it departs from the plan; None if there is none."""
        if self.contingency is None:
            return None
        steps = self.plan.accelerations.shape[1]
        own = self.contingency.accelerations[:, :steps]
        differs = (own != self.plan.accelerations).any(axis=(0, 2))
        if not differs.any():
            return None
        return self.contingency.tail(int(np.argmax(differs)))

    @property
    def statistics(self) -> Statistics:
        """Statistics with those of the reference; `seconds` is the whole window's wall time."""
        own = self.plan.statistics
        if self.reference is self.plan:
            return own
        return dataclasses.replace(self.reference.statistics + own, seconds=own.seconds)

    def after(self, spent: Statistics) -> Window:
        """Return the window with the statistics of earlier attempts added to its plan's."""
        return self._with(self.plan.with_statistics(spent + self.plan.statistics))

    def going_on(self, flown: FloatArray) -> Window:
        """Return the window with the accelerations flown before it, for a smoothing's averages."""

        def continued(plan: Plan) -> Plan:
            return unchecked(plan, scenario=going_on(plan.scenario, flown))

        stop = self.contingency and continued(self.contingency)
        own, reference = continued(self.plan), continued(self.reference)
        return unchecked(self, plan=own, reference=reference, contingency=stop)

    def lasting(self, seconds: float) -> Window:
        """Return the window with another wall time [s], which includes that of the reference."""
        return self._with(self.plan.lasting(seconds))

    def _with(self, plan: Plan) -> Window:
        """Return the window with a copy of its plan, also as reference if the plan is its own."""
        reference = plan if self.reference is self.plan else self.reference
        return unchecked(self, plan=plan, reference=reference)


@dataclasses.dataclass(frozen=True)
class Sighting:
    """Obstacle that became known during a flight, and whether it was avoided."""

    obstacle: str
    """name of the obstacle in reports"""
    time: float
    """start of the first window that takes it into account, on the scenario's clock [s]; the time
    at which it became known if there is no such window"""
    avoided: bool
    """true if the plans of all windows from then on avoid it"""
    planned_for: bool = True
    """true if there is such a window: no plan takes into account an obstacle that became known
    after the last window had begun"""


@dataclasses.dataclass(frozen=True, eq=False)
class Flight(ShownInNotebooks, metaclass=Described):
    """Flight of a scenario with a receding horizon, as it was flown.

    It is a sequence of pieces. A window that begins at measured states starts a new piece, to which
    the motion jumps; other windows continue the piece before.

    A log of the real flight may be added afterwards, with `dataclasses.replace(flight, measured=)`.

    Raises:
        ValueError: the measurements are of other vehicles, or from before the flight.
    """

    plan: Plan
    """the flown trajectories: each window from its initial states until the next window. Where
    these states were measured, the motion jumps (`Plan.jumps`)"""
    windows: tuple[Window, ...]
    """windows of the flight, in the order of time"""
    measured: Measurements | None = None
    """states measured in the flight, which it was not planned from; None without any"""

    def __post_init__(self) -> None:
        if self.measured is not None:
            self.measured.check_flight_of(self.scenario)
        if (scaled := _with_scales_of(self.windows, self.plan)) is not self.plan:
            object.__setattr__(self, "plan", scaled)

    @classmethod
    def composed(cls, scenario: Scenario, windows: Sequence[Window]) -> Self:
        """Return the flight of a scenario by windows, each flown until the next.

        A window that begins at measured states starts a new piece of the motion there. Other
        windows continue the piece before.
        """
        begins = beginnings(scenario, windows)
        ends = [*(window.first_knot for window in windows[1:]), scenario.grid.knots - 1]
        flown = [
            window.plan.accelerations[:, : end - window.first_knot]
            for window, end in zip(windows, ends, strict=True)
        ]
        statistics = sum((window.statistics for window in windows), Statistics())
        plan = Plan.in_pieces(scenario, np.concatenate(flown, axis=1), begins, statistics)
        return cls(plan, tuple(windows))

    def __repr__(self) -> str:
        """Return '<Flight of paper: 4 vehicles, 50 knots, 10 windows, cost 17027.2 m²/s⁴>'."""
        scenario, windows = summary(self.scenario), len(self.windows)
        return f"<Flight of {scenario}, {windows} windows, cost {self.cost:.6g} m²/s⁴>"

    @property
    def kind(self) -> Literal["flight"]:
        """Kind of the record."""
        return "flight"

    @property
    def flight(self) -> Flight:
        """The flight itself."""
        return self

    @property
    def simulation(self) -> None:
        """Simulation of the flight: none."""

    @property
    def scenario(self) -> Scenario:
        """The flown scenario, with the given starts, not the states measured there."""
        return self.plan.scenario

    @property
    def cost(self) -> float:
        """Performance index (13) of the commanded accelerations [m²/s⁴]."""
        return self.plan.cost

    def at(self, times: npt.ArrayLike, vehicle: str | None = None) -> Samples:
        """Return positions, velocities and accelerations at times; they are exact at any time.

        Where a window began at measured states they jump; at that time they are the measured ones.

        Args:
            times: times on the scenario's clock [s], shape (T,), or a single one.
            vehicle: name of one vehicle; all vehicles if not given.

        Returns:
            The record that `Plan.at` returns for the flown trajectories.

        Raises:
            ValueError: a time is outside the flight, or there is no such vehicle.
        """
        return self.plan.at(times, vehicle)

    def sampled(self, elapsed: FloatArray) -> Samples:
        """Return the flown states at times since the first knot [s]."""
        return self.plan.sampled(elapsed)

    @property
    def sightings(self) -> tuple[Sighting, ...]:
        """Obstacles that became known during the flight, in the order of time."""
        missed = {number for window in self.windows for number in window.not_avoided}
        planned_for = [
            Sighting(
                self.scenario.obstacle_name(number),
                window.plan.scenario.grid.start,
                number not in missed,
            )
            for window in self.windows
            for number in window.learned
        ]
        return (*planned_for, *self._unplanned)

    @property
    def _unplanned(self) -> list[Sighting]:
        """Obstacles that became known after the last window had begun, in the order of time."""
        last = self.windows[-1].plan if self.windows else self.plan
        known = {number for number, _ in last.scenario.known}
        late = [
            (obstacle.known_from, self.scenario.obstacle_name(number))
            for number, obstacle in enumerate(self.scenario.bodies, start=1)
            if number not in known
        ]
        return [
            Sighting(name, time, avoided=False, planned_for=False) for time, name in sorted(late)
        ]

    @property
    def statistics(self) -> Statistics:
        """Planning statistics of all windows together."""
        return self.plan.statistics

    def lasting(self, seconds: float) -> Flight:
        """Return the flight with another wall time of planning [s]."""
        return dataclasses.replace(self, plan=self.plan.lasting(seconds))


def _with_scales_of(windows: Sequence[Window], plan: Plan) -> Plan:
    """Return the motion of a flight with the scales of its windows, which give the tolerances.

    Windows of a rolling horizon are on shorter grids. On the grid of a long flight, tolerances of
    velocities and accelerations would be below the precision of the windows' programs.
    """
    scenario = plan.scenario
    if not windows or windows[0].plan.scenario.grid.knots == scenario.grid.knots:
        return plan
    own = [each.plan.scenario for each in windows]
    window = scenario.derived(grid=own[0].grid.from_knot(0))
    lengths = np.max([each.fleet.lengths for each in own], axis=0)
    return unchecked(plan, scenario=scenario.derived(fleet=window.fleet.reaching(lengths)))


def beginnings(scenario: Scenario, windows: Sequence[Window]) -> dict[int, FloatArray]:
    """Return the states, (N, 6) each, of windows that did not begin as planned, by first knots.

    Args:
        scenario: of the flight, from whose starts the first window is planned.
        windows: of the flight, in the order of time.
    """
    begins, fleet, planned = dict[int, FloatArray](), scenario.fleet, scenario.fleet.start_states
    for number, window in enumerate(windows):
        if number > 0:
            before = windows[number - 1]
            fleet = before.plan.scenario.fleet
            planned = before.plan.states(window.first_knot - before.first_knot)
        if not goes_on(fleet, planned, states := window.plan.states(0)):
            begins[window.first_knot] = states
    return begins
