"""Objects of a simulation in Meshcat: planned positions as ghosts, error tubes, and the wind.

Under /flight in the scene tree, `planned/<name>` is a vehicle's planned pose, x along the planned
velocity. `tube/<name>` is the ball around the planned position that contains the vehicle, scaled by
its radius [m]. `tubes/<window>/<name>` is the tube of these balls along a window's prediction.
`wind/<name>` is an arrow along the wind, scaled by its ratio to the strongest wind.
"""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Rgba

from drake_rho.display.common.drawable import Drawn
from drake_rho.display.common.names import as_path
from drake_rho.display.meshcat.meshes import arrow, tube
from drake_rho.display.meshcat.poses import headings, poses, vehicle_poses
from drake_rho.display.meshcat.scene import Scene, coloured
from drake_rho.display.meshcat.trails import show_in_force
from drake_rho.display.meshcat.tree import Tree
from drake_rho.display.meshcat.vehicles import Vehicles, faint, uniform
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.tube import ErrorTube
from drake_rho.scenario.fields import FloatArray

_DARK = Rgba(0.15, 0.15, 0.18)
_GHOST, _BALL, _TUBE = 0.35, 0.18, 0.08
"""Opacities of planned positions, balls and tubes."""
_MIN_SCALE = 1e-6
"""Least scale of an object; Meshcat cannot show a size of zero."""
_SIDES = 12
"""Number of sides of a tube's cross-section."""
_PER_STEP = 4
"""Largest number of cross-sections of a tube in each step."""
_MAX_SECTIONS = 8000
"""Largest number of cross-sections of all tubes together."""
_MIN_SECTIONS = 8
"""Least number of cross-sections of a tube."""


def add_disturbed(
    tree: Tree, scene: Scene, plan: Drawn, simulation: Simulation, vehicles: Vehicles
) -> None:
    """Add ghosts of the plans, error tubes and wind arrows, and record them."""
    elapsed = tree.playback.times
    times = np.minimum(simulation.scenario.grid.start + elapsed, simulation.times[-1])
    places = np.swapaxes(simulation.nominal("position", times), 0, 1)
    velocities = np.swapaxes(simulation.nominal("velocity", times), 0, 1)
    up = np.array([0.0, 0.0, 1.0])
    planned = vehicle_poses(vehicles.kinds, places, velocities, up, vehicles.yaws)
    wind, radii = _wind(simulation, times), _radii(simulation, times)
    blown = poses(plan.motion().at("position", elapsed), headings(wind))
    along, strongest = arrow(_arrow_length(vehicles, scene)), strongest_wind(simulation)
    with_tube = largest_tube(simulation) > 0.0
    for i, (vehicle, colour) in enumerate(coloured(simulation.scenario)):
        name = as_path(vehicle.name)
        ghost = vehicles.body(i, light=scene.light)
        tree.add_mesh(f"planned/{name}", ghost, faint(colour, _GHOST))
        tree.move(f"planned/{name}", planned[i])
        if np.any(vehicles.scales[i] < 1.0):
            tree.scale(f"planned/{name}", uniform(vehicles.scales[i]))
        if with_tube:
            tree.add_ball(f"tube/{name}", 1.0, faint(colour, _BALL))
            tree.set_see_through(f"tube/{name}")
            tree.move(f"tube/{name}", planned[i])
            tree.scale(f"tube/{name}", uniform(np.maximum(radii, _MIN_SCALE)))
        if strongest > 0.0:
            parts = np.linalg.norm(wind[i], axis=1) / strongest
            tree.add_mesh(f"wind/{name}", along, _DARK)
            tree.move(f"wind/{name}", blown[i])
            tree.scale(f"wind/{name}", uniform(np.maximum(parts, _MIN_SCALE)))
    if with_tube:
        _add_tubes(tree, plan, simulation)
        show_in_force(tree, "tubes", plan.windows)


def largest_tube(simulation: Simulation | None) -> float:
    """Return the largest radius of the tubes around positions [m]; 0 without a simulation."""
    return 0.0 if simulation is None else float(simulation.radii().max())


def strongest_wind(simulation: Simulation | None) -> float:
    """Return the wind of an arrow of full length [m/s²]; 0 without a simulation or wind.

    It is the scenario's bound on the disturbance, or the strongest simulated wind if stronger.
    """
    if simulation is None:
        return 0.0
    disturbance = simulation.scenario.disturbance
    simulated = float(np.linalg.norm(simulation.wind, axis=2).max())
    if disturbance is None or simulated == 0.0:
        return simulated
    return max(simulated, disturbance.acceleration)


def _add_tubes(tree: Tree, plan: Drawn, simulation: Simulation) -> None:
    """Add the tube of every window, with fewer cross-sections for many windows and vehicles."""
    windows, vehicles = plan.windows, len(plan.positions)
    steps = sum(window.shown.scenario.grid.knots - 1 for window in windows)
    per_step = min(_PER_STEP, _MAX_SECTIONS / (steps * vehicles))
    for number, (window, errors) in enumerate(zip(windows, simulation.tubes, strict=True), start=1):
        paths, radii = _sections(window.shown, errors, per_step)
        for (vehicle, colour), path in zip(coloured(simulation.scenario), paths, strict=True):
            name = f"tubes/{number}/{as_path(vehicle.name)}"
            tree.add_mesh(name, tube(path, radii, _SIDES), faint(colour, _TUBE))
            tree.set_see_through(name)


def _sections(plan: Drawn, errors: ErrorTube, per_step: float) -> tuple[FloatArray, FloatArray]:
    """Return the centres [m], shape (N, S, 3), and radii [m], shape (S,), of a tube's sections."""
    grid = plan.scenario.grid
    count = max(_MIN_SECTIONS, round(per_step * (grid.knots - 1)) + 1)
    times = np.linspace(0.0, grid.duration, count)
    radii = errors.position(np.minimum(grid.start + times, grid.end))
    return plan.motion().at("position", times), np.maximum(radii, _MIN_SCALE)


def _wind(simulation: Simulation, times: FloatArray) -> FloatArray:
    """Return the wind at times on the scenario's clock [m/s²], shape (N, T, 3)."""
    m = simulation.scenario.grid.clock.last_begun(simulation.times, times)
    return np.swapaxes(simulation.wind[np.maximum(m, 0)], 0, 1)


def _radii(simulation: Simulation, times: FloatArray) -> FloatArray:
    """Return the radii of the tubes in force at times on the scenario's clock [m], shape (T,)."""
    numbers = simulation.in_force(times)
    found = [simulation.tubes[n].position(time) for n, time in zip(numbers, times, strict=True)]
    return np.array(found, dtype=np.float64)


def _arrow_length(vehicles: Vehicles, scene: Scene) -> float:
    """Return the length of the arrow of the strongest wind [m]."""
    return max(0.7 * scene.mark_length, 2.0 * float(vehicles.radii.max()))
