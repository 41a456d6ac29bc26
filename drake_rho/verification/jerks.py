"""Jerks of plans: changes of acceleration, including those at the start and the goal."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario

_NAMED = 3
"""Largest number of vehicles that a note names."""


@dataclasses.dataclass(frozen=True, eq=False)
class Jerks:
    """Jerks of motions at K instants where accelerations jump, such as the knots of a plan."""

    elapsed: FloatArray
    """instants since the first knot [s], shape (K,)"""
    values: FloatArray
    """change of acceleration at each instant over the step, including the accelerations before the
    start and after the goal [m/s³], shape (N, K, 3)"""
    free: BoolArray
    """mask of unknown jerks, which are not limited, shape (N, K)"""
    error: float = 0.0
    """error radius: 0 for plans, infinite for motions of which only samples are known [m/s³]"""

    @classmethod
    def of(cls, scenario: Scenario, accelerations: FloatArray) -> Jerks:
        """Return the jerks of a plan with accelerations (N, K-1, 3)."""
        return cls.at_joints(scenario, scenario.grid.elapsed, accelerations, accelerations)

    @classmethod
    def at_joints(
        cls,
        scenario: Scenario,
        elapsed: FloatArray,
        begun: FloatArray,
        ended: FloatArray,
        error: float = 0.0,
    ) -> Jerks:
        """Return the jerks between pieces of time.

        Args:
            scenario: scenario of the motions.
            elapsed: instants, as the field.
            begun: accelerations at the beginnings of the pieces [m/s²], shape (N, K-1, 3).
            ended: accelerations at their ends [m/s²], shape (N, K-1, 3).
            error: error radius, as the field.
        """
        free = _unknown(scenario)
        outside = scenario.fleet.accelerations_before, scenario.fleet.accelerations_after
        first, last = (each[:, None] for each in outside)
        before = np.concatenate([first, ended], axis=1)
        after = np.concatenate([begun, last], axis=1)
        values = (after - before) / scenario.grid.step
        inner = np.zeros((len(values), values.shape[1] - 2), dtype=bool)
        return cls(elapsed, values, np.column_stack([free[0], inner, free[1]]), error)

    @classmethod
    def at_rest(cls, scenario: Scenario) -> Jerks:
        """Return the jerks of vehicles at rest, which are zero."""
        count = len(scenario.vehicles), scenario.grid.knots
        elapsed = scenario.grid.elapsed
        return cls(elapsed, np.zeros((*count, 3)), np.zeros(count, dtype=bool))

    @property
    def none(self) -> Jerks:
        """Jerks of motions whose accelerations do not jump: at no instant."""
        return Jerks(self.elapsed[:0], self.values[:, :0], self.free[:, :0])

    @property
    def limited(self) -> FloatArray:
        """Values with zero for unlimited jerks, shape (N, K, 3)."""
        return np.where(self.free[..., None], 0.0, self.values)


def _unknown(scenario: Scenario) -> tuple[BoolArray, BoolArray]:
    """Return masks of unknown accelerations before the start and after the goal, (N,) each."""
    fleet = scenario.fleet
    outside = fleet.accelerations_before, fleet.accelerations_after
    before, after = (np.asarray(np.isnan(each).any(axis=1)) for each in outside)
    return before, after


def notes_on_free_jerks(scenario: Scenario) -> tuple[str, ...]:
    """Return notes on starts and goals in motion where the jerk is not limited."""
    grid, notes = scenario.grid, list[str]()
    for end, time, free in zip(
        ("start", "goal"), (grid.start, grid.end), _unknown(scenario), strict=True
    ):
        found = (free & _limited_at(scenario, time)).nonzero()[0]
        if len(found) > 0:
            names = [scenario.names[vehicle] for vehicle in found[:_NAMED]]
            more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
            notes.append(
                f"the jerk at the {end} is not limited for {', '.join(names)}{more}: in motion "
                f"there, with no {end}.acceleration given"
            )
    return tuple(notes)


def _limited_at(scenario: Scenario, time: float) -> BoolArray:
    """Return the mask of vehicles whose jerks are limited at a time, shape (N,)."""
    limited, grid = np.zeros(len(scenario.vehicles), dtype=bool), scenario.grid
    if (box := scenario.fleet.bounds("jerk")) is not None:
        limited |= np.isfinite(box.lower).any(axis=1) | np.isfinite(box.upper).any(axis=1)
    if (norm := scenario.fleet.norms.get("max_jerk")) is not None:
        limited |= np.isfinite(norm.limits)
    for each in scenario.required:
        at = each.interval(grid)
        if each.quantity != "jerk" or at is None:
            continue
        if grid.clock.within(time, at):
            limited[each.members(scenario.names)] = True
            if (partner := each.partner(scenario.names)) is not None:
                limited[partner] = True
    return limited
