"""Table of how each kind of requirement is verified; unknown kinds raise."""

from __future__ import annotations

from collections.abc import Iterable

from drake_rho.scenario.kinds import kinds_of
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Column

_OF_OBSTACLES = "in the check of the obstacle"

TREATMENT = {
    "dynamics": "states against those that accelerations lead to",
    "goals": "position and velocity at the last knot",
    "position": "sides of the box, at the knots and at every instant",
    "velocity": "sides of the box at the knots",
    "acceleration": "sides of the box in every step",
    "jerk": "sides of the box at the knots",
    "max_speed": "norm at the knots, with errors at the samples of the feedback",
    "max_acceleration": "norm in every step",
    "max_thrust": "norm of a + g e_z in every step",
    "max_tilt": "angle of a + g e_z in every step, with errors the distance from the cone",
    "max_jerk": "norm at the knots",
    "waypoints": "distance at the waypoint's time",
    "requirements": "signed distance from the set, of positions at every instant",
    "obstacles": "distance at the knots and at every instant",
    "moving obstacles": f"{_OF_OBSTACLES}, where it is at the time",
    "late obstacles": f"{_OF_OBSTACLES}, once it is known; before that in a row of its own",
    "active obstacles": f"{_OF_OBSTACLES}, in its interval of time",
    "uncertain obstacles": f"{_OF_OBSTACLES}, as the distance from where it may be",
    "separation": "distance of every pair at the knots and at every instant",
    "disturbance": "every check with the radius of the errors",
    "holding": "every check at goals for ever, with the largest radii from the end on",
    "smoothing": "every check is of the averages, which are computed anew",
}
"""Verification of every kind of requirement."""

_WITHOUT_COLUMNS = {
    "dynamics",  # records of quadrotors have dynamics of their own
    "moving obstacles",
    "late obstacles",
    "active obstacles",
    "uncertain obstacles",
    "disturbance",
    "smoothing",
}
"""Kinds without a check of their own."""


def refuse_unchecked(scenario: Scenario, columns: Iterable[Column]) -> None:
    """Raise an error if a kind of requirement of a scenario was not checked.

    Raises:
        NotImplementedError: a kind was not checked; the report would be incomplete.
    """
    kinds = kinds_of(scenario)
    checked = TREATMENT.keys() & {*_WITHOUT_COLUMNS, *(column.kind for column in columns)}
    _refuse(kinds - checked)


def refuse_unknown(scenario: Scenario) -> None:
    """Raise an error if the verifier does not know a kind of requirement of a scenario.

    Raises:
        NotImplementedError: a kind is unknown.
    """
    _refuse(kinds_of(scenario) - TREATMENT.keys())


def _refuse(kinds: set[str]) -> None:
    if kinds:
        raise NotImplementedError(f"verify: nothing checks {', '.join(sorted(kinds))}")
