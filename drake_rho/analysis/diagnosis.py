"""Result of `diagnose`, with its printed form."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Check

_LINES, _REASONS, _SHOWN = 12, 3, 5
"""Largest numbers of lines of a printed diagnosis, and of vehicles and violations in it."""

_CUT = "time was up before everything was tried: smaller changes may suffice"


@dataclasses.dataclass(frozen=True)
class Diagnosis(metaclass=Described):
    """Reason why a scenario has no plan, and changes that give one; prints in 12 lines at most."""

    scenario: Scenario
    """scenario that was diagnosed"""
    conflicts: dict[str, tuple[str, ...]]
    """for each vehicle without a plan, constraints that cannot be met together; empty if there is
    a plan"""
    violations: tuple[Check, ...]
    """violations of the motion with the least total violation, the worst first"""
    shortest_duration: float | None
    """least duration T for which a plan was found with everything else unchanged [s]; None if none
    was found up to `diagnose.LARGEST_FACTOR` times the scenario's duration"""
    longest_duration: float | None
    """greatest duration T for which a plan was found [s], if plans were found for shorter durations
    than the scenario's only; else None. A longer duration is not always possible with a
    disturbance, moving obstacles, waypoints, or motion at start or goal"""
    is_monotone: bool
    """whether a plan for one duration implies a plan for every longer one, so that the shortest
    duration is exact to `diagnose.PRECISION`; else shorter ones may have been missed"""
    acceleration_factor: float | None
    """least factor on every acceleration box and every maximum acceleration for which a plan was
    found, with thrust and tilt unchanged; None if there is no such limit, or if no factor up to
    `diagnose.LARGEST_FACTOR` was found to help"""
    premise: str = ""
    """assumption under which the conflicts are proved, as in 'with the margins that are kept for
    the disturbance'; empty if they are proved for the scenario itself"""
    bearable_wind: float | None = None
    """if there is a plan without the disturbance, the largest wind for which one was found, with
    the feedback that is best for this wind and all else unchanged [m/s²]; 0 if the estimation
    errors alone leave no plan; None if there is no plan without the disturbance either, or no
    disturbance"""

    cut: bool = False
    """whether time was up before all trials were made, so that smaller changes may suffice"""

    @property
    def feasible(self) -> bool:
        """True if a plan was found after all."""
        return not self.conflicts

    def __str__(self) -> str:
        return f"{self.reason}\n{self.remedy}".rstrip()

    @property
    def reason(self) -> str:
        """Constraints that cannot be met together, in five lines at most, or that a plan exists."""
        if self.feasible:
            cut = f"; {_CUT}" if self.cut else ""
            return f"{self.scenario.name}: there is a plan{self._shorter()}{cut}"
        shown = list(self.conflicts.items())[:_REASONS]
        more = len(self.conflicts) - len(shown)
        premise = f" {self.premise}" if self.premise else ""
        return "\n".join(
            [
                f"{self.scenario.name}: no plan was found; these constraints cannot be met together"
                f"{premise}:",
                *(f"  {vehicle}: {', '.join(names)}" for vehicle, names in shown),
                *([f"  and {more} more vehicles"] if more > 0 else []),
            ]
        )

    @property
    def remedy(self) -> str:
        """Least total violation, and changes with which there is a plan; empty if there is one."""
        if self.feasible:
            return ""
        violations = [
            f"  {one.vehicle}: {one.what} by {one.excess:.3g} {one.unit} at {one.time:.4g} s"
            for one in self.violations[:_SHOWN]
        ]
        below, above = [*self._disturbed(), *self._repairs()], len(self.reason.splitlines())
        return "\n".join(
            [
                *(["the motion with the least total violation violates"] if violations else []),
                *violations[: _LINES - above - 1 - len(below)],
                *below,
                *([_CUT] if self.cut else []),
            ]
        )

    def _duration(self, shortest: float) -> str:
        steps, note = self.scenario.grid.knots - 1, "" if self.is_monotone else " or perhaps less"
        return (
            f"a duration of {_rounded_up(shortest)} s{note} instead of "
            f"{self.scenario.grid.duration:.5g} s (a step of {_rounded_up(shortest / steps)} s)"
        )

    def _shorter(self) -> str:
        """Return the shortest duration for a scenario that has a plan, as the end of a sentence."""
        shortest = self.shortest_duration
        if shortest is None or shortest >= self.scenario.grid.duration:
            return ""
        return f", down to {self._duration(shortest)}"

    def _repairs(self) -> list[str]:
        changes = []
        if self.longest_duration is not None:
            changes.append(
                f"a duration of {_rounded_down(self.longest_duration)} s or perhaps another "
                f"instead of {self.scenario.grid.duration:.5g} s"
            )
        elif self.shortest_duration is not None:
            changes.append(self._duration(self.shortest_duration))
        if self.acceleration_factor is not None:
            changes.append(
                f"acceleration limits {_rounded_up(self.acceleration_factor)} times as wide"
            )
        disturbance = self.scenario.disturbance
        if disturbance is not None and self.bearable_wind:
            changes.append(
                f"wind up to {_rounded_down(self.bearable_wind)} m/s² instead of "
                f"{disturbance.acceleration:.5g} m/s²"
            )
        if not changes and self.cut:
            return []  # nothing is known
        if not changes:
            return ["no plan was found with more time or with wider acceleration limits either"]
        heads = ["there is a plan with", *["or with"] * (len(changes) - 1)]
        return [f"{head} {change}" for head, change in zip(heads, changes, strict=True)]

    def _disturbed(self) -> list[str]:
        """Return a line on whether the disturbance is the reason, or no line if it is not."""
        if self.bearable_wind is None:
            return []
        if self.bearable_wind == 0.0:
            alone = "with the estimation errors alone there is none"
            return [f"without a disturbance there is a plan; {alone}"]
        return ["without a disturbance there is a plan"]


def _rounded_up(value: float) -> str:
    """Return a value rounded up to five digits, so that it is no less than what was found."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 4)
    return f"{np.ceil(value / unit * (1 - 1e-12)) * unit:.5g}"


def _rounded_down(value: float) -> str:
    """Return a value rounded down to five digits, so that it is no more than what was found."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 4)
    return f"{np.floor(value / unit * (1 + 1e-12)) * unit:.5g}"
