"""Windows of a vehicle that plans for itself: a horizon that rolls and forgets the past."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.motion.flight import Window
from drake_rho.motion.plan import Plan
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.time_limit import within_time
from drake_rho.planning.horizon.interfaces import Planner
from drake_rho.planning.horizon.receding_horizon import Proposal, RecedingHorizon
from drake_rho.planning.horizon.situation import Situation
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.parts import State
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_lasting


class OwnWindows(RecedingHorizon):
    """Windows of one vehicle that begins at rest, each planned among what is known now alone.

    Args:
        scenario: of the vehicle, without other vehicles.
        horizon: time that every window plans ahead [s].
        planner: planner of one window.
        fallback: planner of a window if `planner` has no solution.
        solver: of the programs.
        options: of the package's planners.
    """

    def __init__(
        self,
        scenario: Scenario,
        horizon: float,
        planner: Planner,
        fallback: Planner | None,
        *,
        solver: Solver | SolverName | None,
        options: Options | None,
    ) -> None:
        super().__init__(
            scenario,
            replan_every=1,
            horizon=horizon,
            planner=planner,
            fallback=fallback,
            solver=solver,
            options=options,
        )
        self._steps = steps_lasting(horizon, scenario.grid.step)
        self.accept(self._at_rest())

    @property
    def last(self) -> Window:
        """Window that is flown."""
        return self.windows[-1]

    def _at_rest(self) -> Proposal:
        """Return the window of a vehicle that stays at its start."""
        situation, scenario = self._situation, self.scenario
        grid = scenario.grid.from_knot(0, self._steps)
        vehicles = tuple(
            unchecked(each, goal=State(each.start.position)) for each in scenario.vehicles
        )
        still = scenario.derived(grid=grid, vehicles=vehicles)
        plan = Plan.from_accelerations(still, np.zeros((len(vehicles), grid.knots - 1, 3)))
        window = Window(0, plan, plan)
        return Proposal(window, situation.with_window(window))

    def among(self, scenario: Scenario, time: float) -> Proposal:
        """Plan the next window, from the planned state at a knot.

        Args:
            scenario: the vehicle's, as it is known now.
            time: of the knot [s].
        """
        now = Situation.of(scenario, self.latency)
        if self._rolling is not None:
            now = self._rolling.begun(now)
        known = dataclasses.replace(now.known, has_news=True, is_new=True)
        situation = dataclasses.replace(now, known=known, last=self.last)
        states = np.full((len(scenario.vehicles), 6), np.nan)
        with within_time(self._options.time_limit):
            window = self._window(situation, states, time)
        return Proposal(window, situation.with_window(window))

    def accept(self, proposal: Proposal) -> None:
        """Fly a proposed window from its first knot on, and forget those before."""
        super().accept(proposal)
        del self.windows[:-1]
