"""Jerks of averages: changes of a plan's acceleration over the width of one average.

The jerk of one average over w is (a(t + w/2) - a(t - w/2)) / w; that of several is an average of
it. As w is at most a step, it is 0 or the difference of two accelerations, of neighbouring steps or
of rest and the first or last step, over w. These are the plan's own jerks (7) times h / w. So it is
in a convex set with 0 if the plan's jerks are in w / h times the set. The bound is tight with one
or two averages, and conservative with three.
"""

from __future__ import annotations

from drake_rho.scenario.records import Scenario


def jerk_factor(scenario: Scenario) -> float | None:
    """Return the factor w / h of jerk limits for the plan itself; None without averages.

    Args:
        scenario: the scenario.
    """
    smoothing = scenario.smoothing
    return None if smoothing is None else smoothing.width / scenario.grid.step
