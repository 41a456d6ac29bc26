"""Missions to be written: the places of a plan, joined by straight legs that nobody times."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from pathlib import Path

import numpy as np

from drake_rho.formats.clearance import spare_of
from drake_rho.formats.folders import write_each
from drake_rho.formats.format import Format, planned
from drake_rho.formats.mission_items import LAND, TAKEOFF, WAYPOINT, Item
from drake_rho.formats.record import Exported
from drake_rho.formats.straight_legs import TOLERANCE, Legs, legs_of
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading
from drake_rho.motion.plan import Plan
from drake_rho.scenario.frame import EARTH_RADIUS, Frame

_RELATIVE = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT
_GROUND = 0.5
"""Height above the start up to which a goal at rest is landed at [m]."""


@dataclasses.dataclass(frozen=True)
class WrittenMission:
    """Mission of a vehicle with its places on the Earth."""

    home: list[float]
    """latitude, longitude [degrees] and altitude [m] of the start"""
    items: tuple[Item, ...]
    """items after home"""
    speed: float
    """largest speed of the plan [m/s]"""


class MissionFormat(Format):
    """File of a ground station for each vehicle."""

    folder = True
    rated = False
    content = "places joined by straight legs within 0.1 m of the plan, without times"
    read_by = "rho.load_mission(path), as a mission"

    def write(
        self, flown: Flown, path: Path, rate: float | None, heading: Heading | None
    ) -> Exported:
        """Write the file of the only vehicle, or a folder with a file for each.

        Raises:
            ValueError: the scenario has no frame, several vehicles are to be in one file, or a
                simulation was given.
        """
        plan = planned(flown, self.name)
        scenario = plan.scenario
        if scenario.frame is None:
            expected = f"Scenario(frame=Frame(latitude, longitude, altitude)) with {self.name}"
            raise ValueError(f"frame: got none, expected {expected}")
        legs = legs_of(plan, timed=False)
        speeds = np.linalg.norm(plan.velocities, axis=-1).max(axis=-1)
        texts = [
            self.text(_mission(each, scenario.frame, float(speed))).encode()
            for each, speed in zip(legs, speeds, strict=True)
        ]
        files = write_each(path, scenario.names, self.endings[0], texts)
        return _exported(plan, path, files, legs)

    @abstractmethod
    def text(self, mission: WrittenMission) -> str:
        """Return the content of a vehicle's file."""


def _mission(legs: Legs, frame: Frame, speed: float) -> WrittenMission:
    """Return the mission of a vehicle: up from home, along its legs, and down if it lands."""
    home, *places = frame.geodetic(legs.positions).tolist()
    items = list[Item]()
    for k, (latitude, longitude, altitude) in enumerate(places):
        height, hold = altitude - home[2], float(legs.dwells[k + 1])
        place = (0.0, 0.0, np.nan, latitude, longitude, height)
        if k == 0 and height > 0.0:
            items.append(Item("", TAKEOFF, _RELATIVE, (0.0, *place)))
            if hold == 0.0:
                continue
        lands = k == len(places) - 1 and k > 0 and legs.at_rest and height <= _GROUND
        items.append(Item("", LAND if lands else WAYPOINT, _RELATIVE, (hold, *place)))
    return WrittenMission(home, tuple(items), round(speed, 3))


def _exported(plan: Plan, path: Path, files: list[Path], legs: list[Legs]) -> Exported:
    """Return the record; without times, vehicles may be anywhere on their paths at once."""
    bent = [each.longest**2 / (8.0 * EARTH_RADIUS) for each in legs]
    deviations = np.array([each.deviation for each in legs]) + bent
    spare, scenario = spare_of(plan, deviations), plan.scenario
    together = scenario.separation is not None and len(legs) > 1
    if together or any(each.moves or each.active is not None for each in scenario.bodies):
        lost = scenario.separation.distance if together and scenario.separation else np.inf
        spare = dataclasses.replace(spare, left=min(spare.left, -lost), keeps_clear=False)
    count = max(len(each.times) - 1 for each in legs)
    words = f"{count} places with straight legs within {TOLERANCE:g} m, and no times"
    words += ", no fences" if scenario.bodies or scenario.requirements else ""
    words += ": separation is lost," if len(legs) > 1 else ","
    return Exported(path, tuple(files), words, scenario.names, deviations, spare)
