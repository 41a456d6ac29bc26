"""Documents of plans, flights and simulations with their verification."""

from __future__ import annotations

from typing import Literal

from drake_rho.cli.document import Document, record


@record
class CheckRow:
    """Check of one constraint for one vehicle at its worst instant."""

    vehicle: str
    """name of the vehicle"""
    constraint: str
    """name of the constraint, with the axis and side if it has several parts"""
    time_s: float | None
    """time of the worst instant on the scenario's clock"""
    value: float | None
    """value of the bounded quantity, in `unit`"""
    limit: float | None
    """allowed value, in `unit`, tightened by `errors`"""
    excess: float | None
    """violation, in `unit`: how far the value is beyond the limit; negative inside the limit"""
    errors: float | None
    """part of the limit reserved for disturbance errors, in `unit`"""
    unit: str
    """SI unit of these numbers"""
    holds: bool
    """true if the constraint is met to within rounding"""
    asked: bool
    """true if the scenario requires the constraint; others do not count for `ok`"""


@record
class WindowRow:
    """Window of a receding horizon that has no plan of its own."""

    first_knot: int
    """knot at which the window begins, counted from 1"""
    kept: bool
    """true if the rest of the previous plan was flown, false if a least-violation motion was"""
    reason: str
    """reason why the window has no plan of its own"""


@record
class SightingRow:
    """Obstacle that became known during the flight."""

    obstacle: str
    """name of the obstacle"""
    time_s: float
    """time at which planning learned of it, on the scenario's clock"""
    avoided: bool
    """true if the obstacle was avoided"""
    planned_for: bool
    """true if a window began after it became known"""


@record
class ErrorRow:
    """Tracking error and least distances of one vehicle in a simulation."""

    vehicle: str
    """name of the vehicle"""
    error_m: float
    """largest position error with respect to the plan in force"""
    of_radius: float | None
    """largest ratio of the position error to the radius of the tube; null without a tube"""
    to_obstacles_m: float | None
    """least distance from an obstacle, less the vehicle's radius; null if none was known"""
    to_others_m: float | None
    """least distance from another vehicle, less the separation; null without a separation"""


@record
class Verified(Document):
    """Document of plan, fly, simulate and verify: the result and its verification."""

    kind: Literal["plan", "flight", "simulation"]
    """kind of the result"""
    scenario: str
    """name of the scenario"""
    vehicles: int
    """number of vehicles"""
    knots: int
    """number of knots"""
    step_s: float
    """time from one knot to the next"""
    ok: bool
    """true if every required constraint holds"""
    cost: float
    """performance index of the plan, the sum of squared accelerations"""
    seconds: float
    """wall time of planning"""
    programs: int
    """number of quadratic programs solved"""
    linearisations: int
    """number of references around which obstacles and pairs were linearised"""
    converged: bool
    """true if every iteration stopped because the cost had converged"""
    cut: bool
    """true if --time-limit or Ctrl-C stopped planning before it had converged"""
    last_fall: float | None
    """relative decrease of the cost in the last linearisation; null without iterations"""
    solver: str
    """solver of the last program; empty if no program was needed"""
    clearance_m: float | None
    """least distance from the surface of an obstacle; null without obstacles"""
    separation_m: float | None
    """least distance between two vehicles in the norm of the separation; null without one"""
    top_speed_mps: float | None
    """largest speed of all vehicles"""
    least_effort: float
    """least cost without limits, obstacles and separation, a lower bound on the cost of plans"""
    cost_bound: float | None
    """largest cost of a flight with bounded costs, known from its first window; null without it"""
    windows: int | None
    """number of windows of the receding horizon; null for a plan"""
    windows_without_plan: list[WindowRow]
    """windows without a plan of their own"""
    sightings: list[SightingRow]
    """obstacles that became known during the flight"""
    errors: list[ErrorRow]
    """tracking error of each vehicle; empty unless `kind` is simulation"""
    wind: str | None
    """description of the wind; null if it is not known"""
    notes: list[str]
    """remarks of the verification"""
    violations: list[CheckRow]
    """checks that fail, the worst first"""
    tightest: list[CheckRow]
    """for each constraint, the check of the vehicle that is closest to its limit or beyond"""
    file: str | None
    """path of the saved result; null if it was not saved"""
    figures: list[str]
    """paths of the figures"""
