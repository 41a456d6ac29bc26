"""Missions of ground stations, as their files hold them: items, fences and home."""

from __future__ import annotations

import dataclasses

import numpy as np

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.frame import Frame

WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, RETURN = 16, 17, 18, 19, 20
LAND, TAKEOFF, LOITER_TO_ALTITUDE, ARC, SPLINE, VTOL_TAKEOFF, VTOL_LAND = 21, 22, 31, 36, 82, 84, 85
DELAY, PAYLOAD_PLACE, CHANGE_SPEED = 93, 94, 178
NAVIGATION = 92
"""Largest number of commands that all have a place."""

AMSL, RELATIVE, TERRAIN = (0, 5), (3, 6), (10, 11)
"""Frames of MAVLink by what their altitudes are above: mean sea level, home, the terrain."""

SLOWEST, FASTEST = 0.01, 1000.0
"""Least and largest speed that is read [m/s]: others are slips, or in another unit."""

MOST_ITEMS = 65_535
"""Largest number of items of a mission, as MAVLink counts them."""

_NAMES = {
    WAYPOINT: "NAV_WAYPOINT",
    LOITER_UNLIMITED: "NAV_LOITER_UNLIM",
    LOITER_TURNS: "NAV_LOITER_TURNS",
    LOITER_TIME: "NAV_LOITER_TIME",
    RETURN: "NAV_RETURN_TO_LAUNCH",
    LAND: "NAV_LAND",
    TAKEOFF: "NAV_TAKEOFF",
    30: "NAV_CONTINUE_AND_CHANGE_ALT",
    LOITER_TO_ALTITUDE: "NAV_LOITER_TO_ALT",
    ARC: "NAV_ARC_WAYPOINT",
    80: "NAV_ROI",
    SPLINE: "NAV_SPLINE_WAYPOINT",
    VTOL_TAKEOFF: "NAV_VTOL_TAKEOFF",
    VTOL_LAND: "NAV_VTOL_LAND",
    92: "NAV_GUIDED_ENABLE",
    DELAY: "NAV_DELAY",
    PAYLOAD_PLACE: "NAV_PAYLOAD_PLACE",
    112: "CONDITION_DELAY",
    114: "CONDITION_DISTANCE",
    115: "CONDITION_YAW",
    176: "DO_SET_MODE",
    177: "DO_JUMP",
    CHANGE_SPEED: "DO_CHANGE_SPEED",
    179: "DO_SET_HOME",
    181: "DO_SET_RELAY",
    183: "DO_SET_SERVO",
    184: "DO_REPEAT_SERVO",
    189: "DO_LAND_START",
    195: "DO_SET_ROI_LOCATION",
    197: "DO_SET_ROI_NONE",
    200: "DO_CONTROL_VIDEO",
    201: "DO_SET_ROI",
    203: "DO_DIGICAM_CONTROL",
    205: "DO_MOUNT_CONTROL",
    206: "DO_SET_CAM_TRIGG_DIST",
    207: "DO_FENCE_ENABLE",
    208: "DO_PARACHUTE",
    211: "DO_GRIPPER",
    212: "DO_AUTOTUNE_ENABLE",
    530: "SET_CAMERA_MODE",
    2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE",
    2500: "VIDEO_START_CAPTURE",
    2501: "VIDEO_STOP_CAPTURE",
    3000: "DO_VTOL_TRANSITION",
    5000: "NAV_FENCE_RETURN_POINT",
    5100: "NAV_RALLY_POINT",
}


@dataclasses.dataclass(frozen=True)
class Item:
    """Item of a mission: a command of MAVLink (MAV_CMD) with its parameters."""

    name: str
    """name in reports, as `item 3`"""
    command: int
    """number of the command"""
    frame: int
    """number of the frame of its place"""
    params: tuple[float, ...]
    """seven parameters, the last three latitude, longitude [degrees] and altitude [m]; NaN where
    the file gives none"""

    def __str__(self) -> str:
        """Return name and command: 'item 3 (DO_SET_ROI)'."""
        return f"{self.name} ({_NAMES.get(self.command, f'command {self.command}')})"

    def geodetic(self, home: Frame, before: FloatArray) -> FloatArray:
        """Return latitude, longitude [degrees] and altitude above mean sea level [m], shape (3,).

        Latitude and longitude that are both zero or both missing are those of the place before, as
        autopilots take them; so is a missing altitude.

        Args:
            home: place to which relative altitudes refer.
            before: the place before, in the same units.

        Raises:
            ScenarioError: only one of latitude and longitude is given, the altitude is above the
                terrain or in an unknown frame, or this is no place on the Earth.
        """
        latitude, longitude, altitude = self.params[4:]
        place = np.array(before)
        if np.isnan(latitude) != np.isnan(longitude):
            missing = "latitude" if np.isnan(latitude) else "longitude"
            expected = "both latitude and longitude, or neither"
            raise ScenarioError(f"{self}, {missing}", Description("nothing"), expected)
        if self.is_placed:
            place[:2] = latitude, longitude
        if not (abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0):
            expected = "a latitude within 90 degrees and a longitude within 180"
            raise ScenarioError(str(self), place[:2].tolist(), expected)
        if not np.isnan(altitude):
            place[2] = altitude + self._datum(home)
        return place

    @property
    def is_placed(self) -> bool:
        """Whether it has a place on the map: 0, 0 is none."""
        latitude, longitude = self.params[4:6]
        return (latitude != 0.0 or longitude != 0.0) and not np.isnan([latitude, longitude]).any()

    def _datum(self, home: Frame) -> float:
        """Return the altitude of the level from which the item's altitude counts [m]."""
        if self.frame in AMSL:
            return 0.0
        if self.frame in RELATIVE:
            return home.altitude
        expected = "0 or 5 (above mean sea level), or 3 or 6 (relative to home)"
        if self.frame in TERRAIN:
            expected += ": the terrain's heights are not in the file"
        raise ScenarioError(f"{self}, frame", self.frame, expected)


@dataclasses.dataclass(frozen=True, eq=False)
class Fence:
    """Fence: a circle or polygon on the map, to stay inside or outside."""

    name: str
    """name in reports, as `inclusion polygon 1`"""
    inclusion: bool
    """whether vehicles stay inside"""
    corners: FloatArray
    """latitudes and longitudes [degrees] of the corners, shape (M, 2); of the centre of a circle
    alone"""
    radius: float | None = None
    """radius of a circle [m]; None for a polygon"""


@dataclasses.dataclass(frozen=True)
class MissionFile:
    """Content of a mission's file."""

    items: tuple[Item, ...]
    """items in their order, without home"""
    home: Frame | None = None
    """place of the launch; None if the file has none"""
    no_altitude: str = ""
    """field with the altitude of home if the file does not give it: `home` has 0"""
    fences: tuple[Fence, ...] = ()
    """circles and polygons"""
    speed: float | None = None
    """speed until an item changes it [m/s]; None if the file has none"""
    skipped: tuple[str, ...] = ()
    """parts of the file that are not read"""
