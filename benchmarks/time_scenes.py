"""Tracks of waypoints that a point mass passes in the least time, from rest to rest."""

from __future__ import annotations

import dataclasses

import numpy as np

import drake_rho as rho
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.limits import GRAVITY

THRUST = 34.32
"""Largest norm of a + g e_z on the tracks [m/s²]."""

STEPS = 24
"""Steps of each leg in the mean."""

LIMITS = rho.Limits(max_thrust=THRUST)

Place = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Track:
    """Places to be passed in order, from rest to rest."""

    name: str
    """name"""
    places: tuple[Place, ...]
    """start, waypoints and goal [m]"""
    published: float
    """time of PMM as published [s]"""

    @property
    def legs(self) -> int:
        """Number of legs."""
        return len(self.places) - 1

    @property
    def scenario(self) -> rho.Scenario:
        """The track with the same step everywhere and all times free."""
        vehicle = vehicle_on("quadrotor", np.array(self.places))
        return rho.Scenario(self.name, guessed_grid([vehicle], self.legs), [vehicle], limits=LIMITS)


def vehicle_on(name: str, places: FloatArray, radius: float = 0.0) -> rho.Vehicle:
    """Return a vehicle that passes places at free times.

    Args:
        name: of the vehicle.
        places: start, waypoints and goal [m], shape (L + 1, 3).
        radius: of the vehicle [m].
    """
    start, *between, goal = places
    return rho.Vehicle(
        name,
        rho.State(start),
        rho.State(goal),
        radius=radius,
        waypoints=[rho.Waypoint(None, place) for place in between],
    )


def guessed_grid(vehicles: list[rho.Vehicle], legs: int) -> rho.Grid:
    """Return a grid that lasts as long as flights that rest at every waypoint."""
    longest = 0.0
    for vehicle in vehicles:
        between = [waypoint.position for waypoint in vehicle.waypoints]
        places = np.array([vehicle.start.position, *between, vehicle.goal.position])
        lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
        longest = max(longest, float(np.sum(2.0 * np.sqrt(lengths / (THRUST - GRAVITY)))))
    return rho.Grid(longest / (STEPS * legs), STEPS * legs + 1)


# Waypoints of config/waypoints of github.com/ctu-mrs/pmm_uav_planner (PMM, RA-L 2024), those of the
# hypotrochoid to a micrometre; the times are those that its authors publish.
_GATES: tuple[Place, ...] = (
    (-0.9, -1.27, 3.48),
    (9.09, 6.26, 1.08),
    (9.27, -3.46, 1.17),
    (-4.0, -6.25, 3.4),
    (-4.48, -5.94, 1.05),
    (4.45, -0.8, 1.09),
    (-2.65, 6.51, 1.3),
)

_ROUND: tuple[Place, ...] = (
    (-8.913739, -12.064214, 0.0),
    (-16.989357, -12.343490, 0.0),
    (-14.228246, -4.749423, 0.0),
    (0.120200, 14.999518, 0.0),
    (6.489357, 19.972187, 0.0),
    (8.719252, 12.205517, 0.0),
    (8.719252, -12.205517, 0.0),
    (6.489357, -19.972187, 0.0),
    (0.120200, -14.999518, 0.0),
    (-14.228246, 4.749423, 0.0),
    (-16.989357, 12.343490, 0.0),
    (-8.913739, 12.064214, 0.0),
    (14.302533, 4.520789, 0.0),
    (21.0, 0.0, 0.0),
    (14.302533, -4.520789, 0.0),
)

TRACKS = (
    Track("race", ((-5.0, 4.5, 1.2), *_GATES, *_GATES, *_GATES[:3], (-2.5, -6.0, 4.0)), 16.571),
    Track(
        "slalom",
        (
            (0.0, 0.0, 0.0),
            (4.0, 4.0, 0.0),
            (-4.0, 8.0, 0.0),
            (4.0, 12.0, 0.0),
            (-4.0, 16.0, 0.0),
            (4.0, 20.0, 0.0),
            (0.0, 26.0, 4.0),
            (-4.0, 20.0, 0.0),
            (4.0, 16.0, 0.0),
            (-4.0, 12.0, 0.0),
            (4.0, 8.0, 0.0),
            (-4.0, 4.0, 0.0),
            (0.0, 0.0, 0.0),
        ),
        11.186,
    ),
    Track(
        "cuboid",
        (
            (0.0, 0.0, 0.0),
            (0.0, 10.0, 0.0),
            (0.0, 10.0, 5.0),
            (10.0, 0.0, 5.0),
            (0.0, 0.0, 0.0),
            (5.0, 5.0, 2.5),
        ),
        4.830,
    ),
    Track(
        "eight",
        (
            (0.0, 0.0, 0.0),
            (15.0, -15.0, 0.0),
            (20.0, 0.0, 0.0),
            (15.0, 15.0, 0.0),
            (0.0, 0.0, 0.0),
            (-15.0, -15.0, 0.0),
            (-20.0, 0.0, 0.0),
            (-15.0, 15.0, 0.0),
            (0.0, 0.0, 0.0),
        ),
        8.945,
    ),
    Track("hypotrochoid", ((0.0, 0.0, 0.0), *_ROUND, *_ROUND[:6]), 15.717),
)
"""Tracks of PMM."""
