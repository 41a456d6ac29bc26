"""`verify` of disturbed scenarios, compared with samples of the tube taken by hand.

The samples are of motions integrated by hand and of exact radii; no code of the verifier is used.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import drake_rho as rho
from drake_rho.motion.sampled_loop import is_stable
from drake_rho.scenario.disturbance import Tracking
from drake_rho.scenario.fields import unchecked
from drake_rho.scenario.rest_of_flight import from_states
from tests.arrays import FloatArray
from tests.requirements import GRAVITY
from tests.scenarios import box, examples, single, slow
from tests.shapes import KINDS, random_shape
from tests.test_obstacles_verified import by_hand, places, random_case

PER_STEP = 200

seeds = st.integers(0, 2**32 - 1)


@dataclasses.dataclass(frozen=True)
class Stretch:
    """Interval of time with one tube in force."""

    tube: rho.ErrorTube
    begin: float
    end: float

    def times(self, grid: rho.Grid) -> FloatArray:
        """Return dense times, with all knots and all samples of the feedback."""
        steps = round((self.end - self.begin) / grid.step)
        dense = np.linspace(self.begin, self.end, PER_STEP * steps + 1)
        count = steps * round(grid.step / self.tube.sample)
        return np.union1d(dense, np.linspace(self.begin, self.end, count + 1))


def stretches(flown: rho.Plan | rho.Flight) -> list[Stretch]:
    """Return the interval of a plan, or those of a flight's windows."""
    if isinstance(flown, rho.Plan):
        grid = flown.scenario.grid
        return [Stretch(rho.error_tube(flown.scenario), grid.start, grid.end)]
    ends = [window.plan.scenario.grid.start for window in flown.windows[1:]]
    ends.append(flown.scenario.grid.end)
    return [
        Stretch(rho.error_tube(window.plan.scenario), window.plan.scenario.grid.start, end)
        for window, end in zip(flown.windows, ends, strict=True)
    ]


def disturbed_case(seed: int, kind: str) -> rho.Plan | rho.Flight:
    """Return vehicles with errors around any motion, with limits of all kinds, near an obstacle."""
    rng = np.random.default_rng(seed)
    plan = random_case(seed, kind)
    asked, grid = plan.scenario, plan.scenario.grid
    h, size = grid.step, float(np.ptp(plan.positions, axis=(0, 1)).max())
    speed, force = (float(np.abs(each).max()) for each in (plan.velocities, plan.accelerations))
    limits = rho.Limits(
        rho.Box(plan.positions.min((0, 1)) - size / 9, plan.positions.max((0, 1)) + size / 9),
        box(speed + size / h / 9),
        box(force),
        box(force / h),
        max_speed=1.5 * speed + size / h / 9,
        max_acceleration=1.2 * force,
        max_thrust=GRAVITY + force,
        max_tilt=float(rng.uniform(0.1, 1.4)),
    )
    time = float(rng.uniform(grid.start + 1e-3 * h, grid.end - 1e-3 * h))
    waypoint = rho.Waypoint(time, by_hand(plan, 0, np.array([time]))[0], size / 5)
    vehicles = [
        unchecked(vehicle, waypoints=(waypoint,) if rng.integers(2) else ())
        for vehicle in asked.vehicles
    ]
    scenario = unchecked(
        asked,
        vehicles=tuple(vehicles),
        limits=limits,
        separation=rho.Separation(size / 5, float(rng.choice([0.5, 1.0, 2.0, 3.0]))),
        disturbance=_disturbance(rng, grid, size),
    )
    scenario = scenario.of_vehicles(range(len(vehicles)))
    plan = rho.Plan(scenario, plan.positions, plan.velocities, plan.accelerations)
    return _flight(rng, plan, size) if rng.integers(2) else plan


def _disturbance(rng: np.random.Generator, grid: rho.Grid, size: float) -> rho.Disturbance:
    parts, delay = int(rng.choice([1, 2, 7, 30])), int(rng.integers(0, 3))
    sample = grid.step / parts
    while True:
        omega, damping = 10 ** rng.uniform(-1.5, 0.0), rng.uniform(0.3, 1.5)
        gains = omega**2, 2.0 * damping * omega + omega**2 / 2.0
        if is_stable(gains, delay) or rng.integers(20) == 0:
            break
    units = np.array([1.0, grid.step])
    off, first = size * rng.uniform(0.0, 0.03, (2, 2)) * rng.integers(0, 2, (2, 2)) / units
    since = grid.start - int(rng.integers(0, 4)) * grid.step
    return rho.Disturbance(
        size / grid.step**2 * 10 ** rng.uniform(-3.0, -1.0) * omega,
        float(off[0]),
        float(off[1]),
        sample,
        delay,
        tracking=_tracking(since, (gains[0] / sample**2, gains[1] / sample), first),
    )


def _tracking(since: float, gains: tuple[float, float], first: FloatArray) -> Tracking:
    return Tracking(since, gains, float(first[0]), float(first[1]))


def _flight(rng: np.random.Generator, plan: rho.Plan, size: float) -> rho.Flight:
    """Return the plan flown in windows, some of which begin with a tube of their own."""
    count = plan.scenario.grid.knots - 1
    knots = np.unique(np.append(0, rng.integers(0, count, 3)))
    around, windows = plan.scenario.disturbance, []
    assert around is not None
    assert around.tracking is not None
    tracking = around.tracking
    for knot in knots.tolist():
        grid = plan.scenario.grid.from_knot(knot)
        if rng.integers(2):
            errors = size * rng.uniform(0.0, 0.05, 2) / [1.0, grid.step]
            tracking = _tracking(grid.start, tracking.gains, errors)
        p, v = plan.positions[:, knot:], plan.velocities[:, knot:]
        before = np.zeros_like(p[:, 0])
        scenario = from_states(plan.scenario, grid, p[:, 0], v[:, 0], before, tracking)
        here = rho.Plan(scenario, p, v, plan.accelerations[:, knot:])
        windows.append(rho.Window(knot, here, here))
    return rho.Flight(plan, tuple(windows))


def excesses(
    flown: rho.Plan | rho.Flight, check: rho.Check, *, at: float | None = None
) -> Iterator[FloatArray]:
    """Return the excess of points of the tube over a constraint, at samples or at one time.

    Errors of accelerations are constant in samples; there one time is the step that it begins.
    """
    plan = flown.plan if isinstance(flown, rho.Flight) else flown
    grid, near = plan.scenario.grid, 1e-9 * plan.scenario.grid.step
    constant = "acceleration" in check.constraint or check.constraint[8:] in ("thrust", "tilt")
    for stretch in stretches(flown):
        times = stretch.times(grid)
        if at is not None and constant:
            times = times[(times >= at - near) & (times < at + grid.step - near)]
        elif at is not None:
            times = (
                np.array([at]) if stretch.begin - near <= at <= stretch.end + near else times[:0]
            )
        if check.part.endswith("at knots"):
            knots = grid.start + grid.step * np.rint((times - grid.start) / grid.step)
            times = times[np.abs(times - knots) < near]
        if constant:
            times = times[times < stretch.end - near]
        if len(times) > 0:
            yield _excess(plan, check, stretch.tube, times)


def _excess(plan: rho.Plan, check: rho.Check, tube: rho.ErrorTube, times: FloatArray) -> FloatArray:
    """Return the excess of the worst points of the tube over one constraint at times."""
    scenario, i = plan.scenario, plan.scenario.index_of(check.vehicle)
    grid, limits, name = scenario.grid, scenario.limits, check.constraint
    p = by_hand(plan, i, times)
    k = np.clip(np.floor((times - grid.start) / grid.step + 1e-9).astype(int), 0, grid.knots - 2)
    a = plan.accelerations[i, k]
    s = (times - grid.start - grid.step * k)[:, None]
    v = plan.velocities[i, k] + s * a
    thrust = a + np.array([0.0, 0.0, GRAVITY])
    off, fast, push = tube.position(times), tube.velocity(times), tube.acceleration(times)
    if name.endswith("box"):
        quantity = name.split()[0]
        values = {"position": (p, off), "velocity": (v, fast), "acceleration": (a, push)}
        value, error = values[quantity]
        bounds, axis = getattr(limits, quantity), "xyz".index(check.part[0])
        if "lower" in check.part:
            return np.asarray(bounds.lower[axis] - value[:, axis] + error)
        return np.asarray(value[:, axis] + error - bounds.upper[axis])
    if name == "maximum tilt":
        level, up = np.hypot(thrust[:, 0], thrust[:, 1]), thrust[:, 2]
        sine, cosine = np.sin(limits.max_tilt or 0.0), np.cos(limits.max_tilt or 0.0)
        along = np.maximum(level * sine + up * cosine, 0.0)
        to_surface = np.hypot(level - along * sine, up - along * cosine)
        outside = np.arctan2(level, up) > (limits.max_tilt or 0.0)
        return np.asarray(push - np.where(outside, -to_surface, to_surface))
    if name.startswith("maximum"):
        vector, error, most = {
            "maximum speed": (v, fast, limits.max_speed),
            "maximum acceleration": (a, push, limits.max_acceleration),
            "maximum thrust": (thrust, push, limits.max_thrust),
        }[name]
        return np.asarray(np.linalg.norm(vector, axis=1) + error - most)
    if name.startswith("waypoint"):
        (waypoint,) = scenario.vehicles[i].waypoints
        at = np.array([waypoint.time])
        if not times[0] <= waypoint.time <= times[-1]:
            return np.array([-np.inf])
        away = by_hand(plan, i, at) - waypoint.position
        return np.asarray(np.linalg.norm(away, axis=1) + tube.position(at) - waypoint.within)
    if name.startswith("obstacle"):
        (obstacle,) = scenario.bodies
        late = obstacle.known_from > max(grid.start, 0.0)
        checked = np.ones(len(times), dtype=bool)
        if late:
            checked = (times >= obstacle.known_from) != ("before" in name)
            checked |= np.abs(times - obstacle.known_from) < 1e-9 * grid.step * (len(times) == 1)
        x = p - places(obstacle, times)
        kept = scenario.vehicles[i].radius + obstacle.deviation
        return np.asarray((kept + off - obstacle.shape.local_distance(x))[checked])
    assert scenario.separation is not None
    shape, worst = scenario.separation.shape, np.full(len(times), -np.inf)
    for j in range(len(scenario.vehicles)):
        if j != i:
            x = p - by_hand(plan, j, times)
            worst = np.maximum(worst, 2.0 * off - shape.local_distance(x))
    return worst


def checked(flown: rho.Plan | rho.Flight) -> list[rho.Check]:
    """Return the checks in which errors count."""
    reported = ("dynamics", "goal", "jerk box")
    return [each for each in rho.verify(flown).checks if each.constraint not in reported]


@pytest.mark.parametrize("kind", ["sphere", *slow(*list(KINDS)[1:])])
@examples(few=4, many=8)
@given(seed=seeds)
def test_the_reported_excess_is_the_worst_of_the_tube_and_attained(kind: str, seed: int) -> None:
    flown = disturbed_case(seed, kind)
    plan = flown.plan if isinstance(flown, rho.Flight) else flown
    places_ = float(np.abs(plan.positions).max())
    (obstacle,) = plan.scenario.bodies
    apart = plan.scenario.separation
    assert apart is not None
    moved = float(np.abs(places(obstacle, plan.times)).max())
    for check in checked(flown):
        large = {"m": places_ + moved, "m/s": np.abs(plan.velocities).max()}
        scale = large.get(check.unit, GRAVITY + np.abs(plan.accelerations).max())
        rounding = 1e-9 * (scale + check.errors + abs(check.value))
        sampled = [float(each.max()) for each in excesses(flown, check) if each.size > 0]
        if check.constraint == "separation" and max(sampled) < -3.0 * apart.distance:
            continue  # far from all others, the closest is not determined
        assert check.excess >= max(sampled) - 0.01 * check.tolerance - rounding, check
        at = [float(each.max()) for each in excesses(flown, check, at=check.time) if each.size > 0]
        assert check.excess == pytest.approx(max(at), abs=rounding), check
        limit = abs(check.value - check.limit)
        assert abs(check.excess) == pytest.approx(limit, abs=rounding)


TOUCHED = (
    "position box",
    "velocity box",
    "acceleration box",
    "maximum speed",
    "maximum acceleration",
    "maximum thrust",
    "maximum tilt",
    "waypoint 1",
    "obstacle 1",
    "separation",
)
"""Constraints that can be tightened until nothing is left."""


def tightened(scenario: rho.Scenario, check: rho.Check, by: float) -> rho.Scenario:
    """Return the scenario with one constraint tightened by an amount in its unit."""
    limits, name = scenario.limits, check.constraint
    (first, *others), changes = scenario.vehicles, dict[str, Any]()
    if name.endswith("box"):
        quantity = name.split()[0]
        old = getattr(limits, quantity)
        changes[quantity] = rho.Box(old.lower + by, old.upper - by)
    elif name == "maximum tilt":  # the closest thrust to the cone is as far from its apex
        thrust = check.value / np.sin((limits.max_tilt or 0.0) - _tilt(scenario, check))
        angle = np.arcsin(min((check.value - by) / thrust, 1.0))
        changes["max_tilt"] = _tilt(scenario, check) + float(angle)
    elif name.startswith("maximum"):
        field = name.replace("imum ", "_")
        changes[field] = getattr(limits, field) - by
    elif name.startswith("waypoint"):
        (waypoint,) = first.waypoints
        waypoint = unchecked(waypoint, within=waypoint.within - by)
        first = unchecked(first, waypoints=(waypoint,))
    elif name.startswith("obstacle"):
        first = unchecked(first, radius=first.radius + by)
    else:
        assert scenario.separation is not None
        apart = rho.Separation(scenario.separation.distance + by)
        scenario = unchecked(scenario, separation=apart)
    limits = dataclasses.replace(limits, **changes)
    changed = unchecked(scenario, vehicles=(first, *others), limits=limits)
    return changed.of_vehicles(range(len(scenario.vehicles)))


def _tilt(scenario: rho.Scenario, check: rho.Check) -> float:
    k = round((check.time - scenario.grid.start) / scenario.grid.step)
    x, y, z = FLOWN[k] + np.array([0.0, 0.0, GRAVITY])
    return float(np.arctan2(np.hypot(x, y), z))


FLOWN = 1.5 * np.random.default_rng(8).normal(size=(8, 3))
"""Accelerations of the first of two vehicles [m/s²]."""


@pytest.mark.parametrize("name", TOUCHED)
def test_a_hundredth_of_the_radius_beyond_the_limit_is_a_violation(name: str) -> None:
    scenario = unchecked(
        single(
            grid=rho.Grid(0.5, 9),
            limits=rho.Limits(
                box(40),
                box(30),
                box(20),
                None,
                40.0,
                20.0,
                30.0,
                1.4,  # all of them wide
            ),
            obstacles=(rho.Ellipsoid([3.0, -9.0, 1.0], [1.0, 2.0, 0.5]),),
            waypoints=(rho.Waypoint(2.3, [1.0, 1.0, 0.0], 9.0),),
            between_knots=True,
        ),
        separation=rho.Separation(0.5),
        disturbance=rho.Disturbance(
            0.4, 0.01, 0.02, 0.1, 1, tracking=Tracking(0.0, (7.0, 4.0), 0.05, 0.03)
        ),
    )
    (first,) = scenario.vehicles
    second = rho.Vehicle("v1", rho.State([0.0, 4.0, 0.0]), rho.State([9.0, 9.0, 9.0]))
    scenario = unchecked(scenario, vehicles=(first, second)).of_vehicles([0, 1])
    a = np.stack([FLOWN, np.zeros((8, 3))])

    def check(asked: rho.Scenario) -> rho.Check:
        report = rho.verify(rho.Plan.from_accelerations(asked, a))
        own = [each for each in report.checks if each.vehicle == "solo"]
        return [each for each in own if each.constraint == name][-1]  # at all times

    wide = check(scenario)
    assert wide.errors > 1e3 * wide.tolerance
    touching = tightened(scenario, wide, -wide.excess)
    there = check(touching)
    assert there.holds
    assert there.excess == pytest.approx(0.0, abs=0.1 * there.tolerance)
    cut = check(tightened(touching, there, 0.01 * there.errors + there.tolerance))
    assert not cut.holds


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_plans_hold_anywhere_in_the_tube(kind: str) -> None:
    """The verifier agrees, and so do points of the tube, for which the original limits hold."""
    rng, planned = np.random.default_rng(17), 0
    for seed in range(4):
        try:
            scenario = _asked(np.random.default_rng(seed), kind)
            plan = rho.plan_rho(scenario, replan_every=3) if seed % 2 else rho.plan(scenario)
        except (rho.InfeasibleError, rho.ScenarioError):  # a start may be in the shape
            continue
        planned += 1
        assert rho.verify(plan).ok
        for stretch in stretches(plan):
            _check_points(plan if isinstance(plan, rho.Plan) else plan.plan, stretch, rng)
    assert planned >= 2


def _asked(rng: np.random.Generator, kind: str) -> rho.Scenario:
    """Return two vehicles past an obstacle of a kind, which moves in some draws."""
    shape = random_shape(rng, kind, np.array([5.0, 0.7, 0.3]), 1.2)
    moving = rho.Obstacle(shape, velocity=rng.uniform(-0.3, 0.3, 3)) if rng.integers(2) else shape
    scenario = single(
        limits=rho.Limits(
            box(20), box(4.0), box(4.0), max_speed=3.5, max_acceleration=4.5, max_tilt=0.6
        ),
        obstacles=(moving,),
        goal=rho.State([10.0, 1.0, 0.0]),
        between_knots=True,
    )
    (first,) = scenario.vehicles
    second = rho.Vehicle("v1", rho.State([10.0, -2.0, 0.0]), rho.State([0.0, 3.0, 1.0]))
    around = rho.Disturbance(
        rng.uniform(0.05, 0.4), 0.01, 0.02, 0.5 / int(rng.integers(2, 7)), int(rng.integers(2))
    )
    return dataclasses.replace(
        scenario,
        vehicles=(first, second),
        separation=rho.Separation(0.6, float(rng.choice([1.0, 2.0]))),
        disturbance=around,
    )


def _check_points(plan: rho.Plan, stretch: Stretch, rng: np.random.Generator) -> None:
    """Check that random points of the balls satisfy the limits, each at its time."""
    scenario, tube = plan.scenario, stretch.tube
    limits, slack = scenario.limits, 2e-5
    times = rng.uniform(stretch.begin, stretch.end, 400)
    n = rng.normal(size=(5, 2, 400, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    motion, elapsed = plan.motion(), times - scenario.grid.start
    p = motion.at("position", elapsed) + tube.position(times)[:, None] * n[0]
    v = motion.at("velocity", elapsed) + tube.velocity(times)[:, None] * n[1]
    a = motion.at("acceleration", elapsed) + tube.acceleration(times)[:, None] * n[2]
    for values, bounds in ((p, limits.position), (v, limits.velocity), (a, limits.acceleration)):
        assert bounds is not None
        assert np.all((values <= bounds.upper + slack) & (values >= bounds.lower - slack))
    assert np.linalg.norm(v, axis=-1).max() <= (limits.max_speed or 0.0) + slack
    assert np.linalg.norm(a, axis=-1).max() <= (limits.max_acceleration or 0.0) + slack
    tilts = np.arctan2(np.linalg.norm(a[..., :2], axis=-1), a[..., 2] + GRAVITY)
    assert tilts.max() <= (limits.max_tilt or 0.0) + slack
    (obstacle,) = scenario.bodies
    assert obstacle.distances(p, times).min() >= -slack
    assert scenario.separation is not None
    apart = np.linalg.norm(scenario.separation.scaled(p[0] - p[1]), axis=-1)
    assert apart.min() >= scenario.separation.distance - slack
