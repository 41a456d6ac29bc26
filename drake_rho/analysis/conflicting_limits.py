"""Limits in conflicts: candidates for changes that give a plan."""

from __future__ import annotations

import re
from collections.abc import Mapping

from drake_rho.analysis.adjustable import Adjustable
from drake_rho.planning.errors import InfeasibleError, Names


def has_no_path(error: InfeasibleError) -> bool:
    """Return whether a path search has shown that there is no path, at any speed."""
    searched = error.statistics.searched
    return searched is not None and searched.ways == 0 and searched.layers == 0


def may_help(each: Adjustable, error: InfeasibleError, conflicts: Mapping[str, Names]) -> bool:
    """Return whether a limit is in every conflict, so that changing it alone may give a plan."""
    if has_no_path(error) and each.name not in ("obstacle", "position box"):
        return False
    return all(_is_in(each, vehicle, error, conflicts) for vehicle in conflicts)


def _is_in(
    each: Adjustable, vehicle: str, error: InfeasibleError, conflicts: Mapping[str, Names]
) -> bool:
    """Return whether a limit is part of a vehicle's conflict.

    A conflict with linearised obstacles or pairs names only some of the limits that may help.
    """
    if vehicle not in each.vehicles:
        return False
    if error.obstacles.get(vehicle):
        pairs = 0 in error.obstacles[vehicle]
        return pairs if each.name == "separation" else True
    return is_named(each, {vehicle: conflicts[vehicle]})


def is_named(each: Adjustable, conflicts: Mapping[str, Names]) -> bool:
    """Return whether a limit is named in a conflict."""
    named = re.compile(re.escape(each.name) + r"(?!\d)")
    return any(named.match(name) for names in conflicts.values() for name in names)
