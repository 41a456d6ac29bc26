"""What `diagnose` found, and how it prints."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.verification.report import Check

_LINES, _REASONS, _SHOWN = 12, 3, 5
"""Lines of a printed diagnosis, and vehicles and breaches that it shows, all at most."""


_CUT = "time was up before everything was tried: less than what is told may be enough"


@dataclasses.dataclass(frozen=True)
class Diagnosis(metaclass=Described):
    """Why there is no plan, and what would mend it; prints in at most twelve lines."""

    scenario: Scenario
    """what was asked"""
    conflicts: dict[str, tuple[str, ...]]
    """for each vehicle without a plan, constraints that cannot be met together; empty if there is
    a plan"""
    violations: tuple[Check, ...]
    """what the motion breaks that breaks the constraints least in total, the worst first"""
    shortest_duration: float | None
    """least T for which a plan was found with everything else unchanged [s]; None if there is none
    up to `feasibility.LARGEST_FACTOR` times the scenario's"""
    longest_duration: float | None
    """where a plan was found for a shorter T only, the greatest such T [s]: longer is not always
    possible with a disturbance, obstacles that move, waypoints, or motion at start or goal; else
    None"""
    is_monotone: bool
    """whether a plan for one duration means a plan for every longer one, so that the shortest is
    exact to `feasibility.BISECTED`; else shorter ones may have been passed over"""
    acceleration_factor: float | None
    """least factor on every acceleration box and every maximum acceleration for which a plan was
    found, thrust and tilt unchanged; None if there is no such limit, or no factor up to
    `feasibility.LARGEST_FACTOR` helps"""
    premise: str = ""
    """what conflicts are proved for, as in 'with the margins that are kept for the disturbance';
    empty where they are proved of the scenario"""
    bearable_wind: float | None = None
    """where there is a plan if nothing disturbs it, the largest wind for which one was found, with
    the feedback that is best for it and all else unchanged [m/s²]; 0 if errors of the estimate are
    too much already; None where there is no plan without a disturbance either, or none is asked"""

    cut: bool = False
    """whether time was up before all trials were made: less than what is told may be enough"""

    @property
    def feasible(self) -> bool:
        """Whether a plan was found after all."""
        return not self.conflicts

    def __str__(self) -> str:
        return f"{self.reason}\n{self.remedy}".rstrip()

    @property
    def reason(self) -> str:
        """Which constraints cannot be met together, in at most five lines; or that all can."""
        if self.feasible:
            cut = f"; {_CUT}" if self.cut else ""
            return f"{self.scenario.name}: there is a plan{self._shorter()}{cut}"
        shown = list(self.conflicts.items())[:_REASONS]
        more = len(self.conflicts) - len(shown)
        premise = f" {self.premise}" if self.premise else ""
        return "\n".join(
            [
                f"{self.scenario.name}: no plan was found; these cannot be met together{premise}:",
                *(f"  {vehicle}: {', '.join(names)}" for vehicle, names in shown),
                *([f"  and {more} more vehicles"] if more > 0 else []),
            ]
        )

    @property
    def remedy(self) -> str:
        """By how much they are broken at least, and what would mend it; empty for a plan."""
        if self.feasible:
            return ""
        breaches = [
            f"  {one.vehicle}: {one.what} by {one.excess:.3g} {one.unit} at {one.time:.4g} s"
            for one in self.violations[:_SHOWN]
        ]
        below, above = [*self._disturbed(), *self._repairs()], len(self.reason.splitlines())
        return "\n".join(
            [
                *(["the least breach of them is"] if breaches else []),
                *breaches[: _LINES - above - 1 - len(below)],
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
        """What is told beside a plan that there is: by how much sooner there is one."""
        shortest = self.shortest_duration
        if shortest is None or shortest >= self.scenario.grid.duration:
            return ""
        return f", down to {self._duration(shortest)}"

    def _repairs(self) -> list[str]:
        ways = []
        if self.longest_duration is not None:
            ways.append(
                f"a duration of {_rounded_down(self.longest_duration)} s or perhaps another "
                f"instead of {self.scenario.grid.duration:.5g} s"
            )
        elif self.shortest_duration is not None:
            ways.append(self._duration(self.shortest_duration))
        if self.acceleration_factor is not None:
            ways.append(
                f"acceleration limits {_rounded_up(self.acceleration_factor)} times as wide"
            )
        around = self.scenario.disturbance
        if around is not None and self.bearable_wind:
            ways.append(
                f"wind up to {_rounded_down(self.bearable_wind)} m/s² instead of "
                f"{around.acceleration:.5g} m/s²"
            )
        if not ways and self.cut:
            return []  # nothing is known of them
        if not ways:
            return ["neither more time nor stronger vehicles were found to help"]
        heads = ["there is a plan with", *["or with"] * (len(ways) - 1)]
        return [f"{head} {way}" for head, way in zip(heads, ways, strict=True)]

    def _disturbed(self) -> list[str]:
        """A line, or none, on what the disturbance has to do with it."""
        if self.bearable_wind is None:
            return []
        if self.bearable_wind == 0.0:
            told = "without a disturbance there is a plan; with errors of the estimate alone, none"
            return [told]
        return ["without a disturbance there is a plan"]


def _rounded_up(value: float) -> str:
    """Five digits, none of which promises more than was found."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 4)
    return f"{np.ceil(value / unit * (1 - 1e-12)) * unit:.5g}"


def _rounded_down(value: float) -> str:
    """Five digits, none of which promises more than was found."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 4)
    return f"{np.floor(value / unit * (1 + 1e-12)) * unit:.5g}"
