"""Result of `diagnose`, with its printed form."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from drake_rho.analysis.changes import Change, NewNumbers
from drake_rho.analysis.least_violation import partner_of
from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.described import Described
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Check

_SHOWN = 4
"""Largest number of vehicles that a printed diagnosis lists with violations, and with conflicts."""

_APART = re.compile(r"separation from (.*?)(?: (?:at|from) [^ ]+ s.*)?")
"""Name of a pair's constraint in a conflict, with the other vehicle."""

_CUT = (
    "not everything was tried to the end: smaller changes may suffice; a `time_limit` allows more"
)


@dataclasses.dataclass(frozen=True)
class Diagnosis(metaclass=Described):
    """Reason why a scenario has no plan, and changes that give one.

    It prints the violations of each vehicle, then the constraints that cannot be met together, then
    the changes.
    """

    scenario: Scenario
    """scenario that was diagnosed"""
    conflicts: dict[str, tuple[str, ...]]
    """for each vehicle without a plan, constraints that cannot be met together; empty if there is
    a plan"""
    violations: tuple[Check, ...]
    """violations of the motion with the least total violation, missed goals first; the worst one of
    each vehicle and constraint, and of each pair"""
    changes: tuple[Change, ...]
    """least changes that each give a plan: of the duration, and of each limit in every conflict, or
    else of all limits in conflicts together"""
    shortest_duration: float | None
    """least duration T for which a plan was found with everything else unchanged [s]; None if none
    was found"""
    longest_duration: float | None
    """greatest duration T for which a plan was found [s], if plans were found for shorter durations
    than the scenario's only; else None. A longer duration is not always possible with a
    disturbance, moving obstacles, waypoints, or motion at start or goal"""
    is_monotone: bool
    """whether a plan for one duration implies a plan for every longer one, so that the shortest
    duration is exact to `trials.PRECISION`; else shorter ones may have been missed"""
    premise: str = ""
    """assumption under which the conflicts are proved, as in 'with the margins that are kept for
    the disturbance'; empty if they are proved for the scenario itself"""
    bearable_wind: float | None = None
    """if a plan was found without the disturbance, the largest wind for which one was found, with
    the feedback that is best for this wind and all else unchanged [m/s²]; 0 if the estimation
    errors alone leave no plan; None if there is no plan without the disturbance either, no
    disturbance, or no answer"""

    cut: bool = False
    """whether the time or the work was up before all trials had ended, so that smaller changes may
    suffice"""
    untried: tuple[str, ...] = ()
    """names of limits that may give a plan as well: the work was up before this was known"""

    @property
    def feasible(self) -> bool:
        """True if a plan was found after all."""
        return not self.conflicts

    @property
    def acceleration_factor(self) -> float | None:
        """Least factor of acceleration limits with which there is a plan, if it is known.

        It is 1 if there is a plan already, and None if no change of these limits alone was found to
        help.
        """
        if self.feasible:
            limits = map(self.scenario.limits_of, self.scenario.vehicles)
            limited = any(each.acceleration or each.max_acceleration for each in limits)
            return 1.0 if limited else None
        for change in self.changes:
            if all(_is_of_accelerations(each) for each in change.numbers):
                return max(each.factor for each in change.numbers)
        return None

    def __str__(self) -> str:
        return f"{self.reason}\n{self.remedy}".rstrip()

    @property
    def reason(self) -> str:
        """Violations and the constraints in conflict, or that a plan exists."""
        if self.feasible:
            cut = f"; {_CUT}" if self.cut else ""
            return f"{self.scenario.name}: there is a plan{self._shorter()}{cut}"
        premise = f" {self.premise}" if self.premise else ""
        missed, why = self._missed(), self._conflicts()
        return "\n".join(
            [
                f"{self.scenario.name}: no plan was found",
                *(["the motion with the least total violation misses:"] if missed else []),
                *_some(missed, "vehicles"),
                f"these constraints cannot be met together{premise}:",
                *_some(why, "vehicles"),
            ]
        )

    @property
    def remedy(self) -> str:
        """Changes with which there is a plan; empty if there is one already."""
        if self.feasible:
            return ""
        return "\n".join([*self._disturbed(), *self._repairs(), *self._left_out()])

    def _left_out(self) -> list[str]:
        """Return lines about unfinished trials."""
        named = [f"not tried to the end: {', '.join(self.untried)}"] if self.untried else []
        return [*named, _CUT] if self.cut else []

    def _missed(self) -> list[str]:
        """Return a line for each vehicle, with its violations."""
        lines = dict[str, list[str]]()
        for each in self.violations:
            lines.setdefault(each.vehicle, []).append(_told(each))
        return [f"{vehicle}: {', '.join(parts)}" for vehicle, parts in lines.items()]

    def _conflicts(self) -> list[str]:
        """Return a line for each vehicle with its conflict; a pair is named once."""
        lines, told = list[str](), set[tuple[str, str]]()
        for vehicle, names in self.conflicts.items():
            shown = list[str]()
            for name in names:
                pair = _APART.fullmatch(name)
                if pair is None or (pair[1], vehicle) not in told:
                    shown.append(name)
                if pair is not None:
                    told.add((vehicle, pair[1]))
            if shown:
                lines.append(f"{vehicle}: {', '.join(shown)}")
        return lines

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
        return f"; also with {self._duration(shortest)}"

    def _repairs(self) -> list[str]:
        changes = []
        if self.longest_duration is not None:
            changes.append(
                f"a duration of {_rounded_down(self.longest_duration)} s or perhaps another "
                f"instead of {self.scenario.grid.duration:.5g} s"
            )
        elif self.shortest_duration is not None:
            changes.append(self._duration(self.shortest_duration))
        changes += [str(each) for each in self.changes if not each.is_of_duration]
        disturbance = self.scenario.disturbance
        if disturbance is not None and self.bearable_wind:
            changes.append(
                f"wind up to {_rounded_down(self.bearable_wind)} m/s² instead of "
                f"{disturbance.acceleration:.5g} m/s²"
            )
        if not changes and self.cut:
            return []  # nothing is known
        if not changes:
            return ["no plan was found with more time or with wider limits either"]
        head = "there is a plan with" if len(changes) == 1 else "there is a plan with any one of"
        return [f"{head}:", *(f"  {change}" for change in changes)]

    def _disturbed(self) -> list[str]:
        """Return a line on whether the disturbance is the reason, or no line if it is not."""
        if self.bearable_wind is None:
            return []
        if self.bearable_wind == 0.0:
            alone = "with the estimation errors alone there is none"
            return [f"without a disturbance there is a plan; {alone}"]
        return ["without a disturbance there is a plan"]


def _told(check: Check) -> str:
    """Return the text of a violation: constraint, amount and time."""
    by, at = f"{check.excess:.3g} {check.unit}", clock_time(check.time, 4)
    if check.kind == "goals":
        return f"{check.constraint} {check.part} by {by}"
    if (partner := partner_of(check)) is not None:
        return f"too close to {partner} by {by} at {at}"
    return f"{check.constraint} by {by} at {at}"


def _some(lines: list[str], of: str) -> list[str]:
    """Return the first lines, indented, and the number of further ones."""
    more = len(lines) - _SHOWN
    rest = [f"  and {more} more {of}"] if more > 0 else []
    return [*(f"  {line}" for line in lines[:_SHOWN]), *rest]


def _is_of_accelerations(numbers: NewNumbers) -> bool:
    return numbers.limit.split()[0] in ("acceleration", "max_acceleration")


def _rounded_up(value: float) -> str:
    """Return a value rounded up to five digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 4)
    return f"{np.ceil(value / unit * (1 - 1e-12)) * unit:.5g}"


def _rounded_down(value: float) -> str:
    """Return a value rounded down to five digits."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 4)
    return f"{np.floor(value / unit * (1 + 1e-12)) * unit:.5g}"
