"""The list of checkers, by which plans, windows of flights and rests at goals are verified."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from drake_rho.scenario.kinds import kinds_of
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.records import Scenario
from drake_rho.verification.boxes import check_boxes
from drake_rho.verification.check import Column
from drake_rho.verification.norms import check_norms
from drake_rho.verification.obstacles import check_obstacle
from drake_rho.verification.quick_bounds import QuickBounds
from drake_rho.verification.requirements import check_requirements
from drake_rho.verification.separation import check_separation
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.waypoints import check_waypoints


def _undecided(bounds: QuickBounds) -> bool:
    return False


@dataclasses.dataclass(frozen=True)
class Checker:
    """Check of some kinds of requirements."""

    kinds: tuple[str, ...]
    """kinds of its columns"""
    check: Callable[[PiecewiseTrajectory], Iterator[Column]]
    """full check"""
    surely_holds: Callable[[QuickBounds], bool] = _undecided
    """quick sufficient condition that all columns hold"""
    at_rest: bool = True
    """whether it applies to vehicles that hold at their goals after the end"""


def checkers(obstacles: Iterable[int]) -> list[Checker]:
    """Return the checkers of everything that a trajectory has to satisfy, in the order of reports.

    Args:
        obstacles: numbers of the obstacles, from 1.
    """
    return [
        Checker(
            ("position", "velocity", "acceleration", "jerk"), check_boxes, QuickBounds.boxes_hold
        ),
        Checker((*NORMS,), check_norms, QuickBounds.norms_hold),
        Checker(("waypoints",), check_waypoints, at_rest=False),
        Checker(("requirements", "goals"), check_requirements),
        *map(obstacle_checker, obstacles),
        Checker(("separation",), check_separation, QuickBounds.all_keep_apart),
    ]


def obstacle_checker(number: int) -> Checker:
    """Return the checker of one obstacle, by its number from 1."""
    check = partial(check_obstacle, number=number)
    return Checker(("obstacles",), check, lambda bounds: bounds.obstacle_is_avoided(number))


_TAKEN_INTO_ACCOUNT = frozenset(
    (
        "dynamics",  # records of quadrotors have dynamics of their own
        "moving obstacles",
        "late obstacles",
        "active obstacles",
        "uncertain obstacles",
        "disturbance",
        "smoothing",
    )
)
"""Kinds without a check of their own: other checks take them into account."""

KNOWN = _TAKEN_INTO_ACCOUNT.union(
    ("goals", "holding"), *(each.kinds for each in checkers(obstacles=[1]))
)
"""All kinds that are verified."""


def refuse_unchecked(scenario: Scenario, columns: Iterable[Column]) -> None:
    """Raise an error if a kind of requirement of a scenario was not checked.

    Raises:
        NotImplementedError: a kind was not checked; the report would be incomplete.
    """
    _refuse(kinds_of(scenario) - _TAKEN_INTO_ACCOUNT.union(each.kind for each in columns))


def refuse_unknown(scenario: Scenario) -> None:
    """Raise an error if the verifier does not know a kind of requirement of a scenario.

    Raises:
        NotImplementedError: a kind is unknown.
    """
    _refuse(kinds_of(scenario) - KNOWN)


def _refuse(kinds: set[str]) -> None:
    if kinds:
        raise NotImplementedError(f"verify: nothing checks {', '.join(sorted(kinds))}")
