"""Drake systems: controller with a receding horizon, point masses in wind, winds, and an estimator.

A diagram's clock is 0 at the scenario's first knot, whatever `grid.start` is; plans, winds and
obstacles use the scenario's clock. `states` are positions [m] and velocities [m/s], six numbers for
each vehicle in turn; accelerations are three numbers for each vehicle in turn.
"""

from __future__ import annotations

from typing import Unpack, cast

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiscreteValues,
    EventStatus,
    LeafSystem,
    State,
)

from drake_rho.motion.flight import Flight
from drake_rho.planning.horizon.receding_horizon import RecedingHorizon
from drake_rho.planning.horizon.settings import Windows, refuse_settings, takes_windows
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.times import steps_begun
from drake_rho.simulation.estimates import EstimationErrors
from drake_rho.simulation.feedback import Feedback, Horizon, Memory
from drake_rho.simulation.small_windows import as_flown
from drake_rho.simulation.timeline import Timeline
from drake_rho.simulation.winds import Wind, checked_wind


class RecedingHorizonController(LeafSystem):
    """Feedback controller that tracks the plans of a receding horizon, for any Drake diagram.

    The first window is planned from the scenario's starts when the controller is made; during a
    simulation the controller never raises. Its abstract state consists of the current window and
    the feedback's memory and is updated at every sample of the feedback; windows begin at such
    samples. A horizon, and so its controller, can be used for one flight only.

    Ports: input `states` (6N), the estimated states; outputs `nominal` (9N: current planned
    position, velocity and acceleration of each vehicle in turn), `command` (3N: acceleration with
    feedback, constant between samples where the plan's is) and `ahead` (3N: the same for a plant
    with a lag, with planned accelerations commanded in advance).

    Args:
        source: a `rho.RecedingHorizon` that has not begun, or a scenario, for which one is made.
        lag: time that the plant takes to reach a command [s].
        delay: number of samples of the scenario's delay due to this lag.
        **windows: settings of windows, as for `RecedingHorizon`; for a scenario only.

    Raises:
        InfeasibleError: the first window has no plan.
        SolverError: the solvers fail numerically in the first window.
    """

    @checked
    @takes_windows
    def __init__(
        self,
        source: Horizon | Scenario,
        *,
        lag: float = 0.0,
        delay: int = 0,
        **windows: Unpack[Windows],
    ) -> None:
        super().__init__()
        if isinstance(source, Scenario):
            source = RecedingHorizon(source, **windows)
        else:
            refuse_settings(windows, "receding horizon")
        self._feedback, self._lag = Feedback(as_flown(source), delay), lag
        count = len(source.scenario.vehicles)
        self._states = self.DeclareVectorInputPort("states", 6 * count)
        self._memory = self.DeclareAbstractState(Value[object](self._feedback.start))
        memory = {self.abstract_state_ticket(self._memory)}
        self.DeclareVectorOutputPort("command", 3 * count, self._command, memory)
        self.DeclareVectorOutputPort(
            "nominal", 9 * count, self._nominal, memory | {self.time_ticket()}
        )
        self.DeclareVectorOutputPort("ahead", 3 * count, self._ahead, memory | {self.time_ticket()})
        self.DeclareInitializationUnrestrictedUpdateEvent(self._begin)
        self.DeclarePeriodicUnrestrictedUpdateEvent(self._feedback.sample, 0.0, self._update)

    @property
    def flight(self) -> Flight:
        """Windows so far, as a flight."""
        return self._feedback.horizon.flight

    def _begin(self, context: Context, state: State) -> EventStatus:
        if len(self.flight.windows) > 1:
            raise ValueError("controller: got a second flight, expected one flight per controller")
        return EventStatus.DidNothing()

    def _update(self, context: Context, state: State) -> EventStatus:
        j = int(steps_begun(context.get_time(), self._feedback.sample))
        estimate = self._states.Eval(context).reshape(-1, 6)
        memory = self._feedback.next(self._remembered(context), j, estimate)
        state.get_mutable_abstract_state(self._memory).set_value(memory)
        return EventStatus.Succeeded()

    def _remembered(self, context: Context) -> Memory:
        return cast(Memory, context.get_abstract_state(self._memory).get_value())

    def _command(self, context: Context, output: BasicVector) -> None:
        memory = self._remembered(context)
        if memory.commands:
            output.SetFromVector(memory.commands[-1].reshape(-1))
        else:  # before the first sample
            output.SetFromVector(memory.window.plan.accelerations[:, 0].reshape(-1))

    def _ahead(self, context: Context, output: BasicVector) -> None:
        memory, time = self._remembered(context), context.get_time()
        output.SetFromVector(self._feedback.commanded(memory, time, self._lag).reshape(-1))

    def _nominal(self, context: Context, output: BasicVector) -> None:
        window = self._remembered(context).window
        planned = self._feedback.nominal(window, context.get_time())
        output.SetFromVector(np.concatenate(planned, axis=1).reshape(-1))


class WindyPointMass(LeafSystem):
    """Point masses, p'' = acceleration + wind, that begin at a scenario's starts.

    The state is continuous. If both inputs come from the systems of this module, they are constant
    between two events of a diagram, so the motion is quadratic in time there. Every integrator of
    Drake of order two or more is then exact to rounding, whatever its steps.

    Ports: inputs `acceleration` and `wind` (3N each), each 0 if not connected; output `states`
    (6N).
    """

    @checked
    def __init__(self, scenario: Scenario) -> None:
        super().__init__()
        fleet = scenario.fleet
        count = 3 * len(scenario.vehicles)
        self._inputs = [
            self.DeclareVectorInputPort(name, count) for name in ("acceleration", "wind")
        ]
        start = np.concatenate([fleet.start_positions.ravel(), fleet.start_velocities.ravel()])
        self.DeclareContinuousState(BasicVector(start), count, count, 0)
        self.DeclareVectorOutputPort("states", 2 * count, self._report, {self.all_state_ticket()})

    def DoCalcTimeDerivatives(  # noqa: N802  # Drake's name
        self, context: Context, derivatives: ContinuousState
    ) -> None:
        """Set the derivatives: velocities, and the sum of the accelerations."""
        v = context.get_continuous_state_vector().CopyToVector()
        v = v[len(v) // 2 :]
        given = (port.Eval(context) for port in self._inputs if port.HasValue(context))
        a = sum(given, np.zeros_like(v))
        derivatives.get_mutable_vector().SetFromVector(np.concatenate([v, a]))

    def _report(self, context: Context, output: BasicVector) -> None:
        p, v = context.get_continuous_state_vector().CopyToVector().reshape(2, -1, 3)
        output.SetFromVector(np.concatenate([p, v], axis=1).reshape(-1))


class WindSource(LeafSystem):
    """Wind evaluated at the beginning of each step of the simulator and held over the step.

    Ports: input `states` (6N), for winds that depend on them; output `wind` (3N).

    Args:
        scenario: scenario with the vehicles and the clock.
        wind: wind to evaluate.
        timeline: times at which to evaluate the wind, so that rounding of Drake's clock does not
            matter; if not given, the clock's times are used.
    """

    @checked
    def __init__(self, scenario: Scenario, wind: Wind, timeline: Timeline | None = None) -> None:
        super().__init__()
        self._wind, self._timeline, self._start = wind, timeline, scenario.grid.start
        count = len(scenario.vehicles)
        self._states = self.DeclareVectorInputPort("states", 6 * count)
        self.DeclareStateOutputPort("wind", self.DeclareDiscreteState(3 * count))
        self.DeclarePerStepDiscreteUpdateEvent(self._update)

    def _update(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        elapsed = context.get_time()
        time = self._start + elapsed
        if self._timeline is not None:
            time = self._timeline.nearest(elapsed)
        states = self._states.Eval(context).reshape(-1, 6)
        found = checked_wind(self._wind, time, states[:, :3], states[:, 3:])
        discrete.set_value(found.reshape(-1))
        return EventStatus.Succeeded()


class Estimator(LeafSystem):
    """Estimator that adds the estimation errors of the current sample to true states.

    Ports: input and output `states` (6N).
    """

    @checked
    def __init__(self, scenario: Scenario, errors: EstimationErrors, sample: float) -> None:
        super().__init__()
        self._errors, self._sample = errors, sample
        count = 6 * len(scenario.vehicles)
        self._true = self.DeclareVectorInputPort("states", count)
        self.DeclareVectorOutputPort("states", count, self._estimate)

    def _estimate(self, context: Context, output: BasicVector) -> None:
        j = int(steps_begun(context.get_time(), self._sample))
        true: FloatArray = self._true.Eval(context).reshape(-1, 6)
        output.SetFromVector(self._errors.added_to(j, true).reshape(-1))
