"""`plan_show`: one plan for a whole show, from the take-off to the landing."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from itertools import repeat

import numpy as np

from drake_rho.motion.plan import Plan
from drake_rho.motion.statistics import Statistics
from drake_rho.planning.call.options import Options
from drake_rho.planning.call.progress import Progress, tell
from drake_rho.planning.call.time_limit import seconds_left, with_time_limit, within_time
from drake_rho.planning.call.wall_time import with_wall_time
from drake_rho.planning.errors import OutOfTimeError
from drake_rho.planning.programs.backend import Solver, SolverName
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.fields import FloatArray, IntArray
from drake_rho.scenario.records import Grid, Scenario, State, Vehicle, Waypoint
from drake_rho.scenario.times import steps_lasting
from drake_rho.shows.assignment import assigned, places_of
from drake_rho.shows.show import OFF, Scene, Show
from drake_rho.shows.transitions import Transition
from drake_rho.verification.verify import verify

LANDING = "landing"
"""Name of the last transition, and of the place above the pads to which it leads."""


@dataclasses.dataclass(frozen=True)
class _Leg:
    """Accelerations of all vehicles in some successive steps of the show."""

    accelerations: FloatArray
    """[m/s²], shape (N, steps, 3)"""
    statistics: Statistics = dataclasses.field(default_factory=Statistics)
    """statistics of planning"""


@checked
@with_wall_time
@with_time_limit
def plan_show(
    show: Show,
    *,
    solver: Solver | SolverName | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
    options: Options | None = None,
) -> Plan:
    """Return one plan for a whole show.

    Vehicles are assigned to places (`shows/assignment.py`), every transition is planned from rest
    to rest in the fewest steps found, and the motions are joined with the holds. The separation is
    kept at every instant of the whole flight, as `verify` judges; a scene is a waypoint of every
    vehicle in the plan's scenario, with the scene's name and its hold as dwell.

    Args:
        show: the show.
        solver: as for `plan`; `rho.Daqp()` is the fastest for large fleets.
        executor: any PEP 3148 executor, which plans the transitions side by side. The result does
            not depend on the number of workers. DAQP can be sent to processes, a Drake solver
            cannot.
        progress: called with a short text on the current activity.
        options: tolerances and bounds of the planner of each transition; `time_limit` is that of
            the whole show.

    Raises:
        InfeasibleError: a transition has no plan in any time tried.
        OutOfTimeError: `options.time_limit` was over before there was a plan.
        ScenarioError: a transition's given time, or the whole duration, is shorter than flights of
            a single vehicle allow; the message says by how much.
        SolverError: the solvers fail numerically.
    """
    transitions = list(transitions_of(show))
    _check_places(show, transitions)
    _check_times(show, transitions)
    options = options and dataclasses.replace(options, time_limit=None)
    flown = _planned(transitions, solver, options, executor, progress)
    above = transitions[-1].goals
    pads = above + (show.home - show.waiting_places)[:1]
    legs = [_vertical(show, show.home, show.waiting_places, solver, options), _still(show, 0.0)]
    arrivals = list[int]()
    for leg, hold in zip(flown, [*(scene.hold for scene in show.scenes), 0.0], strict=True):
        legs.append(leg)
        arrivals.append(sum(each.accelerations.shape[1] for each in legs))
        legs.append(_still(show, hold))
    legs.append(_vertical(show, above, pads, solver, options))
    found = _joined(show, transitions, legs, arrivals)
    if show.duration is not None and found.scenario.grid.duration > show.duration:
        expected = f"at least {found.scenario.grid.duration:g} s, the shortest that was found"
        raise ScenarioError("duration", show.duration, expected)
    return found


def transitions_of(show: Show) -> Iterator[Transition]:
    """Yield the transitions of a show, to each scene and back above the pads."""
    before = show.waiting_places
    *to_scenes, to_pads = assigned(show)
    for scene, places, taken in zip(show.scenes, places_of(show), to_scenes, strict=True):
        goals, lights = places.all[taken], [*scene.lights, *[OFF] * len(places.optional)]
        colours = tuple(lights[place] for place in taken)
        yield Transition(show, scene.name, before, goals, scene.transition, colours)
        before = goals
    yield Transition(show, LANDING, before, show.waiting_places[to_pads])


def _check_places(show: Show, transitions: Sequence[Transition]) -> None:
    """Check that vehicles may rest at all places of the show.

    Raises:
        ScenarioError: a place is outside the position box or too close to an obstacle, or the
            radius is too small beside a map.
    """
    scenes = {f"scenes[{index}].formation": each.goals for index, each in enumerate(transitions)}
    for field, places in {"pads": show.home, "take_off": show.waiting_places, **scenes}.items():
        try:
            Transition(show, field, places, places).scenario(2)
        except ScenarioError as error:
            own = error.field.rpartition(".")[2]  # position, or what a show gives for all vehicles
            where = field if own == "position" else own
            raise ScenarioError(where, error.value, error.expected) from None


def _check_times(show: Show, transitions: Sequence[Transition]) -> None:
    """Check given times against the least times of single vehicles.

    Raises:
        ScenarioError: a time is too short.
    """
    for index, each in enumerate(transitions):
        if each.duration is not None and each.duration < each.least:
            expected = f"at least {each.least:.3f} s, which the longest flight takes"
            raise ScenarioError(f"scenes[{index}].transition", each.duration, expected)
    if show.duration is None:
        return
    held = sum(scene.hold for scene in show.scenes)
    least = held + sum(each.duration or each.least for each in transitions)
    if show.duration < least:
        expected = f"at least {least:.3f} s: holds take {held:g} s, and transitions the rest"
        raise ScenarioError("duration", show.duration, expected)


def _planned(
    transitions: Sequence[Transition],
    solver: Solver | SolverName | None,
    options: Options | None,
    executor: Executor | None,
    progress: Progress | None,
) -> list[_Leg]:
    """Return the legs of all transitions, planned side by side if there is an executor.

    Workers begin with the longest, so that none of them ends late.
    """
    if executor is None:
        return [_leg(each, solver, options) for each in _told(transitions, progress)]
    ends = time.time() + seconds_left()  # workers have neither this call's clock nor its deadline
    given = repeat(solver), repeat(options), repeat(ends)
    order = sorted(range(len(transitions)), key=lambda index: -transitions[index].least)
    ordered = [transitions[index] for index in order]
    found = executor.map(_leg, ordered, *given)
    try:
        legs = [leg for _, leg in zip(_told(ordered, progress), found, strict=True)]
        return [legs[order.index(index)] for index in range(len(legs))]
    except OutOfTimeError as error:  # of what was left for one transition
        raise OutOfTimeError(statistics=error.statistics) from None


def _told(transitions: Sequence[Transition], progress: Progress | None) -> Iterator[Transition]:
    """Yield transitions, each after saying that it is planned."""
    for number, each in enumerate(transitions, start=1):
        tell(progress, f"transition {number} of {len(transitions)}, to {each.name}")
        yield each


def _leg(
    transition: Transition,
    solver: Solver | SolverName | None,
    options: Options | None,
    ends: float = math.inf,
) -> _Leg:
    """Return the accelerations of one transition, without its scenario, which is large to send.

    Args:
        transition: to be planned.
        solver: of the programs.
        options: of the planner.
        ends: deadline on the clock of `time.time` [s].
    """
    with within_time(None if ends == math.inf else ends - time.time()):
        found = transition.planned(solver, options)
    return _Leg(found.accelerations, found.statistics)


def _still(show: Show, hold: float) -> _Leg:
    """Return the steps in which all vehicles rest between two motions.

    Motions begin and end without acceleration where jerks are limited, so that a step is between.
    """
    limits = show.limits
    least = 0 if limits.jerk is None and limits.max_jerk is None else 1
    steps = max(steps_lasting(hold, show.step), least)
    return _Leg(np.zeros((len(show.home), steps, 3)))


def _vertical(
    show: Show,
    starts: FloatArray,
    goals: FloatArray,
    solver: Solver | SolverName | None,
    options: Options | None,
) -> _Leg:
    """Return the take-off or landing: one vertical motion, begun by each group in its turn.

    Vehicles whose pads are apart stay apart on vertical lines, whenever they fly.
    """
    if show.take_off is None:
        return _Leg(np.zeros((len(starts), 0, 3)))
    one = Transition(show, "the pads", starts[:1], goals[:1]).planned(solver, options)
    rises = goals[0, 2] > starts[0, 2]
    at_once = show.take_off.at_once or len(starts)
    turns = _pad_numbers(show, starts if rises else goals) // at_once
    if not rises:
        turns = turns.max() - turns
    waits = turns * steps_lasting(show.take_off.every, show.step)
    steps = one.accelerations.shape[1]
    accelerations = np.zeros((len(starts), steps + int(waits.max()), 3))
    for vehicle, wait in enumerate(waits):
        accelerations[vehicle, wait : wait + steps] = one.accelerations[0]
    _check_vertical(show, starts, goals, accelerations)
    return _Leg(accelerations, one.statistics)


def _check_vertical(
    show: Show, starts: FloatArray, goals: FloatArray, accelerations: FloatArray
) -> None:
    """Check the take-off or landing, which follows from the motion above one pad.

    Raises:
        ScenarioError: a vehicle violates a constraint, such as the distance from an obstacle.
    """
    scenario = Transition(show, "the pads", starts, goals).scenario(accelerations.shape[1])
    report = verify(Plan.from_accelerations(scenario, accelerations))
    if not report.ok:
        worst = report.violations[0]
        expected = f"a clear way up and down above every pad; {worst.vehicle}: {worst.what}"
        raise ScenarioError("take_off", Description(f"{show.take_off}"), expected)


def _pad_numbers(show: Show, pads: FloatArray) -> IntArray:
    """Return which pad each of some positions is, shape (N,)."""
    numbers = {tuple(pad): number for number, pad in enumerate(show.home.tolist())}
    return np.array([numbers[tuple(pad)] for pad in pads.tolist()])


def _joined(
    show: Show, transitions: Sequence[Transition], legs: Sequence[_Leg], arrivals: Sequence[int]
) -> Plan:
    """Return the plan of successive legs.

    Args:
        show: the show.
        transitions: to each scene and back.
        legs: all legs, holds included.
        arrivals: number of steps from the beginning to the end of each transition.
    """
    accelerations = np.concatenate([leg.accelerations for leg in legs], axis=1)
    grid = Grid(show.step, accelerations.shape[1] + 1)
    statistics = sum((leg.statistics for leg in legs), Statistics())
    scenario = _whole(show, transitions, grid, [show.step * each for each in arrivals])
    return Plan.from_accelerations(scenario, accelerations, statistics)


def _whole(
    show: Show, transitions: Sequence[Transition], grid: Grid, times: Sequence[float]
) -> Scenario:
    """Return the scenario of a whole show, in which scenes are waypoints of all vehicles."""
    descent = (show.home - show.waiting_places)[0]
    vehicles = [
        Vehicle(
            name,
            State(show.home[number]),
            State(transitions[-1].goals[number] + descent),
            radius=show.radius,
            waypoints=[
                _stop(scene, time, each.goals[number], each.colours[number])
                for scene, time, each in zip(show.scenes, times, transitions, strict=False)
            ],
        )
        for number, name in enumerate(show.vehicles)
    ]
    return Scenario(show.name, grid, vehicles, show.limits, show.obstacles, show.separation)


def _stop(scene: Scene, time: float, position: FloatArray, colour: str) -> Waypoint:
    """Return the waypoint of one vehicle's place in a scene, at rest."""
    if scene.hold > 0.0:
        return Waypoint(time, position, dwell=scene.hold, name=scene.name, colour=colour)
    return Waypoint(time, position, velocity=np.zeros(3), name=scene.name, colour=colour)
