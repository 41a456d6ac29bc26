"""Small relaxations of each limit of a motion: `relaxations_of`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import cast

import numpy as np

from drake_rho.planning.scp.timed import Timed
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.kinds import LIMITS
from drake_rho.scenario.norms import NORMS, Norm
from drake_rho.scenario.records import Box, Limits, Scenario
from drake_rho.scenario.sets import ConvexSet

_PART = 1e-3
"""Relative relaxation of a limit, small enough for the final time to change in proportion."""

_OF_LENGTH = 1e-4
"""Relaxation of a limit without its own scale, as a part of the motion's."""

_BELOW = 1e-9
"""Distance of relaxed limits from their least upper bound, in the limit's unit."""


@dataclasses.dataclass(frozen=True)
class Relaxation:
    """Small relaxation of one limit."""

    limit: str
    """name of the limit"""
    change: str
    """description of a change of unit size, such as '1 % more'"""
    size: float
    """size of the relaxation, in changes of unit size"""
    vehicles: IntArray
    """indices of the vehicles with this limit"""
    relaxed: Callable[[Timed, IntArray], Timed]
    """function that relaxes the limit for a subset of these vehicles, around the same motion"""
    for_each: bool = True
    """whether it can be relaxed for some of its vehicles alone"""


def relaxations_of(timed: Timed) -> list[Relaxation]:
    """Return the relaxations of all limits that may determine a motion's final time."""
    scenario = timed.scenario
    return [*_of_limits(scenario), *_of_places(timed), *_of_scenario(scenario)]


def _of_limits(scenario: Scenario) -> list[Relaxation]:
    """Return the relaxations of the fields of `Limits`."""
    found = list[Relaxation]()
    for field in LIMITS:
        limits = [getattr(scenario.limits_of(each), field) for each in scenario.vehicles]
        limited = np.flatnonzero([each is not None for each in limits])
        if len(limited) == 0:
            continue
        if field == "position":
            step = _OF_LENGTH * float(scenario.fleet.lengths.max())
            apply = partial(_with_limits, field=field, wider=partial(_moved, by=step))
            found.append(Relaxation(field, "0.01 m more", step / 0.01, limited, apply))
        else:
            apply = partial(_with_limits, field=field, wider=_grown)
            found.append(Relaxation(field, "1 % more", _PART / 0.01, limited, apply))
    return found


def _grown(limit: float | Box) -> float | Box:
    """Return a limit widened by the relative relaxation."""
    if isinstance(limit, Box):
        low, high = limit.lower, limit.upper
        return Box(low - _PART * np.abs(low), high + _PART * np.abs(high))
    return limit * (1.0 + _PART)


def _moved(limit: Box, by: float) -> Box:
    """Return a box with all sides moved outwards by a distance [m]."""
    return Box(limit.lower - by, limit.upper + by)


def _with_limits(
    timed: Timed, vehicles: IntArray, *, field: str, wider: Callable[..., float | Box]
) -> Timed:
    """Return a motion with a wider limit of some vehicles."""
    scenario, changed = timed.scenario, list(timed.scenario.vehicles)
    for i in vehicles.tolist():
        limit = wider(getattr(scenario.limits_of(changed[i]), field))
        if isinstance(limit, float):
            limit = min(limit, NORMS[cast(Norm, field)].largest - _BELOW)
        own = dataclasses.replace(changed[i].limits or Limits(), **{field: limit})
        changed[i] = dataclasses.replace(changed[i], limits=own)
    return dataclasses.replace(
        timed, scenario=dataclasses.replace(scenario, vehicles=tuple(changed))
    )


def _of_places(timed: Timed) -> list[Relaxation]:
    """Return the relaxations of waypoints and of obstacle distances."""
    scenario, passing, found = timed.scenario, timed.passing, list[Relaxation]()
    names, lengths = scenario.names, scenario.fleet.lengths
    for w, vehicle in enumerate(passing.vehicles.tolist()):
        number = 1 + w - int(np.searchsorted(passing.vehicles, vehicle))
        name = f"waypoint {number}" + (f" of {names[vehicle]}" if len(names) > 1 else "")
        step, who = _OF_LENGTH * float(lengths[vehicle]), np.array([vehicle])
        near = partial(_within, number=w, by=step)
        found.append(Relaxation(name, "0.01 m more tolerance", step / 0.01, who, near))
        if passing.given[w]:
            sooner = partial(_sooner, number=w)
            found.append(Relaxation(f"time of {name}", "1 % less", _PART / 0.01, who, sooner))
    step, every = _OF_LENGTH * float(lengths.max()), np.arange(len(names))
    for number, _ in scenario.avoided:
        nearer = partial(_nearer, number=number, by=step)
        name = scenario.obstacle_name(number)
        found.append(Relaxation(name, "0.01 m nearer", step / 0.01, every, nearer))
    return found


def _within(timed: Timed, vehicles: IntArray, *, number: int, by: float) -> Timed:
    """Return a motion with a larger waypoint tolerance [m]."""
    within = timed.passing.within.copy()
    within[number] += by
    return dataclasses.replace(timed, passing=dataclasses.replace(timed.passing, within=within))


def _sooner(timed: Timed, vehicles: IntArray, *, number: int) -> Timed:
    """Return a motion with a slightly earlier waypoint time."""
    times = timed.passing.times.copy()
    times[number] *= 1.0 - _PART
    return dataclasses.replace(timed, passing=dataclasses.replace(timed.passing, times=times))


def _nearer(timed: Timed, vehicles: IntArray, *, number: int, by: float) -> Timed:
    """Return a motion with a smaller distance of some vehicles from an obstacle [m]."""
    distances = np.zeros(len(timed.scenario.vehicles))
    distances[vehicles] = by
    return dataclasses.replace(timed, nearer=(number, distances))


def _of_scenario(scenario: Scenario) -> list[Relaxation]:
    """Return the relaxations of limits shared by vehicles, from separation to smoothing."""
    found = list[Relaxation]()
    every, smaller = np.arange(len(scenario.vehicles)), 1.0 - _PART

    def add(name: str, change: str, size: float, vehicles: IntArray, relaxed: Scenario) -> None:
        apply = partial(_of_other, scenario=relaxed)
        found.append(Relaxation(name, change, size, vehicles, apply, for_each=False))

    apart, wind, smoothing = scenario.separation, scenario.disturbance, scenario.smoothing
    if apart is not None and len(every) > 1:
        nearer = dataclasses.replace(apart, distance=apart.distance * smaller)
        relaxed = dataclasses.replace(scenario, separation=nearer)
        add("separation", "1 % less", _PART / 0.01, every, relaxed)
    for index, each in enumerate(scenario.requirements):
        by = _OF_LENGTH * float(scenario.fleet.scale(each.quantity).max())
        wider = list(scenario.requirements)
        wider[index] = dataclasses.replace(each, set=_Wider(each.set, by))
        relaxed = dataclasses.replace(scenario, requirements=tuple(wider))
        words, members = f"0.01 {each.unit} wider", each.members(scenario.names)
        add(each.called(index + 1), words, by / 0.01, members, relaxed)
    if wind is not None:
        weaker = dataclasses.replace(wind, acceleration=wind.acceleration * smaller)
        relaxed = dataclasses.replace(scenario, disturbance=weaker)
        add("wind", "1 % less", _PART / 0.01, every, relaxed)
    if smoothing is not None:
        narrower = dataclasses.replace(smoothing, width=smoothing.width * smaller)
        relaxed = dataclasses.replace(scenario, smoothing=narrower)
        add("smoothing", "1 % narrower", _PART / 0.01, every, relaxed)
    return found


def _of_other(timed: Timed, vehicles: IntArray, *, scenario: Scenario) -> Timed:
    """Return the motion as one of another scenario."""
    return dataclasses.replace(timed, scenario=scenario)


@dataclasses.dataclass(frozen=True)
class _Wider:
    """Convex set enlarged by a small distance."""

    inner: ConvexSet
    """the set"""
    by: float
    """the distance, in the quantity's unit"""

    def support(self, n: FloatArray) -> FloatArray:
        """Return the largest n · x in the set, shape (...)."""
        return self.inner.support(n) + self.by

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return distances from the boundary, shape (...)."""
        return self.inner.signed_distance(x) - self.by

    def outward(self, x: FloatArray) -> FloatArray:
        """Return unit vectors that point away from the set, shape (..., 3)."""
        return self.inner.outward(x)
