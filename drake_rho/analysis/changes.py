"""Least changes that make an infeasible scenario feasible.

For each limit, a plan without it shows a sufficient change (`sufficient_change`), and bisection
finds the least one (`least_change`). Every trial is warm-started with the plan of a wider limit, so
that only the first one is a search.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from drake_rho.analysis.adjustable import Adjustable
from drake_rho.analysis.trials import Trials, precision_of
from drake_rho.motion.plan import Plan
from drake_rho.planning.planners.related import rescaled, time_scaled_plan
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.records import Limits, Scenario
from drake_rho.system.bisection import bisected
from drake_rho.verification.verify import verify

LONGEST = 2.0**10
"""Largest multiple of a duration that is tried."""

_WIDER = 1.0, 2.0, 4.0
"""Sizes of the change that are tried, as multiples of the excess of a plan without the limit."""

_PRECISION = 2.0
"""Precision of a limit, in precisions of a duration."""

_FINEST_CHANGE = 0.05
"""Coarsest precision of a change, as a part of the excess of a plan without the limit."""

_DIGITS = 5
"""Digits of suggested numbers."""


@dataclasses.dataclass(frozen=True)
class _Parts:
    """Parts of a change, 0 for none, and trials of the changed scenarios."""

    trials: Trials
    changed: Callable[[float], Scenario]
    """function that returns the scenario with a part of the change"""
    words: Callable[[float], str]
    """function that describes it"""

    def have_plan(self, part: float) -> bool:
        """Return whether a part of the change gives a plan, near the last one."""
        return self.trials.has_plan(lambda: self.changed(part), self.words(part), near=True)

    def have_plans_alone(self, part: float) -> bool:
        """Return whether it gives plans of single vehicles, without separation."""

        def alone() -> Scenario:
            return self.changed(part).without_separation()

        return self.trials.has_plan(alone, self.words(part), near=True)


@dataclasses.dataclass(frozen=True)
class NewNumbers(metaclass=Described):
    """New value of one limit; of a box, its lower and then its upper bounds."""

    limit: str
    """field, such as 'max_speed' or 'duration', with its vehicle or part if it has one, as in
    'max_speed of scout'"""
    unit: str
    """SI unit of the numbers"""
    now: tuple[float, ...]
    """numbers in the scenario"""
    needed: tuple[float, ...]
    """numbers with which there is a plan"""

    @property
    def factor(self) -> float:
        """Largest ratio of a needed number to the scenario's; 1 where none changes."""
        pairs = zip(self.needed, self.now, strict=True)
        return max((new / old for new, old in pairs if new != old and old != 0.0), default=1.0)

    def __str__(self) -> str:
        return f"{self.limit}: {_words(self.needed, self.now, self.unit)}"


@dataclasses.dataclass(frozen=True)
class Change(metaclass=Described):
    """Least change of one limit, or of several together, with which a plan was found."""

    numbers: tuple[NewNumbers, ...]
    """new numbers, rounded to five digits away from those of the scenario; several if only all of
    them together give a plan"""
    scenario: Scenario = dataclasses.field(repr=False)
    """scenario with these numbers"""

    @property
    def is_of_duration(self) -> bool:
        """Whether the duration is the only changed number."""
        return [each.limit for each in self.numbers] == ["duration"]

    def __str__(self) -> str:
        return " and ".join(map(str, self.numbers))


@dataclasses.dataclass(frozen=True)
class Sufficient:
    """Change of some limits, which are widened in proportion, that gives a plan."""

    scenario: Scenario
    """scenario without a plan"""
    adjustables: Sequence[Adjustable]
    """limits to change"""
    parts: _Parts
    """trials of parts of the change"""
    numbers: Callable[[float], list[FloatArray]]
    """function that returns the numbers of the limits with a part of the change"""
    part: float
    """part that gives a plan"""
    plan: Plan
    """the plan that was found for it"""
    precision: float
    """precision of the least part"""


def sufficient_change(
    scenario: Scenario, adjustables: Sequence[Adjustable], trials: Trials
) -> Sufficient | None:
    """Return a joint change of some limits that gives a plan; None if none is found.

    Limits change in proportion, from their present values towards those of a plan without them.
    """
    limits = " and ".join(each.limit for each in adjustables)
    if not trials.has_plan(lambda: without(scenario, adjustables), f"no limit on {limits}"):
        return None
    assert trials.plan is not None  # noqa: S101  # the trial found it
    now = [each.now for each in adjustables]
    enough = [each.needed(trials.plan) for each in adjustables]
    largest = max(map(_relative, now, enough))
    if largest == 0.0:
        return None

    def numbers(part: float) -> list[FloatArray]:
        return [
            np.clip(_rounded(a, a + part * (b - a)), *each.bounds)
            for each, a, b in zip(adjustables, now, enough, strict=True)
        ]

    def changed(part: float) -> Scenario:
        made = scenario
        for each, new in zip(adjustables, numbers(part), strict=True):
            made = each.changed(made, new)
        return made

    def words(part: float) -> str:
        return ", ".join(map(_told, adjustables, numbers(part)))

    parts = _Parts(trials, changed, words)
    enough_of_it = next((part for part in _WIDER if parts.have_plan(part)), None)
    if enough_of_it is None:
        return None
    precision = min(_PRECISION * precision_of(scenario) / largest, _FINEST_CHANGE)
    return Sufficient(scenario, adjustables, parts, numbers, enough_of_it, trials.plan, precision)


def least_change(enough: Sufficient) -> Change:
    """Return the least part of a sufficient change that gives a plan, as far as trials show."""
    parts = enough.parts
    parts.trials.go_back_to(enough.plan)
    part = _least_of(enough.scenario, parts, enough.part, enough.precision)
    new = [
        NewNumbers(each.limit, each.unit, tuple(each.now.tolist()), tuple(found.tolist()))
        for each, found in zip(enough.adjustables, enough.numbers(part), strict=True)
    ]
    return Change(tuple(new), parts.changed(part))


def without(scenario: Scenario, adjustables: Sequence[Adjustable]) -> Scenario:
    """Return a scenario without some of its limits."""
    for each in adjustables:
        scenario = each.without(scenario)
    return scenario


def least_duration(scenario: Scenario, trials: Trials) -> float | None:
    """Return the least duration with a plan [s], where motions can be flown more slowly.

    A plan without limits on velocities, accelerations and jerks meets them all if it is flown
    slowly enough. None if there is no such plan.
    """
    duration = scenario.grid.duration
    if not trials.has_plan(lambda: _unlimited(scenario), "no limit but obstacles and space"):
        return None
    factor = 2.0
    while factor <= LONGEST and not _holds(trials.plan, rescaled(scenario, factor)):
        factor *= 2.0

    parts = _Parts(
        trials,
        lambda part: rescaled(scenario, 1.0 + part),
        lambda part: f"a duration of {(1.0 + part) * duration:.5g} s",
    )
    if not parts.have_plan(factor - 1.0):
        return None
    return duration * (1.0 + _least_of(scenario, parts, factor - 1.0, precision_of(scenario)))


def new_duration(scenario: Scenario, duration: float) -> Change:
    """Return the change to a longer duration [s], rounded up to five digits."""
    now = scenario.grid.duration
    (needed,) = _rounded(np.array([now]), np.array([duration])).tolist()
    numbers = NewNumbers("duration", "s", (now,), (needed,))
    return Change((numbers,), rescaled(scenario, needed / now))


def _unlimited(scenario: Scenario) -> Scenario:
    """Return a scenario with limits on positions only."""
    vehicles = tuple(
        dataclasses.replace(each, limits=Limits(position=scenario.limits_of(each).position))
        for each in scenario.vehicles
    )
    return dataclasses.replace(scenario, limits=Limits(), vehicles=vehicles)


def _holds(plan: Plan | None, slower: Scenario) -> bool:
    return plan is not None and verify(time_scaled_plan(plan, slower)).ok


def _least_of(scenario: Scenario, parts: _Parts, enough: float, precision: float) -> float:
    """Return the least part of a change that gives a plan, up to `enough`.

    In fleets a failed trial is slow. So the change that each vehicle needs alone is found first;
    the fleet seldom needs more.
    """
    if scenario.separation is None:
        return _least(parts.have_plan, 0.0, enough, precision)
    low, step = 0.0, precision
    if not parts.have_plans_alone(0.0):
        low = _least(parts.have_plans_alone, 0.0, enough, precision)
        if parts.have_plan(low):
            return low
    while low < enough:
        step *= 2.0
        if parts.have_plan(after := min(low + step * (1.0 + low), enough)):
            return _least(parts.have_plan, low, after, precision)
        low = after
    return enough


def _least(has_plan: Callable[[float], bool], low: float, high: float, precision: float) -> float:
    """Return the least value with a plan, by bisection from one without to one with a plan."""
    return bisected(has_plan, high, low, lambda one, low: one - low <= precision * (1.0 + one))[0]


def _relative(now: FloatArray, needed: FloatArray) -> float:
    """Return the largest change of a number, as a part of the largest of them."""
    finite = np.abs(now[np.isfinite(now)]).max(initial=0.0)
    largest = max(finite, float(np.abs(np.where(np.isfinite(now), needed, 0.0)).max()))
    changes = np.where(np.isfinite(now), needed - now, 0.0)
    return float(np.abs(changes).max() / largest) if largest > 0.0 else 0.0


def _rounded(now: FloatArray, needed: FloatArray) -> FloatArray:
    """Return new numbers of limits, rounded away from the present ones."""
    rounded = needed.copy()
    for k in np.flatnonzero((needed != now) & np.isfinite(needed)):
        if needed[k] == 0.0:
            continue
        unit = 10.0 ** (np.floor(np.log10(abs(needed[k]))) - _DIGITS + 1)
        part = needed[k] / unit
        whole = np.ceil(part * (1 - 1e-12)) if needed[k] > now[k] else np.floor(part)
        rounded[k] = float(f"{whole * unit:.{_DIGITS}g}")
    return rounded


def _told(adjustable: Adjustable, numbers: FloatArray) -> str:
    now = tuple(adjustable.now.tolist())
    new = NewNumbers(adjustable.limit, adjustable.unit, now, tuple(numbers.tolist()))
    return str(new)


def _words(needed: Sequence[float], now: Sequence[float], unit: str) -> str:
    """Return new and old numbers as text; for a box, of the axes that change."""
    if len(needed) == 1:
        return f"{needed[0]:.5g} {unit} instead of {now[0]:.5g} {unit}"
    if len({*needed[3:], *(-each for each in needed[:3])}) == 1:
        return f"{_interval(needed[0], needed[3])} {unit} instead of ±{now[3]:.5g} {unit}"
    sides = [
        (axis, needed[k], needed[k + 3], now[k], now[k + 3])
        for k, axis in enumerate("xyz")
        if (needed[k], needed[k + 3]) != (now[k], now[k + 3])
    ]
    return ", ".join(
        f"{axis} {_interval(low, high)} {unit} instead of {_interval(below, above)} {unit}"
        for axis, low, high, below, above in sides
    )


def _interval(low: float, high: float) -> str:
    return f"±{high:.5g}" if low == -high else f"{low:.5g} to {high:.5g}"
