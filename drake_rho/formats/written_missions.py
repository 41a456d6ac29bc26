"""Missions to be written: the places of a plan, joined by straight legs that nobody times."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from pathlib import Path
from typing import ClassVar

import numpy as np

from drake_rho.formats.clearance import spare_of
from drake_rho.formats.fences import fences_of
from drake_rho.formats.folders import write_each
from drake_rho.formats.format import Format, planned
from drake_rho.formats.mission_items import (
    CHANGE_SPEED,
    LAND,
    MOST_ITEMS,
    SLOWEST,
    TAKEOFF,
    WAYPOINT,
    Fence,
    Item,
)
from drake_rho.formats.record import Exported
from drake_rho.formats.routes import GROUND, LEVEL, ROOM, SAME_PLACE
from drake_rho.formats.straight_legs import Legs, legs_of
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading
from drake_rho.motion.plan import Plan
from drake_rho.scenario.frame import EARTH_RADIUS, Frame
from drake_rho.scenario.parts import GOAL
from drake_rho.scenario.records import HalfSpace, Scenario

_MISSION, _RELATIVE = 2, 3  # MAV_FRAME_MISSION, without a place; MAV_FRAME_GLOBAL_RELATIVE_ALT
_OVER_GROUND, _SAME_THROTTLE = 1.0, -1.0
_UPRIGHT = 2.5
"""Height above the ground up to which take-off and landing are vertical [m]: autopilots climb at
least as high at the place where they stand, and descend at the place of a landing."""
_ACCEPTED = 0.5
"""Distance at which a waypoint counts as reached [m]; with 0, autopilots take their own."""
_STORED = 700
"""Number of items from which they are counted: usual boards with ArduPilot store about as many."""
_DIGITS, _HEIGHT_DIGITS = 10, 6
"""Digits of degrees (a hundredth of a millimetre) and of metres; the rest is rounding."""


@dataclasses.dataclass(frozen=True)
class WrittenMission:
    """Mission of a vehicle with its places on the Earth."""

    home: list[float]
    """latitude, longitude [degrees] and altitude [m] of the start"""
    items: tuple[Item, ...]
    """items after home"""
    speed: float
    """largest speed of the plan [m/s]"""
    fences: tuple[Fence, ...] = ()
    """what the vehicle is kept in and out of"""


class MissionFormat(Format):
    """File of a ground station for each vehicle."""

    folder = True
    rated = False
    content = "a vertical take-off, then places joined by straight legs, without times"
    read_by = "rho.load_mission(path), as a mission"
    has_fences: ClassVar[bool]
    """whether a file holds fences"""

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write the file of the only vehicle, or a folder with a file for each.

        Raises:
            ValueError: the scenario has no frame, several vehicles are to be in one file, a
                simulation was given, or a mission has more items than MAVLink counts.
        """
        plan = planned(flown, self.name)
        scenario = plan.scenario
        if scenario.frame is None:
            expected = "Scenario(frame=Frame(latitude, longitude, altitude)), or frame: {latitude: "
            expected += f"..., longitude: ..., altitude: ...}} in its file, with {self.name}"
            raise ValueError(f"frame: got none, expected {expected}")
        grounds = [_ground(scenario, each) for each in scenario.names]
        found = legs_of(plan, timed=False)
        lands = [_lands(*each) for each in zip(found, grounds, strict=True)]
        legs = [_upright(*each) for each in zip(found, lands, strict=True)]
        speeds = np.linalg.norm(plan.velocities, axis=-1).max(axis=-1).tolist()
        missions = [
            _mission(each, scenario.frame, speed, landing)
            for each, speed, landing in zip(legs, speeds, lands, strict=True)
        ]
        if self.has_fences:
            missions = [_with_fences(each, index, plan) for index, each in enumerate(missions)]
        most = max(len(each.items) for each in missions)
        if most >= MOST_ITEMS:  # home is one more
            raise ValueError(f"{self.name}: got {most} items, expected less than {MOST_ITEMS}")
        texts = [self.text(each).encode() for each in missions]
        files = write_each(path, scenario.names, self.endings[0], texts)
        count = max(len(each.fences) for each in missions)
        return _exported(plan, path, files, legs, most, count)

    @abstractmethod
    def text(self, mission: WrittenMission) -> str:
        """Return the content of a vehicle's file."""


def _with_fences(mission: WrittenMission, index: int, plan: Plan) -> WrittenMission:
    """Return the mission of a vehicle with its fences."""
    scenario, heights = plan.scenario, plan.positions[index, :, 2]
    assert scenario.frame is not None  # noqa: S101  # checked before
    span = float(heights.min()), float(heights.max())
    fences = fences_of(scenario, scenario.names[index], scenario.frame, span)
    return dataclasses.replace(mission, fences=fences)


def _takes_off(legs: Legs) -> bool:
    """Return whether a vehicle is on the ground at its start: at rest, and it flies above it."""
    heights = legs.positions[:, 2]
    return legs.from_rest and heights.max() > heights[0] + SAME_PLACE


def _ground(scenario: Scenario, vehicle: str) -> float:
    """Return the height of the ground on which a mission lands above its start [m], else -inf.

    `load_mission` tells it by a floor of the last leg, called ground, since the motion alone could
    also end in the air.
    """
    for each in scenario.requirements:
        own = each.vehicles is not None and vehicle in each.vehicles
        descent = each.between is not None and each.between[1] == GOAL
        floor = each.set if each.of == "position" and isinstance(each.set, HalfSpace) else None
        if each.name == GROUND and own and descent and floor is not None and floor.normal[2] < 0.0:
            return floor.offset / float(floor.normal[2]) + ROOM
    return -np.inf


def _lands(legs: Legs, ground: float) -> bool:
    """Return whether the goal is on the ground: at rest, from above, and at a height of ground.

    Args:
        legs: legs of a vehicle.
        ground: height of the ground below the goal where it is above the start [m], else -inf.
    """
    heights = legs.positions[:, 2]
    from_above = heights.max() > heights[-1] + SAME_PLACE
    on_ground = heights[-1] <= heights[0] + LEVEL or abs(heights[-1] - ground) <= LEVEL
    return bool(legs.to_rest and from_above and on_ground)


def _upright(legs: Legs, lands: bool) -> Legs:
    """Return the legs as they are flown, with vertical take-off and landing, and their deviation.

    A leg from the ground becomes two, over a corner above the start: both are no farther from it
    than the corner is. A leg to the ground is the same backwards.
    """
    apart = legs.deviation
    if _takes_off(legs):
        legs = _with_corner(legs, 0, 1, apart)
    if lands and legs.positions[-2, 2] > legs.positions[-1, 2] + SAME_PLACE:
        legs = _with_corner(legs, -1, -2, apart)
    return legs


def _with_corner(legs: Legs, ground: int, other: int, apart: float) -> Legs:
    """Return the legs with a place above the one with index `ground`, before `other`.

    Args:
        legs: straight legs.
        ground: index of the first or last place.
        other: index of the place next to it.
        apart: distance of the motion from legs without corners [m].
    """
    leg = legs.positions[other] - legs.positions[ground]
    aside, rise = float(np.hypot(*leg[:2])), float(leg[2])
    if rise > SAME_PLACE >= aside:
        return legs  # upright already
    height, off = min(_UPRIGHT, rise), aside / float(np.linalg.norm(leg))
    if rise <= SAME_PLACE:  # along the ground at first
        top = float(legs.positions[:, 2].max() - legs.positions[ground, 2])
        height, off = min(_UPRIGHT, top), 1.0
    at = 1 if ground == 0 else len(legs.times) - 1
    corner = legs.positions[ground] + [0.0, 0.0, height]
    return dataclasses.replace(
        legs,
        times=np.insert(legs.times, at, legs.times[ground]),
        positions=np.insert(legs.positions, at, corner, axis=0),
        dwells=np.insert(legs.dwells, at, 0.0),
        deviation=max(legs.deviation, apart + height * off),
    )


def _mission(legs: Legs, frame: Frame, speed: float, lands: bool) -> WrittenMission:
    """Return the mission of a vehicle: up from home, along its legs, and down if it lands.

    Its largest speed is set after the take-off: autopilots begin with their own.
    """
    places = frame.geodetic(legs.positions)
    places[:, :2] = places[:, :2].round(_DIGITS) + 0.0  # no -0.0
    heights = (places[:, 2] - places[0, 2]).round(_HEIGHT_DIGITS) + 0.0
    items = list[Item]()
    for k in range(1, len(places)):
        hold, place = float(legs.dwells[k]), (*places[k, :2].tolist(), float(heights[k]))
        if k == 1 and _takes_off(legs):
            up = (*places[0, :2].tolist(), place[2])
            items.append(Item("", TAKEOFF, _RELATIVE, (0.0, 0.0, 0.0, np.nan, *up)))
            if hold == 0.0:
                continue
        if k == len(places) - 1 and lands:
            items.append(Item("", LAND, _RELATIVE, (0.0, 0.0, 0.0, np.nan, *place)))
        else:
            items.append(Item("", WAYPOINT, _RELATIVE, (hold, _ACCEPTED, 0.0, np.nan, *place)))
    most = round(speed, 3)
    if most >= SLOWEST:
        params = (_OVER_GROUND, most, _SAME_THROTTLE, 0.0, 0.0, 0.0, 0.0)
        items.insert(int(_takes_off(legs)), Item("", CHANGE_SPEED, _MISSION, params))
    home = [*places[0, :2].tolist(), round(float(places[0, 2]), _HEIGHT_DIGITS) + 0.0]
    return WrittenMission(home, tuple(items), most)


def _exported(
    plan: Plan, path: Path, files: list[Path], legs: list[Legs], most: int, fences: int
) -> Exported:
    """Return the record; without times, vehicles may be anywhere on their paths at once.

    Args:
        plan: the plan.
        path: path of the file or folder.
        files: paths of the files.
        legs: legs of all vehicles.
        most: largest number of items of a file.
        fences: largest number of fences of a file.
    """
    bent = [each.longest**2 / (8.0 * EARTH_RADIUS) for each in legs]
    deviations = np.array([each.deviation for each in legs]) + bent
    scenario = plan.scenario
    untimed = {
        scenario.obstacle_name(number): np.inf
        for number, each in enumerate(scenario.bodies, start=1)
        if each.moves or each.active is not None
    }
    if scenario.separation is not None and len(legs) > 1:
        untimed["separation"] = scenario.separation.distance
    spare = spare_of(plan, deviations).without(untimed)
    count = max(len(each.times) - 1 for each in legs)
    words = f"{count} places with straight legs, and no times"
    if most > _STORED:
        words += f", {most} items, where boards with ArduPilot usually store some {_STORED}"
    asked = {each.of for each in scenario.requirements}
    if fences:
        words += f", no fences but {fences} without an end in height"
    elif scenario.bodies or "position" in asked:
        words += ", no fences"
    words += ", no speeds of single legs" if "velocity" in asked else ""
    words += ": separation is lost," if len(legs) > 1 else ","
    return Exported(path, tuple(files), words, scenario.names, deviations, spare)
