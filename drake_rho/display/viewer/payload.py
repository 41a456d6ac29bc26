"""Data of the page's overlay: numbers, names, layers and the legend, as plain JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from drake_rho.display.common.map_faces import has_map, map_faces
from drake_rho.display.common.names import as_path, brief
from drake_rho.display.common.requirements import Kept, kept_positions
from drake_rho.display.common.style import (
    HIGHEST,
    LOWEST,
    NOTHING_LEFT,
    PLENTY_LEFT,
    VIEW_AZIMUTH,
    vehicle_colours,
)
from drake_rho.display.meshcat.animation import Stage
from drake_rho.display.meshcat.requirements import left_while_shown
from drake_rho.display.meshcat.scene import MAX_DETAILED
from drake_rho.display.meshcat.tubes_and_wind import has_tube, strongest_wind
from drake_rho.display.viewer.readings import Curve, Readings
from drake_rho.motion.simulation import Simulation
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
        "clearances": _finite(np.round(found.clearances, decimals)),
        "nearest": found.nearest.tolist() if np.any(np.isfinite(found.clearances)) else [],
        "requirements": _requirements(stage, found, decimals),
        "curves": _curves(stage, found, decimals),
        "notice": "straight lines, not planned" if stage.shown.kind == "scenario" else "",
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
    plenty = np.array([kept.plenty(shown) for kept in found.kept])
    tight = np.array([kept.least(shown)[1].min() for kept in found.kept]) / plenty
    entries: list[dict[str, object]] = []
    for number in np.sort(np.argsort(tight, kind="stable")[:_MAX_LISTED]):
        kept = found.kept[number]
        left = left_while_shown(kept, shown, playback.times, playback).min(axis=0)
        entries.append(
            {
                "label": kept.label,
                "title": kept.in_words(names),
                "left": _finite(np.round(left[None], decimals))[0],
                "plenty": float(plenty[number]),
            }
        )
    return entries


def _curves(stage: Stage, found: Readings, decimals: int) -> list[dict[str, object]]:
    scenario = stage.shown.scenario
    vehicles = [brief(vehicle.name) for vehicle in scenario.vehicles]
    bodies = [brief(str(each["name"])) for each in _obstacles(stage)]
    curves = []
    if found.pairs is not None:
        apart = scenario.separation
        how = (
            ""
            if apart is None or apart.is_round
            else f"vertical distances divided by {apart.downwash:g}"
        )
        curves.append(_curve("Least separation", how, found.pairs, vehicles, vehicles))
    if found.obstacles is not None:
        padded = bool(np.any(scenario.fleet.radii > 0.0))
        uncertain = any(each.is_uncertain for each in scenario.bodies)
        how = "from where obstacles may be" if uncertain else "from obstacles"
        how += ", minus the vehicle's radius" if padded else ""
        curves.append(_curve("Least clearance", how, found.obstacles, vehicles, bodies))
    if found.requirements is not None:
        labels = [each.label for each in found.kept]
        curves.append(
            _curve("Least left of a requirement", "", found.requirements, vehicles, labels)
        )
    for each in curves:
        each["values"] = _finite(np.round(each["values"], decimals)[None])[0]
    return curves


def _curve(
    title: str, how: str, curve: Curve, vehicles: list[str], others: list[str]
) -> dict[str, Any]:
    one, other = curve.closest
    m = int(np.argmin(curve.values))
    return {
        "title": title,
        "how": how,
        "times": np.round(curve.times, 6).tolist(),
        "values": curve.values,
        "limit": curve.limit,
        "least": [float(curve.times[m]), float(curve.values[m])],
        "closest": [vehicles[one], others[other]],
    }


def _ranges(found: Readings) -> dict[str, list[float]]:
    """Return the ranges of the colour scales: speeds from 0, clearances up to their median."""
    ranges = {"speed": [0.0, float(found.speeds.max())]}
    known = found.clearances[np.isfinite(found.clearances)]
    if known.size > 0:
        ranges["clearance"] = [0.0, max(float(np.median(known)), 1e-9)]
    return ranges


def _layers(stage: Stage) -> list[dict[str, object]]:
    """Return the layers that can be shown or hidden: titles, and paths in the scene tree."""
    scenario, detailed = stage.shown.scenario, not stage.scene.light
    simulation = stage.shown.simulation if detailed else None
    entries = [
        ("Trails", ["trails"], True),
        ("Predictions", ["predictions"], detailed and len(stage.shown.windows) > 0),
        (
            "Contingencies",
            ["contingencies"],
            detailed and any(each.braking is not None for each in stage.shown.windows),
        ),
        ("Tubes", ["tube", "tubes"], simulation is not None and has_tube(simulation)),
        ("Plans", ["planned"], simulation is not None),
        ("Wind", ["wind"], simulation is not None and strongest_wind(simulation) > 0.0),
        ("Requirements", ["links", "points", "sets"], bool(list(kept_positions(scenario)))),
        ("Starts and goals", ["starts", "goals", "waypoints", "lines"], True),
        ("Obstacles", ["obstacles"], has_map(scenario)),
        ("Radii", ["radii"], detailed and bool(np.any(scenario.fleet.radii > 0.0))),
        ("Shells", [], scenario.separation is not None),
        ("Names", [], True),
    ]
    return [{"title": title, "paths": paths} for title, paths, exists in entries if exists]


def _legend(stage: Stage) -> list[dict[str, str]]:
    """Return the legend: signs and their meanings."""
    scenario, detailed = stage.shown.scenario, not stage.scene.light
    entries: list[tuple[str, str]] = []
    if (note := stage.vehicles.note) is not None:
        entries.append((stage.vehicles.kinds[0], note))
    if stage.shown.kind == "scenario":
        entries.append(("prediction", "straight lines, not planned"))
    if stage.conflicts is not None:
        entries.append(("conflict", "red: vehicles and obstacles in conflict"))
    if detailed:
        entries.append(("ends", "start (small) and goal (large)"))
        if any(vehicle.waypoints for vehicle in scenario.vehicles):
            entries.append(("goal", "waypoint"))
    else:
        entries.append(("goal", "goal"))
    if detailed and len(stage.shown.windows) > 0:
        entries.append(("prediction", "prediction of the current window"))
    if detailed and any(each.braking is not None for each in stage.shown.windows):
        entries.append(("contingency", "how it would brake to rest, its contingency"))
    if any(not isinstance(each.shape, Map) for each in scenario.bodies):
        entries.append(("obstacle", "obstacle"))
    if has_map(scenario):
        entries.append(("map", f"map, paler the higher{_merged(scenario)}; Show can hide it"))
    if any(obstacle.is_late(scenario.grid) for obstacle in scenario.bodies):
        entries.append(("unknown", "obstacle that is not known yet"))
    if any(each.is_uncertain and not isinstance(each.shape, Map) for each in scenario.bodies):
        entries.append(("unknown", "halo: where an obstacle may be"))
    if any(obstacle.active is not None for obstacle in scenario.bodies):
        entries.append(("obstacle", "obstacles with a time window are shown while active"))
    entries += _of_requirements(list(kept_positions(scenario)))
    if np.any(scenario.fleet.radii > 0.0) and detailed:
        entries.append(("radius", "vehicle's radius, the required distance from obstacles"))
    if scenario.separation is not None:
        shells = f"half the required separation of {scenario.separation.distance:g} m"
        entries.append(("shell", f"{shells}: shells must not overlap"))
    if stage.shown.simulation is not None and detailed:
        entries += _disturbed(stage, stage.shown.simulation)
    return [{"sign": sign, "text": text} for sign, text in entries]


def _merged(scenario: Scenario) -> str:
    """Return a note on the resolution of very large maps; empty if they are drawn exactly."""
    maps = [each.shape for each in scenario.bodies if isinstance(each.shape, Map)]
    merged = max(map_faces(each).merged for each in maps)
    return f", drawn in cells of {merged:.2g} m" if merged > 0.0 else ""


def _of_requirements(kept: list[Kept]) -> list[tuple[str, str]]:
    entries = []
    for to, number in (
        ("another vehicle", sum(each.partner is not None for each in kept)),
        ("a moving point", sum(each.requirement.track is not None for each in kept)),
    ):
        if number > 0:
            entries.append(("link", f"link to {to}; red: nothing left"))
    if not all(each.is_link for each in kept):
        entries.append(("set", "set in which vehicles stay"))
    if entries and any(each.requirement.active is not None for each in kept):
        sign, words = entries[-1]
        entries[-1] = sign, f"{words}; shown while required"
    return entries


def _disturbed(stage: Stage, simulation: Simulation) -> list[tuple[str, str]]:
    entries = [("planned", "faint: planned position")]
    if has_tube(simulation):
        most = float(simulation.radii().max())
        small = ", too small to be visible" if most < 2e-3 * stage.scene.size else ""
        entries.append(("tube", f"error tube, at most {most:.2g} m around the plan{small}"))
    if (most := strongest_wind(simulation)) > 0.0:
        entries.append(("wind", f"wind; the longest arrow is {most:.3g} m/s²"))
    return entries


def _finite(values: FloatArray) -> list[list[float | None]]:
    """Return numbers as lists, with None for infinite ones."""
    known = np.isfinite(values)
    if np.all(known):
        return values.tolist()  # type: ignore[no-any-return]
    return [
        [value if finite else None for value, finite in zip(row, which, strict=True)]
        for row, which in zip(values.tolist(), known.tolist(), strict=True)
    ]
