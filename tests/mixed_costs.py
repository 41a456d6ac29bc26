"""Random scenes that also choose costs, goals, gates and soft limits, around a known motion.

Everything of `tests/mixed.py` comes first; the motion keeps what is added here, too, so that each
scene has a plan.
"""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np

import drake_rho as rho
from tests.mixed import Mixed, Rng, dense, mixed, rests, with_one
from tests.requirements import random_set


def chosen(seed: int) -> Mixed:
    """Return one scene; the same seed gives the same one."""
    scene, rng = mixed(seed, most=4, halts=seed % 3 == 0), np.random.default_rng([48, seed])
    for add in (_stops, _goals, _gates, _leg, _soft, _objective):
        if rng.random() < 0.6:
            for _ in range(3):
                tried = with_one(scene, add, rng)
                if tried is not None:
                    scene = tried
                    break
    return scene


def _size(scene: Mixed) -> float:
    return float(np.ptp(scene.known.positions, axis=1).max())


def _speed(scene: Mixed) -> float:
    return float(np.abs(scene.known.velocities).max()) + 1e-3 * _size(scene)


def _goals(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with free goals, free velocities, and goals in sets."""
    vehicles = list[rho.Vehicle]()
    for i, each in enumerate(scene.scenario.vehicles):
        p, v = scene.known.positions[i, -1], scene.known.velocities[i, -1]
        at_rest = each.goal.is_at_rest
        size, speed = 0.3 * _size(scene) * rng.uniform(0.1, 1.0), 0.3 * _speed(scene)
        place = random_set(rng, p, size)
        kinds: list[Any] = [
            each.goal,
            rho.State(p, None),
            None,
            rho.Goal(place, velocity=None),
            rho.Goal(place, velocity=v),
            rho.Goal(None, velocity=v),
            rho.Goal(p, velocity=rho.Ball(v, speed)),
            rho.Goal(place, velocity=rho.Ball(v, speed)),
            *([place, rho.Goal(None)] if at_rest else []),
        ]
        goal = kinds[rng.integers(len(kinds))] if rng.random() < 0.7 else each.goal
        vehicles.append(dataclasses.replace(each, goal=goal))
    return dataclasses.replace(scene.scenario, vehicles=tuple(vehicles))


def _stops(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with stops where the motion rests, some of them without a time."""
    scenario, plan, vehicles = scene.scenario, scene.known, list(scene.scenario.vehicles)
    for i, each in enumerate(vehicles):
        knots = rests(plan, i)
        if len(knots) < 2 or each.waypoints:
            continue
        steps, grid = np.ptp(knots), scenario.grid
        stop = rho.Waypoint(
            None if rng.random() < 0.6 else float(grid.times[knots[0]]),
            plan.positions[i, knots[0]],
            float(rng.choice([0.0, 0.05])) * _size(scene),
            velocity=rho.Ball([0.0] * 3, 0.05 * _speed(scene)) if rng.random() < 0.3 else None,
            dwell=float(steps * grid.step * rng.choice([rng.uniform(0.1, 1.0), 1.0])),
            name="stop",
        )
        vehicles[i] = dataclasses.replace(each, waypoints=(stop,))
    return dataclasses.replace(scenario, vehicles=tuple(vehicles))


def _gates(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with waypoints of a velocity, some of them without a time."""
    scenario, plan, grid = scene.scenario, scene.known, scene.scenario.grid
    vehicles = list(scenario.vehicles)
    i = int(rng.integers(len(vehicles)))
    if vehicles[i].waypoints:
        return scenario
    ways = []
    for number, part in enumerate(np.sort(rng.uniform(0.15, 0.85, int(rng.integers(1, 3))))):
        time = float(grid.start + part * grid.duration)
        sample = plan.at([time])
        p, v = sample.positions[i, 0], sample.velocities[i, 0]
        speed = _speed(scene)
        sets: list[Any] = [
            v,
            rho.Ball(v + rng.normal(0.0, 0.1, 3) * speed, 0.5 * speed),
            rho.Box(v - 0.3 * speed, v + 0.3 * speed),
            rho.Cone([0.0] * 3, v / max(np.linalg.norm(v), 1e-9), 0.6),
        ]
        ways.append(
            rho.Waypoint(
                None if rng.random() < 0.3 else time,
                p,
                float(rng.choice([0.0, 0.05])) * _size(scene),
                velocity=sets[rng.integers(len(sets))] if rng.random() < 0.8 else None,
                name=f"gate {number + 1}",
            )
        )
    vehicles[i] = dataclasses.replace(vehicles[i], waypoints=tuple(ways))
    return dataclasses.replace(scenario, vehicles=tuple(vehicles))


def _leg(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with a limit of speed between waypoints."""
    scenario = scene.scenario
    named = [each for each in scenario.vehicles if each.waypoints and each.waypoints[0].name]
    if not named:
        return scenario
    ends = (str(named[0].waypoints[0].name), "goal")
    most = rng.uniform(1.05, 1.5) * float(np.linalg.norm(scene.known.velocities, axis=-1).max())
    leg = rho.KeepIn(rho.Ball([0.0] * 3, most), of="velocity", vehicles=named[0].name, between=ends)
    return dataclasses.replace(scenario, requirements=(*scenario.requirements, leg))


def _soft(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario in which a requirement, an obstacle or a waypoint is soft."""
    scenario = scene.scenario
    effort = float(np.sum(scene.known.accelerations**2)) + 1e-9
    price = effort / _size(scene) * 10.0 ** rng.uniform(-2.0, 3.0)
    places = [
        *(("requirements", i) for i in range(len(scenario.requirements))),
        *(("obstacles", i) for i in range(len(scenario.obstacles))),
    ]
    if not places:
        return scenario
    field, index = places[rng.integers(len(places))]
    every = list(getattr(scenario, field))
    each = every[index]
    each = each if isinstance(each, rho.KeepIn | rho.Obstacle) else rho.Obstacle(each)
    every[index] = dataclasses.replace(each, penalty=price)
    changes: Any = {field: tuple(every)}
    return dataclasses.replace(scenario, **changes)


def _objective(rng: Rng, scene: Mixed) -> rho.Scenario:
    """Return the scenario with another cost, whose terms are about as large as each other."""
    scenario, plan = scene.scenario, scene.known
    t = scenario.grid.duration / 6.0
    scales = {"effort": 1.0, "jerk": t**2, "snap": t**4, "position": t**-4, "velocity": t**-2}
    if not any(vehicle.waypoints for vehicle in scenario.vehicles):
        scales |= {"terminal_position": 10 * t**-4, "terminal_velocity": 10 * t**-2}
    weights = {
        term: float(scale * 10.0 ** rng.uniform(-1.0, 1.0))
        for term, scale in scales.items()
        if rng.random() < 0.4
    }
    weights.setdefault("effort", 0.1)
    times = np.linspace(scenario.grid.start, scenario.grid.end, 7)
    around = plan.at(times).positions + rng.normal(size=(1, 7, 3)) * 0.2 * _size(scene)
    paths = [rho.Track(times, own) for own in around]
    return dataclasses.replace(scenario, objective=rho.Objective(**weights, reference=paths))


def quiet(seed: int) -> Mixed:
    """Return `chosen`, without warnings of scales."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rho.DrakeRhoWarning)
        return chosen(seed)


__all__ = ["chosen", "dense", "quiet"]
