"""Verification of trajectories that any planner may have made.

Their polynomials become the pieces of a `PiecewiseTrajectory`, for which all checks are made: each
piece is cut where a piece of another vehicle begins, and at the knots. Samples are straight lines
with the error radii of `drake_rho.verification.sampled`.

Outside a vehicle's own time it is at rest, up to the beginning and the end of the scenario. Where a
file counts times in ticks and rounds its end up, the last piece goes on to the file's own end, and
the goal is to be met there.

A jump of position or velocity, also to rest, violates the dynamics. The acceleration may jump, as
it does in plans: the jerk there is the jump over one step of the scenario's grid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drake_rho.motion.polynomials import Polynomials
from drake_rho.motion.trajectories import Trajectories
from drake_rho.scenario.clock import clock_number
from drake_rho.scenario.fields import BoolArray, FloatArray
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import Column
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.sampled import SampleTubes, check_samples
from drake_rho.verification.states import check_flown, check_goal, check_start
from drake_rho.verification.trajectory import PiecewiseTrajectory
from drake_rho.verification.tubes import NO_ERRORS, Tubes

_NAMED = 3
"""Largest number of vehicles that a note names."""
_NANOSECOND = 1e-9
"""Unit of times whose rounding changes no state by more than the tolerances [s]."""


def trajectory_of_any(trajectories: Trajectories, scenario: Scenario) -> PiecewiseTrajectory:
    """Return trajectories as pieces of time that are the same for all vehicles.

    Raises:
        ValueError: the vehicles are not those of the scenario, a motion is outside its time, or
            samples are to be verified with a disturbance.
    """
    own = _since_start(trajectories, scenario)
    bound = trajectories.max_acceleration
    elapsed, knots = _instants(scenario, own, sampled=bound is not None)
    durations = np.diff(elapsed)
    c = np.concatenate(_alike([each.cut(elapsed).coefficients for each in own]))
    powers = np.arange(c.shape[-1], dtype=np.float64)
    s, terms = durations[:, None], c * durations[:, None, None] ** powers
    ends = terms.sum(axis=-1)
    slopes = (terms * powers).sum(axis=-1) / s
    bends = (terms * powers * (powers - 1.0)).sum(axis=-1) / s**2
    a = 2.0 * c[..., 2]
    return PiecewiseTrajectory(
        scenario,
        elapsed,
        durations,
        knots,
        positions=np.concatenate([c[..., 0], ends[:, -1:]], axis=1),
        velocities=np.concatenate([c[..., 1], slopes[:, -1:]], axis=1),
        accelerations=a,
        commands=a,
        higher=np.moveaxis(c[..., 3:], -1, -2),
        jerks=Jerks.at_joints(scenario, elapsed, a, bends, 0.0 if bound is None else np.inf),
        tubes=_tubes(scenario, own, bound),
        jumps=np.arange(1, len(durations)),
    )


def check_own(trajectory: PiecewiseTrajectory, trajectories: Trajectories) -> Iterator[Column]:
    """Verify that trajectories are continuous, begin at the starts and end at the goals.

    Samples can contradict the velocities of start and goal, but never prove them: they are met if a
    motion that the bound allows has them. So it is with jumps of polynomials, and their ends, if
    the coefficients are rounded.
    """
    bound, ends = trajectories.max_acceleration, trajectory.times[[0, -1]]
    if bound is None:
        joined = zip((trajectory.positions, trajectory.velocities), trajectory.ends, strict=True)
        p, v = (np.concatenate([whole[:, :1], each], axis=1) for whole, each in joined)
        own = trajectories.by_vehicle(trajectory.scenario)
        jumps = np.array([each.jumps for each in own]).T
        yield from check_flown(trajectory, p, v, jumps)
        yield from check_start(trajectory, jumps)
        yield from check_goal(trajectory, jumps)
        return
    yield check_samples(trajectory, trajectories, bound)
    first, last = trajectory.tubes.at("velocity", ends).tolist()
    yield from check_start(trajectory, (0.0, first))
    yield from check_goal(trajectory, (0.0, last))


def notes_on_trajectories(trajectories: Trajectories, scenario: Scenario) -> tuple[str, ...]:
    """Return notes on what is assumed: rest outside a vehicle's own time, a bound for samples."""
    grid, lead = scenario.grid, scenario.lead
    notes = list[str]()
    if (bound := trajectories.max_acceleration) is not None:
        widths = [np.diff(each.instants)[[0, -1]].max() for each in trajectories.motions.values()]
        notes.append(
            f"samples, verified with accelerations of at most {bound:g} m/s² between them; so "
            f"velocities at starts and goals are known to {bound * max(widths) / 2.0:.2g} m/s only"
        )
    rounded = [each.jumps for each in trajectories.motions.values() if each.resolution]
    if rounded:
        away, faster = np.max(rounded, axis=0)
        notes.append(
            f"jumps of up to {away:.2g} m and {faster:.2g} m/s, which the digits of the file's "
            "coefficients can explain, do not count"
        )
    if not _is_one(scenario, trajectories, trajectories.end, grid.end + lead) and grid.clock.after(
        trajectories.end, grid.end + lead
    ):
        end, tick = clock_number(trajectories.end), trajectories.tick
        notes.append(f"verified to {end} s, the end of the file, whose times are in {tick:g} s")
    late = {
        name: each.instants[0]
        for name, each in trajectories.motions.items()
        if grid.clock.after(each.instants[0], grid.start - lead)
    }
    early = {
        name: each.instants[-1]
        for name, each in trajectories.motions.items()
        if grid.clock.before(each.instants[-1], grid.end + lead)
    }
    for word, found in (("until", late), ("from", early)):
        texts = [f"{name} {word} {clock_number(time)} s" for name, time in found.items()]
        more = f" and {len(texts) - _NAMED} more" if len(texts) > _NAMED else ""
        if texts:
            notes.append(f"taken to be at rest: {', '.join(texts[:_NAMED])}{more}")
    return tuple(notes)


def _since_start(trajectories: Trajectories, scenario: Scenario) -> list[Polynomials]:
    """Return the motions on the clock of the scenario's first knot.

    Ends that differ from the scenario's by rounding to whole nanoseconds are the scenario's.
    """
    grid, lead = scenario.grid, scenario.lead
    found = list[Polynomials]()
    for each in trajectories.by_vehicle(scenario):
        instants = grid.since_start(each.instants)
        for place, end in ((0, -lead), (-1, grid.elapsed[-1] + lead)):
            if _is_one(scenario, trajectories, instants[place], end):
                instants[place] = end
        found.append(replace(each, instants=instants))
    return found


def _is_one(scenario: Scenario, trajectories: Trajectories, time: float, end: float) -> bool:
    """Return whether a time is that of an end, but for whole nanoseconds in the file."""
    tick = min(trajectories.tick, _NANOSECOND)
    return bool(scenario.grid.clock.same(time, end)) or abs(time - end) <= tick / 2.0


def _instants(
    scenario: Scenario, own: list[Polynomials], *, sampled: bool
) -> tuple[FloatArray, BoolArray]:
    """Return instants since the first knot [s] that cut every motion, and which count as knots.

    The knots are those of the grid. Of samples verified at every instant they are the samples.
    """
    grid, lead = scenario.grid, scenario.lead
    last = max(grid.elapsed[-1] + lead, *(each.instants[-1] for each in own))
    fixed = np.union1d(grid.elapsed, [-lead, last])
    given = grid.clock.distinct(np.concatenate([each.instants for each in own]))
    elapsed = np.union1d(fixed, grid.clock.apart(given, fixed))
    if sampled and scenario.between_knots:
        return elapsed, ~np.isin(elapsed, grid.clock.apart(fixed, given))
    return elapsed, np.isin(elapsed, grid.elapsed)


def _alike(coefficients: list[FloatArray]) -> list[FloatArray]:
    """Return coefficients of one degree, the lowest possible from 2 up."""
    degrees = [np.flatnonzero(each.any(axis=(0, 1, 2))) for each in coefficients]
    count = max(3, *(int(each.max(initial=0)) + 1 for each in degrees))
    return [
        np.pad(each, ((0, 0), (0, 0), (0, 0), (0, max(0, count - each.shape[-1]))))[..., :count]
        for each in coefficients
    ]


def _tubes(scenario: Scenario, own: list[Polynomials], bound: float | None) -> Tubes:
    """Return the error tubes: those of samples with a bound, or of the scenario's disturbance.

    Where a file ends later, by rounding, the tube of a disturbance is that of one step more.

    Raises:
        ValueError: there are samples and a disturbance.
    """
    if bound is None:
        tubes, ends = Tubes.of_plan(scenario), [each.instants[-1] for each in own]
        if tubes is NO_ERRORS or max(ends) <= scenario.grid.elapsed[-1] + scenario.lead:
            return tubes
        one = tubes.last
        return replace(tubes, tubes=(replace(one, grid=one.grid.from_knot(0, one.grid.knots)),))
    if scenario.disturbance is not None:
        expected = "expected one without: samples are verified as they were flown"
        raise ValueError(f"{scenario.name} has a disturbance, {expected}")
    return SampleTubes.of_samples([scenario.grid.start + each.instants for each in own], bound)
