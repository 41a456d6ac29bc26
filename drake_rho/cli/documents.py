"""Documents that the commands print with `--json`; the names of the fields are the keys.

A name ends in its unit unless a field `unit` stands beside it: `_s` for seconds, `_m` for metres,
`_mps2` for metres per second squared. Costs are in m²/s⁴, `seconds` is wall time. Values that are
unknown or not finite are null.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, TypeVar, dataclass_transform

from pydantic import TypeAdapter

T = TypeVar("T")


@dataclass_transform(kw_only_default=True, frozen_default=True)
def record(cls: type[T]) -> type[T]:
    """Make the class a frozen dataclass: a document, or a part of one."""
    return dataclasses.dataclass(frozen=True, kw_only=True)(cls)


@record
class Document:
    """Base of all documents."""

    status: int = 0
    """exit status of the command"""

    def to_json(self) -> str:
        """Return the document as JSON text; numbers that are not finite become null."""
        return TypeAdapter(type(self)).dump_json(self, indent=2).decode()


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


@record
class DiagnosisPart:
    """Part of a document: why a scenario has no plan, and which changes make it feasible."""

    scenario: str
    """name of the scenario"""
    feasible: bool
    """true if a plan was found"""
    conflicts: dict[str, list[str]]
    """for each vehicle without a plan, constraints that cannot be met together"""
    premise: str
    """premise of this proof beside the scenario: margins or linearised obstacles; or empty"""
    violations: list[CheckRow]
    """violations of the motion with the least total violation, the worst first"""
    shortest_duration_s: float | None
    """least duration for which a plan was found, all else unchanged"""
    longest_duration_s: float | None
    """largest duration for which a plan was found, if only shorter durations have one"""
    is_monotone: bool
    """true if no shorter duration has a plan; false if some may have been missed"""
    acceleration_factor: float | None
    """least factor on the acceleration limits for which a plan was found"""
    bearable_wind_mps2: float | None
    """largest wind for which a plan was found, if the disturbance is why there is no plan"""
    cut: bool
    """true if time ended before everything was tried; smaller changes may be enough then"""


@record
class Failed(Document):
    """Document of any command that fails."""

    error: str
    """error message, one line"""
    diagnosis: DiagnosisPart | None = None
    """with status 3, why there is no plan and which changes help, as far as that was found"""


@record
class Diagnosed(Document):
    """Document of diagnose."""

    diagnosis: DiagnosisPart
    """why there is no plan and which changes help"""


@record
class CertifiedRow:
    """Certificate of one vehicle, or of a group of vehicles coupled by separations."""

    vehicle: str
    """name of the vehicle; for a group, of its first one and the number of others"""
    cost: float
    """cost of the vehicle or group"""
    lower_bound: float
    """lower bound of the cost of every plan of the vehicle or group"""
    gap: float
    """relative gap, (cost - lower bound) / cost"""
    least_eigenvalue: float
    """least eigenvalue of the Lagrangian's Hessian; if > 0, the bound is tight at convergence"""


@record
class Certified(Document):
    """Document of certify."""

    scenario: str
    """name of the scenario"""
    cost: float
    """cost of the plan"""
    lower_bound: float
    """lower bound of the cost of every plan"""
    gap: float
    """relative gap, (cost - lower bound) / cost; negative if violations make the plan cheaper"""
    planned_gap: float
    """relative gap to the bound for plans that keep the planners' margins for a disturbance"""
    is_globally_optimal: bool
    """true if the plan holds and its gap is at most a millionth"""
    holds: bool
    """true if the plan meets its constraints"""
    left_out: list[str]
    """obstacles that constrain the plan and that the bound does not count"""
    cut: bool
    """true if time ended before the bound was as good as it can be made"""
    vehicles: list[CertifiedRow]
    """certificate of each vehicle, or of each group of vehicles coupled by separations"""


@record
class AssignedRow:
    """Goal assigned to a vehicle."""

    vehicle: str
    """name of the vehicle"""
    goal_of: str
    """name of the vehicle that had this goal before"""
    goal_m: list[float]
    """position of the goal: x, y and z"""


@record
class Assigned(Document):
    """Document of assign."""

    scenario: str
    """name of the scenario"""
    effort: float
    """least cost with the goals exchanged, without other constraints"""
    effort_before: float
    """least cost with the original goals, without other constraints"""
    vehicles: list[AssignedRow]
    """goal of each vehicle"""
    file: str | None
    """path of the saved scenario; null if it was not saved"""


@record
class Ran(Document):
    """Document of campaign."""

    store: str
    """path of the store"""
    runs: int
    """number of runs in the store"""
    failed: int
    """number of runs without a plan that holds"""
    seconds: float
    """wall time of this call"""


@record
class Summary(Document):
    """Document of results; docs/campaigns.md describes its lists, from `rho.Results.to_json`."""

    study: str
    """name of the study"""
    runs: int
    """number of runs in the store"""
    groups: list[dict[str, Any]]
    """success, costs and times of each method on each source of scenarios"""
    failures: list[dict[str, Any]]
    """runs without a plan that holds, by method and status"""
    comparisons: list[dict[str, Any]]
    """pairs of methods, compared on the runs that both have done"""
    export: str | None
    """path of the file with all rows; null if none was written"""
    figures: list[str]
    """paths of the figures"""


@record
class ExampleRow:
    """One of the paper's four examples."""

    number: int
    """number of the example, 1 to 4"""
    method: str
    """method: convex or RHO"""
    obstacle: str
    """treatment of the obstacle: ignored or avoided"""
    ok: bool
    """true if all required constraints hold"""
    cost: float
    """performance index f"""
    lower_bound: float
    """lower bound of the cost of every plan of the example"""
    seconds: float
    """median wall time of planning"""
    programs: int
    """number of quadratic programs solved"""
    clearance_m: float
    """least distance from the obstacle's surface at any instant; negative inside"""


@record
class ClaimRow:
    """Claim of the paper, checked against the reproduced examples."""

    number: int
    """number of the claim in docs/paper.md"""
    claim: str
    """text of the claim"""
    evidence: str
    """numbers that decide whether the claim is found"""
    found: bool
    """true if the reproduced examples confirm the claim"""


@record
class Reproduced(Document):
    """Document of reproduce."""

    examples: list[ExampleRow]
    """Examples 1 to 4"""
    claims: list[ClaimRow]
    """the six claims of the paper"""
    figures: list[str]
    """paths of the figures"""


@record
class Shown(Document):
    """Document of show."""

    page: str | None = None
    """path of the page; null if none was written"""
    film: str | None = None
    """path of the film; null if none was written"""
    url: str | None = None
    """address at which the page is served until the command is interrupted"""


@record
class Content(Document):
    """Document of campaign --example."""

    content: str
    """text of an example study"""


@record
class Exported(Document):
    """Document of export."""

    path: str
    """requested file or folder"""
    files: list[str]
    """paths of all files that were written"""
    content: str
    """description of the content of the files"""
    deviations_m: dict[str, float]
    """for each vehicle, bound of the distance between the exported and the planned motion"""
    keeps_clear: bool | None
    """true if vehicles keep clear within these deviations; null if the export is exact"""


@record
class Listed(Document):
    """Document of drake-rho without a command, and of --version."""

    version: str
    """version of drake_rho"""
    commands: dict[str, str]
    """names of the commands, with a description of each"""
