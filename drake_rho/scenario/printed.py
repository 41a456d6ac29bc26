"""Text of a scenario for `print`: a title, then two columns with a line for each of its parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from drake_rho.scenario.disturbance import Disturbance
from drake_rho.scenario.frame import Frame
from drake_rho.scenario.goals import Goal
from drake_rho.scenario.limits import Limits
from drake_rho.scenario.norms import NORMS
from drake_rho.scenario.objective import Objective
from drake_rho.scenario.obstacles import Obstacle
from drake_rho.scenario.parts import UNITS, Grid, Separation, State, Vehicle
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.sets import set_text
from drake_rho.scenario.smoothing import Smoothing

LONGEST = 6
"""Largest number of lines for vehicles, obstacles or requirements."""

Line = tuple[str, str]
"""First and second column of a line."""


def in_columns(title: str, lines: Iterable[Line]) -> str:
    """Return a title, and lines in two columns below it."""
    rows = list(lines)
    width = max(len(name) for name, _ in rows)
    return "\n".join([title, *(f"{name:<{width}}  {words}" for name, words in rows)])


def title_of(name: str, vehicles: int, obstacles: int) -> str:
    """Return a scenario's name and its numbers of vehicles and obstacles."""
    return f"{name}: {_count(vehicles, 'vehicle')}, {_count(obstacles, 'obstacle')}"


def time_line(grid: Grid) -> Line:
    """Return the line of the time grid."""
    return "time", f"{grid.start:g} to {grid.end:g} s, {grid.knots} knots, {grid.step:g} s apart"


def vehicle_lines(vehicles: Sequence[Vehicle]) -> Iterator[Line]:
    """Yield the line of every vehicle, or of the first ones."""
    return _shortened([(f"vehicle {each.name}", _vehicle(each)) for each in vehicles])


def _vehicle(vehicle: Vehicle) -> str:
    words = [f"from {_state(vehicle.start)} to {_state(vehicle.goal)}"]
    if vehicle.waypoints:
        words.append(_count(len(vehicle.waypoints), "waypoint"))
    if vehicle.radius > 0.0:
        words.append(f"radius {vehicle.radius:g} m")
    if vehicle.limits:
        words.append("own limits")
    return ", ".join(words)


def _state(state: State | Goal) -> str:
    if isinstance(state, Goal):
        return str(state)
    if state.velocity is None:
        return f"{state.position.tolist()} m at any velocity"
    moving = f" at {state.velocity.tolist()} m/s" if state.velocity.any() else ""
    return f"{state.position.tolist()} m{moving}"


def limit_lines(limits: Limits) -> Iterator[Line]:
    """Yield a line with all norms, then one for every box: its lower and upper corners."""
    norms = ((kind, getattr(limits, field)) for field, kind in NORMS.items())
    words = [f"{kind.what} {most:g} {kind.unit}" for kind, most in norms if most is not None]
    if words:
        yield "limits", ", ".join(words)
    for quantity, unit in UNITS.items():
        if box := getattr(limits, quantity):
            yield quantity, f"{box.lower.tolist()} to {box.upper.tolist()} {unit}"


def obstacle_lines(obstacles: Sequence[Obstacle]) -> Iterator[Line]:
    """Yield the line of every obstacle, or of the first ones."""
    return _shortened([(each.called(n), _obstacle(each)) for n, each in enumerate(obstacles, 1)])


def _obstacle(obstacle: Obstacle) -> str:
    words = [str(obstacle.shape)]
    if obstacle.moves:
        velocity = obstacle.velocity
        how = "along a track" if velocity is None else f"at {velocity.tolist()} m/s"
        words.append(f"moving {how}")
    if obstacle.is_uncertain:
        words.append("uncertain")
    if obstacle.known_from > 0.0:
        words.append(f"known from {obstacle.known_from:g} s")
    if obstacle.active is not None:
        words.append("active from {:g} to {:g} s".format(*obstacle.active))
    if obstacle.penalty is not None:
        words.append(f"soft, {obstacle.penalty:g} m²/s⁴ per m")
    return ", ".join(words)


def requirement_lines(requirements: Sequence[KeepIn]) -> Iterator[Line]:
    """Yield the line of every requirement, or of the first ones."""
    return _shortened([(each.called(n), _kept(each)) for n, each in enumerate(requirements, 1)])


def _kept(requirement: KeepIn) -> str:
    vehicles = requirement.vehicles
    match vehicles:
        case None:
            who = ""
        case [one]:
            who = f" of {one}"
        case _:
            who = f" of {len(vehicles)} vehicles"
    to = requirement.leader or ("a moving point" if requirement.track else None)
    relative = f" relative to {to}" if to else ""
    words = f"{requirement.of}{who}{relative} in {set_text(requirement.set)}"
    if requirement.penalty is not None:
        words += f", soft, {requirement.penalty:g} m²/s⁴ per {requirement.unit}"
    return words


def option_lines(
    separation: Separation | None,
    disturbance: Disturbance | None,
    smoothing: Smoothing | None,
    *,
    between_knots: bool,
    hold_at_goal: bool,
    objective: Objective,
    frame: Frame | None,
) -> Iterator[Line]:
    """Yield the lines of other parts of a scenario that are not as by default."""
    if separation:
        vertical = "" if separation.is_round else f", times {separation.downwash:g} vertically"
        yield "separation", f"at least {separation.distance:g} m{vertical}"
    if not between_knots:
        yield "between knots", "obstacles, separation and position box do not apply"
    if disturbance:
        yield "wind", _wind(disturbance)
    if smoothing:
        yield "smoothing", f"averages over {smoothing.width:g} s, {smoothing.times} of them"
    if not objective.is_effort:
        terms = objective.weights._asdict().items()
        words = [f"{term.replace('_', ' ')} {weight:g}" for term, weight in terms if weight]
        yield "cost", f"weights: {', '.join(words)}"
    if hold_at_goal:
        yield "after the end", "vehicles can hold at their goals"
    if frame:
        yield "origin", str(frame)


def _wind(disturbance: Disturbance) -> str:
    words = f"up to {disturbance.acceleration:g} m/s²"
    errors = disturbance.position_error, disturbance.velocity_error
    if any(errors):
        words += ", estimates within {:g} m and {:g} m/s".format(*errors)
    return words


def _shortened(lines: Sequence[Line]) -> Iterator[Line]:
    """Yield all lines of one kind or, if there are many, the first and how many more there are."""
    if len(lines) <= LONGEST:
        yield from lines
    else:
        yield from lines[: LONGEST - 1]
        yield "...", f"and {len(lines) - LONGEST + 1} more"


def _count(number: int, noun: str) -> str:
    return f"1 {noun}" if number == 1 else f"{number} {noun}s"
