"""What commands print with `--json`: one of these documents; the fields' names are its keys.

Names end in a unit where the unit is not that of the field `unit` beside them: `_s` seconds, `_m`
metres, `_mps2` metres a second squared. Costs are in m²/s⁴, `seconds` is wall time. What is not
known, or is no finite number, is null.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal, TypeVar, dataclass_transform

from pydantic import TypeAdapter

T = TypeVar("T")


@dataclass_transform(kw_only_default=True, frozen_default=True)
def record(cls: type[T]) -> type[T]:
    """A document, or a part of one."""
    return dataclasses.dataclass(frozen=True, kw_only=True)(cls)


@record
class Document:
    """What all of them have."""

    status: int = 0
    """exit status of the command"""

    def to_json(self) -> str:
        """The document as text; numbers that are not finite are null."""
        return TypeAdapter(type(self)).dump_json(self, indent=2).decode()


@record
class CheckRow:
    """How one vehicle keeps one constraint, at the instant where it does so worst."""

    vehicle: str
    """name"""
    constraint: str
    """name, and which part of it"""
    time_s: float | None
    """when, on the scenario's clock"""
    value: float | None
    """what is flown, in `unit`"""
    limit: float | None
    """what is allowed, in `unit`, less what errors take"""
    excess: float | None
    """by how much the value is beyond the limit, in `unit`; negative on the right side of it"""
    errors: float | None
    """how much of the limit errors take, in `unit`"""
    unit: str
    """SI unit of these numbers"""
    holds: bool
    """whether the constraint is met, but for rounding"""
    asked: bool
    """whether the scenario asks for it; what it does not ask for is not judged"""


@record
class WindowRow:
    """A window of a receding horizon that had no plan of its own."""

    first_knot: int
    """where it begins, counted from 1"""
    kept: bool
    """whether the rest of the previous plan was flown on; else what breaks least was"""
    reason: str
    """why it had none"""


@record
class SightingRow:
    """An obstacle that became known under way."""

    obstacle: str
    """what it is called"""
    time_s: float
    """when, on the scenario's clock"""
    avoided: bool
    """whether it was"""
    planned_for: bool
    """whether a window began after it became known"""


@record
class ErrorRow:
    """How far a vehicle was off its plan in a simulation, and how close to anything."""

    vehicle: str
    """name"""
    error_m: float
    """greatest error of its position"""
    of_radius: float | None
    """the greatest part of its tube's radius that an error was; null without a tube"""
    to_obstacles_m: float | None
    """least distance from an obstacle, less its radius; null where none was known"""
    to_others_m: float | None
    """least distance from another vehicle, less the separation; null without one"""


@record
class Judged(Document):
    """Of plan, fly, simulate and verify: what was planned or flown, and whether it holds."""

    kind: Literal["plan", "flight", "simulation"]
    """what was judged"""
    scenario: str
    """name"""
    vehicles: int
    """how many"""
    knots: int
    """how many"""
    step_s: float
    """from one knot to the next"""
    ok: bool
    """whether every constraint holds"""
    cost: float
    """performance index of what was planned, the sum of squared accelerations"""
    seconds: float
    """that planning took"""
    programs: int
    """quadratic programs solved"""
    linearisations: int
    """references around which obstacles and pairs were linearised"""
    converged: bool
    """whether each iteration stopped because the cost had settled"""
    cut: bool
    """whether time was up before that, by --time-limit or by Ctrl-C"""
    last_fall: float | None
    """by what part of itself the cost fell in the last linearisation; null where nothing was
    iterated"""
    solver: str
    """of the last program; empty if none was needed"""
    clearance_m: float | None
    """least distance from the surface of an obstacle; null without obstacles"""
    separation_m: float | None
    """least distance between two vehicles, as the separation measures it; null without one"""
    windows: int | None
    """of the receding horizon; null for a plan"""
    windows_without_plan: list[WindowRow]
    """those without a plan of their own"""
    sightings: list[SightingRow]
    """obstacles that became known under way"""
    errors: list[ErrorRow]
    """of a simulation, how far each vehicle was off its plan"""
    wind: str | None
    """what was flown in, in words; null where that is not known"""
    notes: list[str]
    """what else is to be known of the judgement"""
    violations: list[CheckRow]
    """what does not hold, the worst first"""
    tightest: list[CheckRow]
    """of each constraint the vehicle that is closest to breaking it, or breaks it most"""
    file: str | None
    """where it was kept"""
    figures: list[str]
    """paths of the figures that were drawn"""


@record
class Why:
    """Why a scenario has no plan, and what would mend it."""

    scenario: str
    """name"""
    feasible: bool
    """whether there is a plan after all"""
    conflicts: dict[str, list[str]]
    """for each vehicle without a plan, constraints that cannot be met together"""
    premise: str
    """what that is proved for, if not for the scenario itself: margins, or linearised obstacles"""
    violations: list[CheckRow]
    """what the motion breaks that breaks the constraints least in total, the worst first"""
    shortest_duration_s: float | None
    """least duration for which a plan was found, all else unchanged"""
    longest_duration_s: float | None
    """where a plan was found for a shorter duration only, the greatest such duration"""
    is_monotone: bool
    """whether none shorter has a plan; else some may have been passed over"""
    acceleration_factor: float | None
    """least factor on the limits of acceleration for which a plan was found"""
    bearable_wind_mps2: float | None
    """where the disturbance is why there is none, the largest wind for which a plan was found"""
    cut: bool
    """whether time was up before everything was tried: less may be enough"""


@record
class Failed(Document):
    """Of any command that could not do what it was asked."""

    error: str
    """what went wrong, in a line"""
    diagnosis: Why | None = None
    """with status 3, why there is no plan and what would mend it, as far as that was found"""


@record
class Diagnosed(Document):
    """Of diagnose."""

    diagnosis: Why
    """what was found"""


@record
class CertifiedRow:
    """What is known of the part of a plan that one vehicle has, or several that pairs couple."""

    vehicle: str
    """name; of several, that of the first and how many more"""
    cost: float
    """its part of the cost"""
    lower_bound: float
    """no plan of it can cost less"""
    gap: float
    """(cost - lower bound) / cost"""
    least_eigenvalue: float
    """of the Lagrangian's Hessian; above 0, the bound meets the converged plan's cost"""


@record
class Certified(Document):
    """Of certify."""

    scenario: str
    """name"""
    cost: float
    """of the plan"""
    lower_bound: float
    """no plan can cost less"""
    gap: float
    """(cost - lower bound) / cost; negative for a plan that breaks its constraints to save"""
    planned_gap: float
    """the same with the bound of plans that keep planners' margins for a disturbance"""
    is_globally_optimal: bool
    """whether the plan holds and its gap is no more than a millionth"""
    holds: bool
    """whether the plan meets its constraints"""
    left_out: list[str]
    """obstacles that the plan leans on and the bound does not count"""
    cut: bool
    """whether time was up before the bound was as good as it can be made"""
    vehicles: list[CertifiedRow]
    """for each vehicle or, where pairs couple them, for all"""


@record
class AssignedRow:
    """Where a vehicle goes."""

    vehicle: str
    """name"""
    goal_of: str
    """name of the vehicle whose goal it was"""
    goal_m: list[float]
    """position, x, y and z"""


@record
class Assigned(Document):
    """Of assign."""

    scenario: str
    """name"""
    effort: float
    """least cost with the goals exchanged, with no other constraint"""
    effort_before: float
    """the same with the goals as they were"""
    vehicles: list[AssignedRow]
    """where each goes"""
    file: str | None
    """where the scenario was kept"""


@record
class Ran(Document):
    """Of campaign."""

    store: str
    """file of the runs"""
    runs: int
    """runs in it"""
    failed: int
    """runs among them without a plan that holds"""
    seconds: float
    """that this call took"""


@record
class Summary(Document):
    """Of results; the lists are those of `rho.Results.to_json`, docs/campaigns.md."""

    study: str
    """name"""
    runs: int
    """in the store"""
    groups: list[dict[str, Any]]
    """each method on each source of scenarios: success, costs, times"""
    failures: list[dict[str, Any]]
    """runs without a plan that holds, by method and status"""
    comparisons: list[dict[str, Any]]
    """methods compared on the runs that both have done"""
    export: str | None
    """file to which all rows were written"""
    figures: list[str]
    """paths of the figures that were drawn"""


@record
class ExampleRow:
    """One of the paper's four examples."""

    number: int
    """1 to 4"""
    method: str
    """convex or RHO"""
    obstacle: str
    """ignored or avoided"""
    ok: bool
    """whether all constraints hold"""
    cost: float
    """performance index"""
    lower_bound: float
    """no plan of the example can cost less"""
    seconds: float
    """median time of planning"""
    programs: int
    """quadratic programs solved"""
    clearance_m: float
    """least distance from the obstacle's surface at any instant, negative inside"""


@record
class ClaimRow:
    """Something the paper says it found."""

    number: int
    """as in docs/paper.md"""
    claim: str
    """what it says"""
    evidence: str
    """the numbers that decide"""
    found: bool
    """whether it is so here"""


@record
class Reproduced(Document):
    """Of reproduce."""

    examples: list[ExampleRow]
    """Examples 1 to 4"""
    claims: list[ClaimRow]
    """the paper's six"""
    figures: list[str]
    """paths of the figures that were drawn"""


@record
class Shown(Document):
    """Of show."""

    page: str | None = None
    """file that was written"""
    film: str | None = None
    """film that was written"""
    url: str | None = None
    """where the page is served until the command is interrupted"""


@record
class Content(Document):
    """Of campaign --example."""

    content: str
    """a file of the kind that was asked for"""


@record
class Exported(Document):
    """Of export."""

    path: str
    """file or folder that was asked for"""
    files: list[str]
    """all that was written"""
    content: str
    """what is in them, in words"""
    deviations_m: dict[str, float]
    """by vehicle, how far what is written may be from the motion at most"""
    keeps_clear: bool | None
    """whether vehicles keep clear with these deviations; null where there are none"""


@record
class Listed(Document):
    """Of drake-rho alone, and of --version."""

    version: str
    """of drake_rho"""
    commands: dict[str, str]
    """what there is to type, and what it does"""
