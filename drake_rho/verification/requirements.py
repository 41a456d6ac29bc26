"""Requirements (`KeepIn`), verified by membership alone: the distance of values from their set.

The support function and the normals of a set, which planners use, are not used. Positions are
verified at every instant (`drake_rho.verification.highest_over_time`). Velocities are linear and
accelerations constant in a piece of time, so the ends of pieces suffice or, with errors, the ends
of the feedback's samples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_rho.motion.scenario_tube import tube_of
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.limits import GRAVITY
from drake_rho.scenario.requirements import KeepIn
from drake_rho.scenario.times import Clock
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, PRECISION, Column
from drake_rho.verification.highest_over_time import Highest, highest_over_time
from drake_rho.verification.jerks import Jerks
from drake_rho.verification.smooth_extremes import highest_of_steps
from drake_rho.verification.steps import Steps
from drake_rho.verification.trajectory import PiecewiseTrajectory


def check_requirements(trajectory: PiecewiseTrajectory, jerks: Jerks) -> Iterator[Column]:
    """Yield the checks of every requirement that is active in the flight.

    Args:
        trajectory: trajectory of all vehicles.
        jerks: jerks of the plan.
    """
    scenario = trajectory.scenario
    for number, asked in enumerate(scenario.requirements, start=1):
        check = _Check.of(trajectory, asked, number)
        if asked.interval(scenario.grid) is None:
            yield _nothing_left(trajectory, number, asked)
        elif asked.quantity == "position":
            yield from check_positions(trajectory, number)
        elif asked.quantity == "velocity":
            yield check.column(check.velocities(), "")
        elif asked.quantity == "acceleration":
            yield check.column(check.accelerations(), "")
        else:
            yield check.column(check.jerks(jerks), "")


def check_positions(trajectory: PiecewiseTrajectory, number: int) -> Iterator[Column]:
    """Yield the checks of a requirement of positions, at the knots and at every instant.

    Args:
        trajectory: trajectory of all vehicles.
        number: number of the requirement, from 1; it is active in the flight.
    """
    check = _Check.of(trajectory, trajectory.scenario.requirements[number - 1], number)
    yield check.column(check.positions_at(check.knots()), AT_KNOTS)
    yield check.column(check.positions_at_all_times(), AT_ALL_TIMES)


@dataclasses.dataclass(frozen=True, eq=False)
class _Check:
    """One requirement, with the trajectory cut where it begins, ends, or its track turns."""

    trajectory: PiecewiseTrajectory
    requirement: KeepIn
    """requirement, on a clock that is 0 at the first knot"""
    number: int
    interval: tuple[float, float]
    """first and last time at which it is required, since the first knot [s]"""
    members: IntArray
    """indices of the vehicles concerned, shape (M,)"""
    partner: int | None

    @classmethod
    def of(cls, trajectory: PiecewiseTrajectory, asked: KeepIn, number: int) -> _Check:
        grid, names = trajectory.scenario.grid, trajectory.scenario.names
        own = asked.since(grid)
        interval = own.interval(grid.beginning_at(0.0)) or (0.0, grid.duration)
        if asked.active is None:  # a smooth motion is longer than its plan
            lead = trajectory.scenario.lead
            interval = (interval[0] - lead, interval[1] + lead)
        turns = grid.clock.apart(np.concatenate([own.corners, interval]), trajectory.elapsed)
        cut = trajectory.cut(turns)
        return cls(cut, own, number, interval, own.members(names), own.partner(names))

    def column(self, worst: Highest, when: str) -> Column:
        """Return the checks of the vehicles concerned at their worst instants."""
        scenario = self.trajectory.scenario
        names, count = scenario.names, len(scenario.vehicles)
        whole = [np.zeros(count) for _ in range(4)]
        tolerances = self.requirement.tolerances(scenario.fleet, names)
        for values, found in zip(
            whole, (worst.times, worst.values, worst.errors, tolerances), strict=True
        ):
            values[self.members] = found
        times, values, errors, tolerances = whole
        due = np.zeros(count, dtype=bool)
        due[self.members] = True
        return Column(
            kind="requirements",
            constraint=self.requirement.called(self.number),
            parts=[" ".join(filter(None, (self._about, when)))] * count,
            times=scenario.grid.start + times,
            values=values,
            limits=0.0 - errors,
            excess=values + errors,
            tolerances=tolerances,
            unit=self.requirement.unit,
            asked=when != AT_ALL_TIMES or scenario.between_knots or self._is_instant,
            always=when == AT_ALL_TIMES,
            partners=None if self.partner is None else np.full(count, self.partner),
            errors=errors,
            due=due,
        )

    @property
    def _about(self) -> str:
        """Name of the constrained quantity, unless it is the position itself."""
        asked = self.requirement
        of = "" if asked.of == "position" else f"of {asked.of}"
        other = asked.leader or ("a moving point" if asked.track is not None else "")
        return " ".join(filter(None, (of, other and f"relative to {other}")))

    @property
    def _is_instant(self) -> bool:
        """Whether it is required at one instant only."""
        return self.interval[0] == self.interval[1]

    @property
    def _vehicles(self) -> float:
        """Number of vehicles whose errors add up."""
        return 1.0 if self.partner is None else 2.0

    @property
    def _clock(self) -> Clock:
        """Clock for comparing times."""
        return self.trajectory.scenario.grid.clock

    def _active(self, times: FloatArray) -> BoolArray:
        return self._clock.within(times, self.interval)

    def _relative(self, values: FloatArray) -> FloatArray:
        """Return values (M, ..., 3) of the vehicles concerned, relative to any partner."""
        own = values[self.members]
        return own if self.partner is None else own - values[self.partner]

    def knots(self) -> BoolArray:
        """Return flags of the knots at which it is active, among the trajectory's instants."""
        chosen = self._active(self.trajectory.elapsed)
        return chosen if self._is_instant else chosen & self.trajectory.knots

    def positions_at(self, instants: BoolArray) -> Highest:
        """Return the worst positions among selected instants of the trajectory."""
        if not instants.any():
            return self._nothing()
        times = self.trajectory.elapsed[instants]
        values = self._relative(self.trajectory.positions[:, instants])
        distances = self._distances(values, times)
        errors = self._vehicles * self.trajectory.errors(instants) + self.requirement.deviation
        return _worst_of(times, distances, errors)

    def _nothing(self) -> Highest:
        """Return values that hold, for an interval without a knot."""
        count = len(self.members)
        return Highest(np.full(count, self.interval[0]), np.full(count, -np.inf), np.zeros(count))

    def _distances(
        self, values: FloatArray, times: FloatArray, *, before: bool = False
    ) -> FloatArray:
        """Return signed distances (M, T) of values (M, T, 3) at times (T,)."""
        offset = self.requirement.offset(times, before=before, clock=self._clock)
        return np.asarray(self.requirement.set.signed_distance(values - offset))

    def positions_at_all_times(self) -> Highest:
        """Return the worst positions over all times at which it is active."""
        trajectory, scenario = self.trajectory, self.trajectory.scenario
        known = self.positions_at(self._active(trajectory.elapsed))
        if self._is_instant:
            return known
        if trajectory.higher is not None:
            errors = self._vehicles * trajectory.errors_over + self.requirement.deviation
            return self._highest_of_smooth(trajectory.steps, errors)
        middles = (trajectory.elapsed[:-1] + trajectory.elapsed[1:]) / 2.0
        states = (trajectory.positions, trajectory.velocities, trajectory.accelerations)
        p, v, a = (self._relative(each) for each in states)
        return highest_over_time(
            (p, v, a),
            trajectory.elapsed,
            np.flatnonzero(self._active(middles)),
            self._distances_at,
            self._position_errors,
            self._error_curvatures(),
            PRECISION * self.requirement.tolerances(scenario.fleet, scenario.names),
            known,
        )

    def _distances_at(self, x: FloatArray, times: FloatArray) -> FloatArray:
        """Return signed distances of positions (..., 3), less any partner's, at times (...)."""
        offset = self.requirement.offset(times.reshape(-1)).reshape(x.shape)
        return np.asarray(self.requirement.set.signed_distance(x - offset))

    def _error_curvatures(self) -> FloatArray:
        """Return κ of the error radius in each piece of time [m/s²], shape (J,)."""
        return self._vehicles * self.trajectory.curvatures

    def _position_errors(self, pieces: IntArray, times: FloatArray) -> FloatArray:
        """Return position error radii in pieces (P,) at times (S, P)."""
        trajectory, deviation = self.trajectory, self.requirement.deviation
        if trajectory.tubes is None:
            return np.full(times.shape, deviation)
        begins, start = trajectory.times[:-1][pieces], trajectory.scenario.grid.start
        ends = begins + trajectory.durations[pieces]
        at = np.clip(start + times, begins, ends)
        shape = [np.broadcast_to(each, times.shape) for each in (begins, ends)]
        return self._vehicles * trajectory.tubes.position_in(at, *shape) + deviation

    def _highest_of_smooth(self, steps: Steps, errors: FloatArray) -> Highest:
        """Return the worst instants of smooth curves, at all times in the interval.

        Args:
            steps: the curves in the pieces of time, vehicle by vehicle.
            errors: largest error radii in the pieces, shape (J,).
        """
        trajectory, count = self.trajectory, len(self.trajectory.durations)
        own = steps.select((count * self.members[:, None] + np.arange(count)).ravel())
        if self.partner is not None:
            other = count * self.partner + np.tile(np.arange(count), len(self.members))
            own = own.less(steps.select(other))
        offset, scenario = self.requirement.offset(np.zeros(1))[0], trajectory.scenario
        if self._is_instant:
            ends = np.stack([own.at(np.arange(len(own.p)), np.full((1, 1), u)) for u in (0.0, 1.0)])
            values = ends.reshape(2, len(self.members), count, 3)
            at = [self._active(each) for each in (trajectory.elapsed[:-1], trajectory.elapsed[1:])]
            met = np.concatenate(
                [each[:, chosen] for each, chosen in zip(values, at, strict=True)], 1
            )
            distances = np.asarray(self.requirement.set.signed_distance(met - offset))
            radii = np.concatenate([errors[chosen] for chosen in at])
            return _worst_of(np.full(len(radii), self.interval[0]), distances, radii)
        return highest_of_steps(
            own,
            trajectory.elapsed,
            lambda x: np.asarray(self.requirement.set.signed_distance(x - offset)),
            PRECISION * self.requirement.tolerances(scenario.fleet, scenario.names),
            self._active((trajectory.elapsed[:-1] + trajectory.elapsed[1:]) / 2.0),
            errors,
        )

    def velocities(self) -> Highest:
        """Return the worst velocities: at ends of pieces or, with errors, of samples too."""
        trajectory = self.trajectory
        if trajectory.higher is not None and not self._is_instant:
            errors = self._vehicles * trajectory.errors_of(1)
            return self._highest_of_smooth(trajectory.derivatives(1), errors)
        if trajectory.tubes is not None:
            tube = tube_of(trajectory.scenario)
            step = trajectory.scenario.grid.step
            count = tube.disturbance.samples_per_step(step)
            samples = np.arange(1, round(trajectory.elapsed[-1] / step * count)) * (step / count)
            trajectory = trajectory.cut(Clock.of(step).apart(samples, trajectory.elapsed))
        instants = self._active(trajectory.elapsed)
        if not (self._is_instant or trajectory.scenario.between_knots):
            instants &= trajectory.knots
        times = trajectory.elapsed[instants]
        if len(times) == 0:
            return self._nothing()
        values, errors = trajectory.velocities[:, instants], np.zeros(len(times))
        if trajectory.tubes is not None:
            errors = trajectory.tubes.at("velocity", trajectory.times[instants])
        if len(k := self._before_jumps(trajectory)) > 0:
            values = np.concatenate([values, trajectory.ends[1][:, k]], axis=1)
            left = np.zeros(len(k))
            if trajectory.tubes is not None:
                left = trajectory.tubes.before("velocity", trajectory.times[k + 1])
            times, errors = np.append(times, trajectory.elapsed[k + 1]), np.append(errors, left)
        values, errors = self._relative(values), self._vehicles * errors
        distances = self._distances(values, times)
        if self.requirement.track is not None:  # its velocity changes at a corner
            before = self._distances(values, times, before=True)
            late = self._clock.after(times, self.interval[0])
            distances = np.maximum(distances, np.where(late, before, -np.inf))
        return _worst_of(times, distances, errors)

    def _before_jumps(self, trajectory: PiecewiseTrajectory) -> IntArray:
        """Return the pieces that end in a jump while it is active."""
        k = trajectory.last_before_jumps
        if not trajectory.scenario.between_knots:
            return k[:0]
        ends = trajectory.elapsed[k + 1]
        begun = self._clock.after(ends, self.interval[0])
        return k[begun & self._clock.within(ends, self.interval)]

    def _steps(self, begins: FloatArray, ends: FloatArray) -> BoolArray:
        """Return flags of the steps [begin, end) that the interval meets."""
        return self._clock.meets(begins, ends, self.interval)

    def accelerations(self) -> Highest:
        """Return the worst accelerations or thrusts of the pieces of time."""
        if self.trajectory.higher is not None:
            errors = self._vehicles * self.trajectory.errors_of(2)
            return self._highest_of_smooth(self.trajectory.derivatives(2), errors)
        begins, ends = self.trajectory.elapsed[:-1], self.trajectory.elapsed[1:]
        chosen = self._steps(begins, ends)
        values = self._relative(self.trajectory.commands[:, chosen])
        if self.requirement.of == "thrust" and self.partner is None:
            values = values + np.array([0.0, 0.0, GRAVITY])
        distances = np.asarray(self.requirement.set.signed_distance(values))
        errors = self._vehicles * self.trajectory.feedback[chosen]
        return _worst_of(begins[chosen], distances, errors)

    def jerks(self, jerks: Jerks) -> Highest:
        """Return the worst jerks of the plan, which has no errors, or of the smooth motion."""
        if self.trajectory.higher is not None:
            errors = self.trajectory.errors_of(3)
            return self._highest_of_smooth(self.trajectory.derivatives(3), errors)
        grid = self.trajectory.scenario.grid
        times = grid.elapsed
        chosen = self._steps(times, times + grid.step)
        values, free = jerks.values[:, chosen], jerks.free[self.members][:, chosen]
        if self.partner is not None:
            free = free | jerks.free[self.partner, chosen]
        relative = np.where(free[..., None], 0.0, self._relative(values))
        distances = np.asarray(self.requirement.set.signed_distance(relative))
        distances = np.where(free, -np.inf, distances)
        return _worst_of(times[chosen], distances, np.zeros(int(chosen.sum())))


def _worst_of(times: FloatArray, distances: FloatArray, errors: FloatArray) -> Highest:
    """Return the worst of distances (M, T) plus errors (T,) at times (T,)."""
    k = np.argmax(np.where(np.isnan(distances), np.inf, distances + errors), axis=1)
    values = np.take_along_axis(distances, k[:, None], axis=1)[:, 0]
    return Highest(times[k], values, np.array(errors[k]))


def _nothing_left(trajectory: PiecewiseTrajectory, number: int, asked: KeepIn) -> Column:
    """Return an empty check of an expired requirement, so that it counts as checked."""
    count = len(trajectory.scenario.vehicles)
    zero = np.zeros(count)
    return Column(
        kind="requirements",
        constraint=asked.called(number),
        parts=[""] * count,
        times=zero,
        values=zero,
        limits=zero,
        excess=zero,
        tolerances=zero,
        unit=asked.unit,
        due=np.zeros(count, dtype=bool),
    )
