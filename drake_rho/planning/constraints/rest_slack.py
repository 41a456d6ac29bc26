"""Slack of vehicles that hold at their goals after the end: a check before planning.

The verifier judges goals without a plan (`drake_rho.verification.rest`), so its margins are the
slack. A pair of vehicles shares its slack.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.motion.tube import ErrorTube
from drake_rho.planning.constraints.slack import TighteningSlack
from drake_rho.scenario.parts import UNITS, Quantity
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Column
from drake_rho.verification.rest import Rest

_WHERE = "held goal"
"""Place of the comparison, as in 'obstacle 1 (held goal 0.1 m inside, of 0.2)'."""

_QUANTITIES: dict[str, Quantity] = {unit: quantity for quantity, unit in UNITS.items()}

_AFTER_LIMITS = ("obstacles", "separation", "requirements")
"""Kinds that follow the limits in messages; limits are in the order of their quantities."""


def slacks_at_rest(scenario: Scenario, tube: ErrorTube | None) -> Iterator[TighteningSlack]:
    """Yield the slack of every constraint for vehicles that hold at their goals after the end.

    Args:
        scenario: the scenario.
        tube: error tube of plans at their end; None without a disturbance.
    """
    if not scenario.hold_at_goal or (rest := Rest.of(scenario, tube)) is None:
        return
    radii, required = rest.radii(), (each for each in rest.columns_without_errors() if each.asked)
    for column in sorted(required, key=_place):
        quantity = _QUANTITIES[column.unit]
        vehicles = 1.0 if column.partners is None else 2.0
        available = np.where(column.concerned, -column.excess / vehicles, np.inf)
        needed = np.where(np.isposinf(available), 0.0, radii[quantity])
        yield TighteningSlack(
            column.constraint, _WHERE, quantity, available, needed, column.tolerances
        )


def _place(column: Column) -> tuple[int, int]:
    """Return the place of a constraint in messages."""
    if column.kind in _AFTER_LIMITS:
        return 1 + _AFTER_LIMITS.index(column.kind), 0
    return 0, list(_QUANTITIES).index(column.unit)
