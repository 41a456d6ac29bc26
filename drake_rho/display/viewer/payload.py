"""Data of the page's overlay: numbers, names, layers and the legend, as plain JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from drake_rho.display.common.map_faces import has_map, map_faces
from drake_rho.display.common.names import as_path, brief
from drake_rho.display.common.obstacle_snapshots import has_halo
from drake_rho.display.common.requirements import RequiredPositions, required_positions
from drake_rho.display.common.scenes import scenes_of
from drake_rho.display.common.style import (
    HIGHEST,
    LOWEST,
    NOTHING_LEFT,
    PLENTY_LEFT,
    VIEW_AZIMUTH,
    vehicle_colours,
)
from drake_rho.display.meshcat.animation import Stage
from drake_rho.display.meshcat.requirements import margins_while_shown
from drake_rho.display.meshcat.scene import MAX_DETAILED
from drake_rho.display.meshcat.tubes_and_wind import largest_tube, strongest_wind
from drake_rho.display.viewer.readings import Readings
from drake_rho.formats.lights import lights_of
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.shapes.base import TOLERANCE

_DIGITS = 7
"""Digits of lengths and speeds, relative to the size of the scene."""
_MAX_LISTED = 10
"""Largest number of requirements in the page's list."""


def payload(stage: Stage) -> dict[str, object]:
    """Return all data of a stage for the page, in SI units, times from the first knot."""
    scenario, scene, playback = stage.shown.scenario, stage.scene, stage.playback
    found = Readings.of(stage.shown, playback.times)
    decimals = max(4, _DIGITS - int(np.floor(np.log10(scene.size))))
    apart = scenario.separation
    return {
        "name": scenario.name,
        "start": scenario.grid.start,
        "duration": scenario.grid.duration,
        "step": scenario.grid.step,
        "rate": playback.rate,
        "times": np.round(playback.times, 6).tolist(),
        "vehicles": _vehicles(stage),
        "obstacles": _obstacles(stage),
        "speeds": np.round(found.speeds, decimals).tolist(),
        "clearances": _rounded(found.clearances, decimals),
        "nearest": found.nearest.tolist() if np.any(np.isfinite(found.clearances)) else [],
        "requirements": _requirements(stage, found, decimals),
        "curves": _curves(stage, found, decimals),
        "notice": "straight lines, not planned" if stage.shown.kind == "scenario" else "",
        "scenes": _scenes(scenario),
        "lights": _lights(scenario),
        "windows": [window.begin for window in stage.shown.windows],
        "knotsOnly": not scenario.between_knots,
        "tolerance": TOLERANCE * scene.size,
        "outline": np.round(scene.outline, decimals).tolist(),
        "seen": scene.seen,
        "view": [VIEW_AZIMUTH, scene.elevation],
        "shell": None if apart is None else (apart.shape.semi_axes / 2.0).tolist(),
        "light": scene.light,
        "fleet": MAX_DETAILED,
        "ranges": _ranges(found),
        "heights": [LOWEST, HIGHEST],
        "reddening": [NOTHING_LEFT, PLENTY_LEFT],
        "layers": _layers(stage),
        "legend": _legend(stage),
    }


def _scenes(scenario: Scenario) -> list[dict[str, object]]:
    """Return the names of a show's scenes, and when each begins and ends."""
    begins = [
        (scene[0], (scene[0].time or 0.0) - scenario.grid.start) for scene in scenes_of(scenario)
    ]
    return [
        {"name": stop.name, "begin": begin, "end": begin + stop.dwell} for stop, begin in begins
    ]


def _lights(scenario: Scenario) -> list[dict[str, object]]:
    """Return the colours of the vehicles' lights, from 0 to 1, and their times; empty without."""
    if all(each.colour is None for vehicle in scenario.vehicles for each in vehicle.waypoints):
        return []
    return [
        {
            "times": np.round(each.times - scenario.lead, 6).tolist(),
            "colours": np.round(each.colours.T / 255.0, 4).tolist(),
        }
        for each in lights_of(scenario)
    ]


def _vehicles(stage: Stage) -> list[dict[str, object]]:
    vehicles = stage.shown.scenario.vehicles
    colours = vehicle_colours(len(vehicles))
    return [
        {
            "name": vehicle.name,
            "label": brief(vehicle.name),
            "path": as_path(vehicle.name),
            "colour": to_hex(colour),
            "airframe": kind,
            "radius": radius,
        }
        for vehicle, colour, kind, radius in zip(
            vehicles, colours, stage.vehicles.kinds, stage.vehicles.radii.tolist(), strict=True
        )
    ]


def _obstacles(stage: Stage) -> list[dict[str, object]]:
    """Return the obstacles' names or numbers, and the heights of their tops above their centres."""
    return [
        {
            "name": f"obstacle {number}" if obstacle.name is None else obstacle.name,
            "label": None if obstacle.name is None else brief(obstacle.name),
            "above": float(min(obstacle.shape.extent[2], stage.scene.size)),
        }
        for number, obstacle in enumerate(stage.shown.scenario.bodies, start=1)
    ]


def _requirements(stage: Stage, found: Readings, decimals: int) -> list[dict[str, object]]:
    """Return margins in requirements of positions over time, of many only the tightest.

    From `plenty` metres on, nothing of their colour is red.
    """
    shown, playback, names = stage.shown, stage.playback, stage.shown.scenario.names
    plenty = np.array([required.plenty(shown) for required in found.required])
    tight = np.array([required.minima(shown).values.min() for required in found.required]) / plenty
    entries: list[dict[str, object]] = []
    for number in np.sort(np.argsort(tight, kind="stable")[:_MAX_LISTED]):
        required = found.required[number]
        margins = margins_while_shown(required, shown, playback.times, playback).min(axis=0)
        entries.append(
            {
                "label": required.label,
                "title": required.in_words(names),
                "left": _rounded(margins, decimals),
                "plenty": float(plenty[number]),
            }
        )
    return entries


def _curves(stage: Stage, found: Readings, decimals: int) -> list[dict[str, object]]:
    """Return the least values over the fleet, each with its limit and its minimum."""
    scenario = stage.shown.scenario
    apart, uncertain = scenario.separation, any(each.is_uncertain for each in scenario.bodies)
    scaled = apart is not None and not apart.is_round
    measured = "from where obstacles may be" if uncertain else "from obstacles"
    padded = ", minus the vehicle's radius" if np.any(scenario.fleet.radii > 0.0) else ""
    vehicles = [brief(vehicle.name) for vehicle in scenario.vehicles]
    bodies = [brief(str(each["name"])) for each in _obstacles(stage)]
    by_scale = f"vertical distances divided by {apart.downwash:g}" if apart and scaled else ""
    labels = [each.label for each in found.required]
    return [
        {
            "title": title,
            "how": how,
            "times": np.round(curve.times, 6).tolist(),
            "values": _rounded(curve.values, decimals),
            "limit": curve.limit,
            "least": [float(each[np.argmin(curve.values)]) for each in (curve.times, curve.values)],
            "closest": [vehicles[curve.closest[0]], others[curve.closest[1]]],
        }
        for title, how, curve, others in (
            ("Least separation", by_scale, found.pairs, vehicles),
            ("Least clearance", measured + padded, found.obstacles, bodies),
            ("Least left of a requirement", "", found.requirements, labels),
        )
        if curve is not None
    ]


def _ranges(found: Readings) -> dict[str, list[float]]:
    """Return the ranges of the colour scales: speeds from 0, clearances up to their median."""
    ranges = {"speed": [0.0, float(found.speeds.max())]}
    known = found.clearances[np.isfinite(found.clearances)]
    if known.size > 0:
        ranges["clearance"] = [0.0, max(float(np.median(known)), 1e-9)]
    return ranges


def _layers(stage: Stage) -> list[dict[str, object]]:
    """Return the layers that can be shown or hidden: titles, and paths in the scene tree."""
    scenario = stage.shown.scenario
    entries = [
        ("Trails", ["trails"], True),
        ("Measured", ["measured"], _with_measured(stage)),
        ("Predictions", ["predictions"], len(stage.windows) > 0),
        ("Contingencies", ["contingencies"], _with_contingencies(stage)),
        ("Tubes", ["tube", "tubes"], largest_tube(stage.simulation) > 0.0),
        ("Plans", ["planned"], stage.simulation is not None),
        ("Wind", ["wind"], strongest_wind(stage.simulation) > 0.0),
        ("Requirements", ["links", "points", "sets"], any(required_positions(scenario))),
        ("Starts and goals", ["starts", "goals", "waypoints", "lines"], True),
        ("Obstacles", ["obstacles"], has_map(scenario)),
        ("Radii", ["radii"], _with_radii(stage)),
        ("Shells", [], scenario.separation is not None),
        ("Names", [], True),
    ]
    return [{"title": title, "paths": paths} for title, paths, exists in entries if exists]


def _with_measured(stage: Stage) -> bool:
    return not stage.scene.light and stage.shown.measured is not None


def _with_contingencies(stage: Stage) -> bool:
    return any(each.braking is not None for each in stage.windows)


def _with_cones(stage: Stage) -> bool:
    return stage.vehicles.yaws is not None and "quadrotor" in stage.vehicles.kinds


def _with_radii(stage: Stage) -> bool:
    """Return whether balls of the vehicles' radii are drawn."""
    return not stage.scene.light and bool(np.any(stage.shown.scenario.fleet.radii > 0.0))


def _legend(stage: Stage) -> list[dict[str, str]]:
    """Return the legend: signs and their meanings."""
    scenario, light, bodies = stage.shown.scenario, stage.scene.light, stage.shown.scenario.bodies
    apart = 0.0 if scenario.separation is None else scenario.separation.distance
    passed = light or any(vehicle.waypoints for vehicle in scenario.vehicles)
    tube, wind = largest_tube(stage.simulation), strongest_wind(stage.simulation)
    small = ", too small to be visible" if tube < 2e-3 * stage.scene.size else ""
    lit = any(each.colour for vehicle in scenario.vehicles for each in vehicle.waypoints)
    entries = [
        (stage.vehicles.kinds[0], stage.vehicles.note, True),
        ("light", "light, grey while it is off", lit),
        ("quadrotor", "cone: heading of a quadrotor", _with_cones(stage)),
        ("prediction", "straight lines, not planned", stage.shown.kind == "scenario"),
        ("conflict", "red: vehicles and obstacles in conflict", stage.conflicts is not None),
        ("ends", "start (small) and goal (large)", not light),
        ("goal", "goal" if light else "waypoint", passed),
        ("prediction", "prediction of the current window", len(stage.windows) > 0),
        (
            "contingency",
            "how it would brake to rest, its contingency",
            _with_contingencies(stage),
        ),
        ("obstacle", "obstacle", any(not isinstance(each.shape, Map) for each in bodies)),
        ("map", f"map, paler the higher{_merged(scenario)}; Show can hide it", has_map(scenario)),
        (
            "unknown",
            "obstacle that is not known yet",
            any(obstacle.is_late(scenario.grid) for obstacle in bodies),
        ),
        ("unknown", "halo: where an obstacle may be", any(map(has_halo, bodies))),
        (
            "obstacle",
            "obstacles with a time window are shown while active",
            any(obstacle.active is not None for obstacle in bodies),
        ),
        *_of_requirements(list(required_positions(scenario))),
        ("radius", "vehicle's radius, the required distance from obstacles", _with_radii(stage)),
        (
            "shell",
            f"half the required separation of {apart:g} m: shells must not overlap",
            scenario.separation is not None,
        ),
        ("measured", "measured positions", _with_measured(stage)),
        ("planned", "faint: planned position", stage.simulation is not None),
        ("tube", f"error tube, at most {tube:.2g} m around the plan{small}", tube > 0.0),
        ("wind", f"wind; the longest arrow is {wind:.3g} m/s²", wind > 0.0),
    ]
    return [{"sign": sign, "text": text} for sign, text, exists in entries if text and exists]


def _merged(scenario: Scenario) -> str:
    """Return a note on the resolution of very large maps; empty if they are drawn exactly."""
    maps = [each.shape for each in scenario.bodies if isinstance(each.shape, Map)]
    merged = max((map_faces(each).merged for each in maps), default=0.0)
    return f", drawn in cells of {merged:.2g} m" if merged > 0.0 else ""


def _of_requirements(required: list[RequiredPositions]) -> list[tuple[str, str, bool]]:
    """Return the signs of requirements, with their meanings and whether there are any."""
    timed = any(each.requirement.active is not None for each in required)
    entries = [
        ("link", "link to another vehicle; red: nothing left"),
        ("link", "link to a moving point; red: nothing left"),
        ("set", "set in which vehicles stay"),
    ]
    which = {0 if each.partner is not None else 1 if each.is_link else 2 for each in required}
    last = max(which, default=None)
    return [
        (sign, f"{words}; shown while required" if timed and k == last else words, k in which)
        for k, (sign, words) in enumerate(entries)
    ]


def _rounded(values: FloatArray, decimals: int) -> list[Any]:
    """Return rounded numbers as lists, with None for infinite ones."""
    found = np.round(values, decimals).astype(object)
    found[~np.isfinite(values)] = None
    rounded: list[Any] = found.tolist()
    return rounded
