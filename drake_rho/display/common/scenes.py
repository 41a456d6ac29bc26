"""Scenes of a show, as the waypoints of its plan have them."""

from __future__ import annotations

from drake_rho.scenario.parts import Waypoint
from drake_rho.scenario.records import Scenario


def scenes_of(scenario: Scenario) -> list[tuple[Waypoint, ...]]:
    """Return the waypoints of all vehicles at the scenes of a show, scene by scene.

    A scene is a waypoint of all vehicles, at one time, with one name, and with colours of lights.
    """
    if len({len(vehicle.waypoints) for vehicle in scenario.vehicles}) != 1:
        return []
    stops = zip(*(vehicle.waypoints for vehicle in scenario.vehicles), strict=True)
    return [
        each
        for each in stops
        if len({(one.name, one.time) for one in each}) == 1
        and all(one.name and one.colour for one in each)
    ]
