"""`print(scenario)` gives a few lines to read, with the numbers of every part that is given."""

from __future__ import annotations

from dataclasses import replace

import drake_rho as rho
from tests.arrays import FloatArray
from tests.scenarios import single

COURIER = """
courier: 1 vehicle, 3 obstacles
time                      0 to 10 s, 41 knots, 0.25 s apart
vehicle courier           from [0.0, 0.0, 1.5] m to [12.0, 0.0, 1.5] m, radius 0.2 m
limits                    speed 4 m/s
acceleration              [-3.0, -3.0, -3.0] to [3.0, 3.0, 3.0] m/s²
obstacle 1 (south house)  box from [5.0, -4.0, 0.0] to [6.0, 0.3, 4.0]
obstacle 2 (north house)  box from [5.0, 1.9, 0.0] to [6.0, 5.0, 4.0]
obstacle 3 (tree)         sphere of radius 0.8 m at [8.5, 0.4, 1.5]
wind                      up to 0.5 m/s², estimates within 0.02 m and 0.05 m/s
"""

PAIR = """
pair: 2 vehicles, 3 obstacles
time                  1 to 9 s, 17 knots, 0.5 s apart
vehicle a             from [0.0, 0.0, 1.0] m at [1.0, 0.0, 0.0] m/s to [9.0, 0.0, 1.0] m, 1 waypoint
vehicle b             from [0.0, 3.0, 1.0] m to [9.0, 3.0, 1.0] m, own limits
limits                acceleration 3 m/s², thrust 15 m/s², tilt 0.5 rad, jerk 9 m/s³
obstacle 1 (cart)     sphere of radius 0.5 m at [4.0, 9.0, 1.0], moving at [0.0, -1.0, 0.0] m/s
obstacle 2            sphere of radius 0.5 m at [5.0, -5.0, 1.0], uncertain, active from 2 to 4 s
obstacle 3            sphere of radius 1 m at [5.0, 6.0, 1.0], moving along a track, known from 3 s
requirement 1 (link)  position of b relative to a in sphere of radius 5 m at [0.0, 0.0, 0.0]
requirement 2         velocity in Slow
separation            at least 0.4 m, times 2 vertically
between knots         obstacles, separation and position box do not apply
after the end         vehicles can hold at their goals
"""


class Slow:
    """Ball of velocities up to 4 m/s, as a set of a user's own."""

    ball = rho.Ball([0, 0, 0], 4.0)

    def support(self, n: FloatArray) -> FloatArray:
        """Return the ball's."""
        return self.ball.support(n)

    def signed_distance(self, x: FloatArray) -> FloatArray:
        """Return the ball's."""
        return self.ball.signed_distance(x)

    def outward(self, x: FloatArray) -> FloatArray:
        """Return the ball's."""
        return self.ball.outward(x)


def pair() -> rho.Scenario:
    """Return a scenario with a part of almost every kind."""
    waypoint = rho.Waypoint(5.0, [4.0, 0.0, 1.0], 0.5)
    begin = rho.State([0, 0, 1], [1, 0, 0])
    cart = rho.Sphere([4, 9, 1], 0.5)
    track = rho.Track([0, 9], [[5, 6, 1], [6, 6, 1]])
    return rho.Scenario(
        "pair",
        rho.Grid(0.5, 17, start=1.0),
        [
            rho.Vehicle("a", begin, rho.State([9, 0, 1]), waypoints=[waypoint]),
            rho.Vehicle("b", rho.State([0, 3, 1]), rho.State([9, 3, 1]), rho.Limits(max_speed=2)),
        ],
        rho.Limits(max_acceleration=3, max_thrust=15, max_tilt=0.5, max_jerk=9),
        [
            rho.Obstacle(cart, velocity=[0, -1, 0], name="cart"),
            rho.Obstacle(rho.Sphere([5, -5, 1], 0.5), active=(2.0, 4.0), position_error=0.1),
            rho.Obstacle(rho.Sphere([5, 6, 1], 1), track=track, known_from=3),
        ],
        separation=rho.Separation(0.4, downwash=2.0),
        between_knots=False,
        requirements=[
            rho.KeepIn(rho.Ball([0, 0, 0], 5.0), vehicles="b", relative_to="a", name="link"),
            rho.KeepIn(Slow(), of="velocity"),
        ],
        hold_at_goal=True,
    )


def test_the_text_of_a_scenario_is_known() -> None:
    assert str(rho.load_scenario("courier")) == COURIER.strip()


def test_every_part_that_is_given_has_its_line() -> None:
    assert str(pair()) == PAIR.strip()


def test_smoothing_has_its_line() -> None:
    smooth = replace(rho.load_scenario("courier"), smoothing=rho.Smoothing(0.2, times=2))
    last = str(smooth).splitlines()[-1]
    assert last.startswith("smoothing  ")
    assert last.endswith("  averages over 0.2 s, 2 of them")


def test_many_vehicles_are_not_all_listed() -> None:
    scenario = single()
    (one,) = scenario.vehicles
    many = tuple(replace(one, name=f"v{number}") for number in range(1000))
    lines = str(replace(scenario, vehicles=many)).splitlines()
    assert lines[0] == "single: 1000 vehicles, 0 obstacles"
    assert lines[6].split()[:2] == ["vehicle", "v4"]
    assert lines[7].split() == ["...", "and", "995", "more"]
    assert len(lines) == 9


def test_the_repr_still_names_every_field() -> None:
    assert repr(single()).startswith("Scenario(name='single', grid=Grid(")
