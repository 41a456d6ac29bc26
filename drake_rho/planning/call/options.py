"""Tolerances and bounds that callers of planners may choose."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from drake_rho.scenario.fields import Count, record
from drake_rho.scenario.records import Scenario

SMALL_FLEET = 6
"""Largest fleet that is iterated to the tolerance `COUPLED_SMALL`, in vehicles."""

ALONE, COUPLED_SMALL, COUPLED, GROUPED, DECOUPLED = 1e-9, 1e-7, 1e-3, 2e-3, 5e-2
"""Default tolerances. In fleets with a separation every iteration moves all vehicles, and a further
digit takes as long as all digits before; small fleets are quick, and can be certified. In groups, a
cost that falls by less than the tolerance is at most a few per cent above its limit. Decoupled, the
cost falls ever more slowly and reaches no optimum, since vehicles cannot trade their
responsibilities for a separation."""

ALONE_AT_CORNERS, SMALL_AT_CORNERS, COUPLED_AT_CORNERS = 1e-6, 1e-4, 5e-3
"""Default tolerances among obstacles with corners or flat faces. Around these the cost converges in
ever smaller steps rather than at once, and no certificate needs its last digits."""


@record
class Options:
    """Tolerances and bounds of the iterated planners.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"), options=rho.Options(tolerance=1e-3))
        >>> plan.statistics.tolerance
        0.001
    """

    tolerance: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    """relative fall of the cost in one linearisation below which an iteration has converged. An
    uncoupled vehicle stops when its own cost falls by less than this fraction of the total. If not
    given: 1e-9; for fleets with a separation, or linked by requirements, 1e-7 up to six vehicles,
    1e-3 coupled, 2e-3 in groups and 5e-2 decoupled; among obstacles other than balls and
    ellipsoids 1e-6, 1e-4, 5e-3, 2e-3 and 5e-2. The plan's `statistics.tolerance` holds the value
    used"""
    max_iterations: Annotated[Count, Field(ge=1)] = 200
    """bound on the linearisations of one call; for fleets in groups, on the plans that result"""
    max_coupled: Annotated[Count, Field(ge=1)] = 15
    """largest fleet that is coupled by default, in vehicles"""
    max_group: Annotated[Count, Field(ge=1)] = 10
    """bound on the vehicles of a larger fleet that are coupled in one group; a fleet of up to twice
    as many is one group"""
    max_grouped: Annotated[Count, Field(ge=1)] = 500
    """largest fleet that is planned in groups by default where it is not coupled, in vehicles;
    planning in groups takes three times as long as planning decoupled"""
    max_ways: Annotated[Count, Field(ge=1)] = 6
    """bound on the paths around obstacles that are tried for one vehicle; the plan of least cost
    among them is chosen"""
    max_memory: Annotated[float, Field(ge=1e7)] = 1e9
    """memory that a path search may use [bytes]. Grids are made coarser until they fit; if none
    fits, the search reports it"""

    solver_options: Mapping[str, int | float | str] = dataclasses.field(default_factory=dict)
    """options of the planner's solver by its own names, as `{"max_iter": 500}`, in place of this
    package's; which there are is in the solver's documentation. Other solvers that follow after a
    failure do not get them"""

    time_limit: Annotated[float, Field(gt=0.0)] | None = None
    """seconds after which the best plan so far is returned (`statistics.cut`), or `OutOfTimeError`
    raised if there is none; the step of the search that is running then is finished first"""

    def tolerance_of(self, scenario: Scenario, *, together: bool, in_groups: bool = False) -> float:
        """Return the tolerance for a scenario.

        Args:
            scenario: to be planned.
            together: whether its pairs of vehicles are coupled.
            in_groups: whether they are planned in groups if not coupled.
        """
        if self.tolerance is not None:
            return self.tolerance
        shapes = [obstacle.shape for _, obstacle in scenario.avoided]
        corners = any(shape.has_corners for shape in shapes)
        linked = any(each.leader is not None for each in scenario.requirements)
        if scenario.separation is None and not linked:
            return ALONE_AT_CORNERS if corners else ALONE
        if scenario.separation is not None and not together:
            return GROUPED if in_groups else DECOUPLED
        if len(scenario.vehicles) <= SMALL_FLEET:
            return SMALL_AT_CORNERS if corners else COUPLED_SMALL
        return COUPLED_AT_CORNERS if corners else COUPLED


DEFAULTS = Options()
"""Options of calls that give none."""
