"""QGroundControl's plan files (.plan): JSON with a mission, fences and rally points.

Of complex items, those that hold their waypoints are read (survey, corridor scan), and landing
patterns as approach and landing; see docs.qgroundcontrol.com, "Plan File Format".
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from drake_rho.formats.mission_items import (
    FASTEST,
    LAND,
    MOST_ITEMS,
    NAVIGATION,
    RETURN,
    SLOWEST,
    WAYPOINT,
    Fence,
    Item,
    MissionFile,
)
from drake_rho.formats.routes import PLACED
from drake_rho.formats.written_missions import MissionFormat, WrittenMission
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import LARGEST
from drake_rho.scenario.frame import Frame
from drake_rho.scenario.refusals import malformed_json, scenario_error

_Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
_Latitude = Annotated[float, Field(ge=-90.0, le=90.0, allow_inf_nan=False)]
_Longitude = Annotated[float, Field(ge=-180.0, le=180.0, allow_inf_nan=False)]
_OnMap = tuple[_Latitude, _Longitude]
_Place = tuple[_Latitude, _Longitude, _Number]
_Corners = Annotated[tuple[_OnMap, ...], Field(min_length=3, max_length=1000)]
_Speed = Annotated[float, Field(ge=SLOWEST, le=FASTEST, allow_inf_nan=False)]
_FIXED_WING = 1  # MAV_TYPE
_AMSL, _CALCULATED = 0, 3
"""Frame of altitudes above mean sea level, and mode of those that the ground station calculates
from its map of the terrain: `params` has null while it has no map."""
_OLDER_TYPE, _OLDER_KEY = "Mission", "MAV_AUTOPILOT"
"""Type, or without one a key, of files before plans (.mission)."""


class _Part(BaseModel):
    """Part of a file, whose other fields are not read."""

    model_config = ConfigDict(extra="ignore", strict=True, alias_generator=to_camel)


class _Circle(_Part):
    center: _OnMap
    radius: Annotated[float, Field(ge=1.0 / LARGEST, le=1e6, allow_inf_nan=False)]


class _CircleFence(_Part):
    circle: _Circle
    inclusion: bool


class _PolygonFence(_Part):
    polygon: _Corners
    inclusion: bool


class _Fences(_Part):
    circles: Annotated[tuple[_CircleFence, ...], Field(max_length=1000)] = ()
    polygons: Annotated[tuple[_PolygonFence, ...], Field(max_length=1000)] = ()
    polygon: tuple[_OnMap, ...] = ()  # of version 1
    breach_return: object = None


_PARAMETERS = 7
"""Number of parameters of an item, of which the last three are its place."""


class _Item(_Part):
    type: str = "SimpleItem"
    command: Annotated[int, Field(ge=0, le=65535)] | None = None
    frame: Annotated[int, Field(ge=0, le=255)] | None = None
    params: Annotated[tuple[_Number | None, ...], Field(max_length=_PARAMETERS)] = ()
    coordinate: tuple[_Number | None, _Number | None, _Number | None] | None = None  # older files
    altitude_mode: _Number | None = Field(None, alias="AltitudeMode")
    calculated: _Number | None = Field(None, alias="AMSLAltAboveTerrain")
    complex_item_type: str | None = None
    transect_style_complex_item: _Transects | None = Field(None, alias="TransectStyleComplexItem")
    landing_approach_coordinate: _Place | None = None
    loiter_coordinate: _Place | None = None
    land_coordinate: _Place | None = None
    altitudes_are_relative: bool | None = None
    loiter_altitude_relative: bool | None = None  # older files have these two
    land_altitude_relative: bool | None = None


class _Transects(_Part):
    items: Annotated[tuple[_Item, ...], Field(alias="Items", max_length=MOST_ITEMS)] = ()


class _Mission(_Part):
    planned_home_position: tuple[_Latitude, _Longitude, _Number | None] | None = None
    items: Annotated[tuple[_Item, ...], Field(max_length=MOST_ITEMS)]
    cruise_speed: _Speed | None = None
    hover_speed: _Speed | None = None
    vehicle_type: int = 0


class _Rally(_Part):
    points: tuple[object, ...] = ()


class _Plan(_Part):
    file_type: Literal["Plan"]
    mission: _Mission
    geo_fence: _Fences = Field(default_factory=_Fences)
    rally_points: _Rally = Field(default_factory=_Rally)


def parse_plan(text: str) -> MissionFile:
    """Return the content of a plan file.

    Raises:
        ScenarioError: the text is not JSON, or not a plan; the error names the field.
    """
    try:
        content = json.loads(text)
        plan = _Plan.model_validate_json(text)
    except ValidationError as error:
        raise _older(content) or scenario_error(error, _Plan) from None
    except (ValueError, RecursionError) as error:
        raise malformed_json(error) from None
    mission, skipped = plan.mission, list[str]()
    items = tuple(
        item
        for number, each in enumerate(mission.items, start=1)
        for item in _items(f"item {number}", each, skipped)
    )
    home, levelled = _home(mission.planned_home_position)
    fixed = mission.vehicle_type == _FIXED_WING
    if plan.geo_fence.breach_return:
        skipped.append("the fence's breach return point")
    if plan.rally_points.points:
        skipped.append("rally points")
    return MissionFile(
        items,
        home,
        "" if levelled else "mission.plannedHomePosition[2]",
        tuple(_fences(plan.geo_fence)),
        mission.cruise_speed if fixed else mission.hover_speed,
        tuple(skipped),
    )


def _older(content: object) -> ScenarioError | None:
    """Return the error for a mission of before plans, None for other content."""
    if not isinstance(content, dict):
        return None
    kind = content.get("fileType")
    if kind != _OLDER_TYPE and (kind is not None or _OLDER_KEY not in content):
        return None
    expected = "a plan: open it in QGroundControl, and save it as .plan"
    return ScenarioError("", Description("an older mission of QGroundControl"), expected)


def _home(place: tuple[float, float, float | None] | None) -> tuple[Frame | None, bool]:
    """Return home, None if it is not set, and whether its altitude is known."""
    if place is None or not (place[0] or place[1]):
        return None, True
    latitude, longitude, altitude = place
    return Frame(latitude, longitude, altitude or 0.0), altitude is not None


def _items(name: str, item: _Item, skipped: list[str]) -> Iterator[Item]:
    """Yield the simple items of an item, which is added to `skipped` if it has none.

    Raises:
        ScenarioError: a key is missing on which the meaning of the others depends.
    """
    if item.type == "SimpleItem":
        yield _simple(name, item)
    elif (transects := item.transect_style_complex_item) is not None and transects.items:
        for number, each in enumerate(transects.items, start=1):
            yield from _items(f"{name}.{number}", each, skipped)
    elif item.land_coordinate is not None:
        frame = 3 if _is_relative(name, item) else 0
        approach = item.landing_approach_coordinate or item.loiter_coordinate
        if approach is not None:
            yield Item(f"{name}.1", WAYPOINT, frame, (0.0, 0.0, 0.0, 0.0, *approach))
        yield Item(f"{name}.2", LAND, frame, (0.0, 0.0, 0.0, 0.0, *item.land_coordinate))
    else:
        skipped.append(f"{name} ({item.complex_item_type or item.type})")


def _simple(name: str, item: _Item) -> Item:
    """Return a simple item, at its calculated altitude if its parameters have none.

    Raises:
        ScenarioError: command, frame or parameters are missing, or the terrain below a place.
    """
    if item.command is None or item.frame is None:
        key = "command" if item.command is None else "frame"
        raise ScenarioError(f"{name}, {key}", Description("nothing"), "a number, as of every item")
    placed = item.command in PLACED or (item.command <= NAVIGATION and item.command != RETURN)
    if placed and item.coordinate is None and len(item.params) != _PARAMETERS:
        got = Description(f"{len(item.params)} parameters")
        raise ScenarioError(f"{name}, params", got, f"{_PARAMETERS}, or a coordinate")
    place = item.coordinate or item.params[4:]
    params = (*_filled(item.params[:4], 4), *_filled(place, 3))
    found = Item(name, item.command, item.frame, params)
    if item.altitude_mode != _CALCULATED or not np.isnan(params[6]):
        return found
    if item.calculated is not None:
        return dataclasses.replace(found, frame=_AMSL, params=(*params[:6], item.calculated))
    if item.command in PLACED:
        expected = "a number: it is above the terrain, whose heights are not in the file"
        raise ScenarioError(f"{found}, altitude", Description("nothing"), expected)
    return found


def _is_relative(name: str, item: _Item) -> bool:
    """Return whether the altitudes of a landing pattern are relative to home."""
    if item.altitudes_are_relative is not None:
        return item.altitudes_are_relative
    older = item.loiter_altitude_relative
    if older is None or older != item.land_altitude_relative:
        expected = "true (to home) or false (above mean sea level)"
        raise ScenarioError(f"{name}, altitudesAreRelative", Description("nothing"), expected)
    return older


def _filled(values: tuple[float | None, ...], count: int) -> list[float]:
    """Return a number of values, NaN where they are null or missing."""
    given = [np.nan if each is None else each for each in values[:count]]
    return given + [np.nan] * (count - len(given))


def _fences(fences: _Fences) -> Iterator[Fence]:
    """Yield circles, then polygons, numbered from 1."""
    words = {True: "inclusion", False: "exclusion"}
    for number, each in enumerate(fences.circles, start=1):
        name = f"{words[each.inclusion]} circle {number}"
        yield Fence(name, each.inclusion, np.array([each.circle.center]), each.circle.radius)
    for number, one in enumerate(fences.polygons, start=1):
        name = f"{words[one.inclusion]} polygon {number}"
        yield Fence(name, one.inclusion, np.array(one.polygon))
    if fences.polygon:
        yield Fence("inclusion polygon", True, np.array(fences.polygon))


class QGroundControl(MissionFormat):
    """Plan of a vehicle, with altitudes relative to where it starts."""

    name = "qgroundcontrol"
    endings = (".plan",)
    has_fences = True

    def text(self, mission: WrittenMission) -> str:
        """Return the content of a vehicle's file."""
        items = [_written(number, each) for number, each in enumerate(mission.items, start=1)]
        content: dict[str, Any] = {
            "fileType": "Plan",
            "geoFence": {**_written_fences(mission.fences), "version": 2},
            "groundStation": "QGroundControl",
            "mission": {
                "cruiseSpeed": mission.speed,
                "firmwareType": 12,  # PX4
                "globalPlanAltitudeMode": 1,
                "hoverSpeed": mission.speed,
                "items": items,
                "plannedHomePosition": mission.home,
                "vehicleType": 2,  # a quadrotor
                "version": 2,
            },
            "rallyPoints": {"points": [], "version": 2},
            "version": 1,
        }
        return json.dumps(content, indent=4) + "\n"


def _written(number: int, item: Item) -> dict[str, Any]:
    """Return an item as in the file."""
    params = [None if np.isnan(each) else each for each in item.params]
    written = {
        "autoContinue": True,
        "command": item.command,
        "doJumpId": number,
        "frame": item.frame,
        "params": params,
        "type": "SimpleItem",
    }
    if item.is_placed:
        relative = {"AMSLAltAboveTerrain": None, "Altitude": params[6], "AltitudeMode": 1}
        written = {**relative, **written}
    return written


def _written_fences(fences: Sequence[Fence]) -> dict[str, list[dict[str, Any]]]:
    """Return circles and polygons as in the file; 1e-10 of a degree are a hundredth of a mm."""
    circles, polygons = list[dict[str, Any]](), list[dict[str, Any]]()
    for fence in fences:
        corners, common = fence.corners.round(10).tolist(), {"inclusion": fence.inclusion}
        if fence.radius is None:
            polygons.append({"polygon": corners, **common, "version": 1})
        else:
            circle = {"center": corners[0], "radius": fence.radius}
            circles.append({"circle": circle, **common, "version": 1})
    return {"circles": circles, "polygons": polygons}
