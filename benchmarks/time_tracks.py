"""The tracks of PMM in the least time, beside IPOPT on the same model."""

from __future__ import annotations

import math

from benchmarks.apart import version
from benchmarks.least_times import Found, Refereed, by_ipopt, found
from benchmarks.tables import Cell, Goal, Table
from benchmarks.time_scenes import STEPS, THRUST, TRACKS, Track
from drake_rho.scenario.limits import GRAVITY

BEYOND = 0.006
"""Goal: T over IPOPT's with a step for each leg, less 1."""

REPETITIONS = 3
"""Calls of the planner on each track, of whose times the median counts."""

AT_PMM = 9.8066
"""g of PMM [m/s²]."""

COLUMNS = (
    "track",
    "knots",
    "T [s]",
    "T / IPOPT's, a step for each leg",
    "T / IPOPT's, one step",
    "plan, processor [s]",
    "plan, wall [s]",
    "verified",
    "IPOPT T, a step for each leg [s]",
    "IPOPT T, one step [s]",
    "IPOPT, a step for each leg, processor [s]",
    "IPOPT, a step for each leg, wall [s]",
    "IPOPT, one step, processor [s]",
    "IPOPT, one step, wall [s]",
    "IPOPT T, a step for each leg, g of PMM [s]",
    "PMM T, published [s]",
)


def run() -> Table:
    """Plan every track by both.

    Raises:
        Skipped: there is no environment with CasADi.
    """
    places = [track.places for track in TRACKS]
    legs = by_ipopt(places, STEPS, THRUST, GRAVITY, uniform=False)
    even = by_ipopt(places, STEPS, THRUST, GRAVITY, uniform=True)
    theirs = by_ipopt(places, STEPS, THRUST, AT_PMM, uniform=False)
    found(TRACKS[2].scenario)  # loading does not count
    ours = [found(track.scenario, repetitions=REPETITIONS) for track in TRACKS]
    ratios = [_ratio(mine, peer) for mine, peer in zip(ours, legs, strict=True)]
    worst = max(math.inf if each is None else each - 1.0 for each in ratios)
    faults = [
        f"- {track.name}: {mine.words or 'the plan is not one of the track'}"
        for track, mine in zip(TRACKS, ours, strict=True)
        if not mine.holds
    ]
    error = max(each.error for each in (*legs, *even, *theirs))
    return Table(
        name="time_tracks",
        title="Tracks of waypoints in the least time",
        columns=COLUMNS,
        rows=tuple(_row(*each) for each in zip(TRACKS, ours, legs, even, theirs, strict=True)),
        notes=(
            *(["\n".join(["Tracks without a verified plan:", "", *faults])] if faults else []),
            _WORK,
            f"CasADi {version('casadi')}. {_REFEREE} They are off by {error:.1g} at most.",
            _LIMITATIONS,
        ),
        goals=(
            Goal("T / IPOPT's with a step for each leg - 1, largest", BEYOND, worst),
            Goal("plan, slowest [s]", 1.0, max(mine.taken.processor for mine in ours)),
            Goal("tracks without a verified plan", 0.0, float(len(faults))),
        ),
    )


def _row(
    track: Track, mine: Found, legs: Refereed, even: Refereed, theirs: Refereed
) -> tuple[Cell, ...]:
    return (
        track.name,
        STEPS * track.legs + 1,
        _digits(mine.duration),
        _digits(_ratio(mine, legs)),
        _digits(_ratio(mine, even)),
        *mine.taken.both,
        mine.holds,
        _digits(legs.time),
        _digits(even.time),
        legs.processor,
        legs.seconds,
        even.processor,
        even.seconds,
        _digits(theirs.time),
        _digits(track.published, 3),
    )


def _ratio(mine: Found, peer: Refereed) -> float | None:
    return None if mine.duration is None else mine.duration / peer.time


def _digits(value: float | None, digits: int = 4) -> str | None:
    """Return a value with as many digits as differences of times need."""
    return None if value is None else f"{value:.{digits}f}"


_WORK = f"""\
Start and end at rest, waypoints passed exactly and in order, norm of a + g e_z at most {THRUST:g}
m/s², no limit on speed, g = {GRAVITY:g} m/s²; {STEPS} steps for each leg in all, every one as long
as any other. Waypoints have no times, and the grid that is given lasts as long as a flight that
rests at every waypoint. T is that of `rho.plan_minimum_time`. A plan counts if its scenario is the
one given but for the step and the times of waypoints, and `verify` finds no violation at any
instant. Seconds are of the whole call, the median of {REPETITIONS}, after one that does not
count."""

_REFEREE = f"""\
IPOPT solves the same model in its own environment by multiple shooting: accelerations are constant
in each step, positions and velocities at the knots are variables too, derivatives are exact. Either
each leg has {STEPS} steps of a length of its own, or all steps are as long and waypoints are passed
at free times between knots: those that reach the end of a step go on to the next, from program to
program. It begins with a flight that rests at every waypoint. Its seconds include building the
programs, and with one step those of the flight with a step for each leg, where it begins.
Waypoints, rest and limits are looked at again on its accelerations alone [m, m/s, m/s²]."""

_LIMITATIONS = f"""\
Limitations. IPOPT's times are local optima. Neither of the two forms of steps contains the other,
so either may be the faster. PMM's times are quoted; it has g = {AT_PMM:g} m/s², for which IPOPT's
times are given too."""
