"""Tolerances and bounds that a caller may choose."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from drake_rho.scenario.fields import Count, record
from drake_rho.scenario.records import Scenario

SMALL_FLEET = 6
"""Vehicles up to which a fleet is iterated to `COUPLED_SMALL`."""

ALONE, COUPLED_SMALL, COUPLED, GROUPED, DECOUPLED = 1e-9, 1e-7, 1e-3, 2e-3, 5e-2
"""Tolerances where none is given. In fleets that keep apart every iteration moves all vehicles and
a further digit takes as long as all before; small ones are quick, and can be certified. In groups,
at most a few per cent are left where the cost falls by less. Decoupled, it falls ever more slowly,
and to no optimum: what trading room could gain is left."""

ALONE_AT_CORNERS, SMALL_AT_CORNERS, COUPLED_AT_CORNERS = 1e-6, 1e-4, 5e-3
"""The same among obstacles that have corners or flat sides: past these the cost falls in ever
smaller steps rather than to its last digit at once, and no certificate asks for one."""


@record
class Options:
    """Tolerances and bounds of the iterated planners.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"), options=rho.Options(tolerance=1e-3))
        >>> plan.statistics.tolerance
        0.001
    """

    tolerance: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    """relative fall of the cost in one linearisation below which an iteration has converged; a
    vehicle that nothing couples stops when its part falls by less than this part of the whole. If
    not given: 1e-9, and for fleets that keep apart 1e-7 up to six vehicles, 1e-3 coupled, 2e-3 in
    groups and 5e-2 decoupled; among obstacles other than balls and ellipsoids 1e-6, 1e-4, 5e-3,
    2e-3 and 5e-2. It stands in the plan's `statistics.tolerance`"""
    max_iterations: Annotated[Count, Field(ge=1)] = 200
    """bound on the linearisations of one call; of those in groups, on the plans they lead to"""
    max_coupled: Annotated[Count, Field(ge=1)] = 15
    """vehicles up to which a fleet is coupled if nothing else is asked"""
    max_group: Annotated[Count, Field(ge=1)] = 10
    """bound on the vehicles of a larger fleet that are coupled in one group; a fleet of up to twice
    as many is one group"""
    max_grouped: Annotated[Count, Field(ge=1)] = 500
    """vehicles up to which a fleet that is not coupled is planned in groups if nothing else is
    asked; groups take three times as long as planning a larger one decoupled"""
    max_ways: Annotated[Count, Field(ge=1)] = 6
    """bound on the ways past obstacles that are tried for one vehicle; the plan of least cost among
    them is kept"""
    max_memory: Annotated[float, Field(ge=1e7)] = 1e9
    """bytes that a search for ways may take: grids are as coarse as that asks for, and where none
    is small enough the search says so"""

    time_limit: Annotated[float, Field(gt=0.0)] | None = None
    """seconds after which the best plan so far is returned (`statistics.cut`), or `OutOfTimeError`
    raised where there is none; a single step of the search that is under way then is ended first"""

    def tolerance_of(self, scenario: Scenario, *, together: bool, in_groups: bool = False) -> float:
        """The tolerance for a scenario, whose pairs are coupled (`together`), in groups, or not."""
        if self.tolerance is not None:
            return self.tolerance
        shapes = [obstacle.shape for _, obstacle in scenario.known]
        corners = any(shape.quadric_inside(0.0) is None for shape in shapes)
        if scenario.separation is None:
            return ALONE_AT_CORNERS if corners else ALONE
        if not together:
            return GROUPED if in_groups else DECOUPLED
        if len(scenario.vehicles) <= SMALL_FLEET:
            return SMALL_AT_CORNERS if corners else COUPLED_SMALL
        return COUPLED_AT_CORNERS if corners else COUPLED


DEFAULTS = Options()
"""What is taken where no options are given."""
