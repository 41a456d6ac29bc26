"""`certify_show`: how far a show's assignment and its transitions are from lower bounds."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.described import Described
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.shapes.base import TOLERANCE
from drake_rho.scenario.times import steps_lasting
from drake_rho.shows.assignment import Places, least_longest, least_sum, least_times, places_of
from drake_rho.shows.plan_show import LANDING
from drake_rho.shows.show import Show


@dataclasses.dataclass(frozen=True, kw_only=True)
class TransitionCertificate(metaclass=Described):
    """Times of one transition of a show, and lower bounds of them.

    Flights from rest to rest along a line, with the limits of speed and acceleration alone, take
    at least as long; other vehicles and obstacles are left out of the bounds.
    """

    scene: str
    """name of the scene to which it leads, or `landing`"""
    duration: float
    """time from the end of the hold before to the arrival [s]"""
    bound: float
    """least time of its longest flight [s]"""
    any_assignment: float
    """least time of the longest flight, for the assignment in which it is shortest [s]"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ShowCertificate(metaclass=Described):
    """Distances of a show's assignment and times from lower bounds."""

    show: str
    """name of the show"""
    squares: float
    """sum of the squared distances from place to place, of all vehicles and transitions [m²]"""
    squares_bound: float
    """least such sum of any assignment [m²]"""
    transitions: tuple[TransitionCertificate, ...]
    """transitions in their order"""

    @property
    def gap(self) -> float:
        """Relative distance of the assignment's sum of squares from its bound; 0 if it is least."""
        if self.squares <= self.squares_bound:
            return 0.0
        return 1.0 - self.squares_bound / self.squares

    def __str__(self) -> str:
        """Return the gap, and the times beside their bounds."""
        lines = [
            f"{self.show}: squared distances at most {100.0 * self.gap:.2g} % above the least of "
            "any assignment",
            *(
                f"  to {each.scene}: {each.duration:g} s; its longest flight takes at least "
                f"{each.bound:.2f} s, in the best assignment {each.any_assignment:.2f} s"
                for each in self.transitions
            ),
        ]
        return "\n".join(lines)


@checked
def certify_show(show: Show, plan: Plan) -> ShowCertificate:
    """Return lower bounds of a show's assignment and of the times of its transitions.

    The sum of squared distances is bounded by the cheapest assignments of all transitions, each
    taken alone; with landings on any pad, the assignment of `plan_show` is their combination. The
    bound of a time holds for every plan, and `any_assignment` for every assignment too.

    Args:
        show: the show.
        plan: its plan, by `plan_show`.

    Raises:
        ValueError: the plan has other vehicles or scenes.
    """
    names = [scene.name for scene in show.scenes]
    vehicles = plan.scenario.vehicles
    if any([each.name for each in vehicle.waypoints] != names for vehicle in vehicles) or len(
        vehicles
    ) != len(show.home):
        raise ValueError(f"plan: got one of {plan.scenario.name!r}, expected one of the show")
    drop = show.waiting_places[0] - show.home[0]
    at = [
        show.waiting_places,
        *(
            np.array([vehicle.waypoints[index].position for vehicle in vehicles])
            for index in range(len(names))
        ),
        plan.scenario.fleet.goal_positions + drop,
    ]
    home = Places(show.waiting_places, np.zeros((0, 3)))
    places = [home, *places_of(show), home]
    departures, arrivals = _times(show, plan, at)
    return ShowCertificate(
        show=show.name,
        squares=sum(float(np.sum((b - a) ** 2)) for a, b in pairwise(at)),
        squares_bound=sum(least_sum(a, b, len(vehicles)) for a, b in pairwise(places)),
        transitions=tuple(
            TransitionCertificate(
                scene=name,
                duration=arrival - departure,
                bound=float(least_times(b - a, show.limits).max()),
                any_assignment=least_longest(before, after, len(vehicles), show.limits),
            )
            for name, departure, arrival, (a, b), (before, after) in zip(
                [*names, LANDING], departures, arrivals, pairwise(at), pairwise(places), strict=True
            )
        ),
    )


def _times(show: Show, plan: Plan, at: Sequence[FloatArray]) -> tuple[list[float], list[float]]:
    """Return the times at which transitions begin and end [s].

    Args:
        show: the show.
        plan: its plan.
        at: places of the vehicles between transitions, from above the pads to above the pads.
    """
    times, scenes = plan.times, plan.scenario.vehicles[0].waypoints
    ends = [float(each.time or 0.0) for each in scenes]
    leaves = [
        end + steps_lasting(scene.hold, show.step) * show.step
        for end, scene in zip(ends, show.scenes, strict=True)
    ]
    above = [np.abs(plan.positions - each[:, None]).max(axis=(0, 2)) for each in (at[0], at[-1])]
    tolerance = TOLERANCE * float(plan.scenario.fleet.lengths.max())
    begins = times[(above[0] <= tolerance) & (times <= ends[0])].max(initial=times[0])
    lands = times[(above[1] <= tolerance) & (times >= leaves[-1])].min(initial=times[-1])
    return [float(begins), *leaves], [*ends, float(lands)]
