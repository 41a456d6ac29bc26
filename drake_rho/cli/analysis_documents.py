"""Documents of diagnoses and certificates."""

from __future__ import annotations

from drake_rho.cli.document import Document, record
from drake_rho.cli.result_documents import CheckRow


@record
class NumbersRow:
    """New value of one limit; of a box, its lower and then its upper bounds."""

    limit: str
    """field of the limit, with the vehicle or the part that it belongs to"""
    unit: str
    """unit of the numbers"""
    now: list[float]
    """numbers in the scenario"""
    needed: list[float]
    """numbers with which there is a plan"""


@record
class ChangeRow:
    """Change that gives a plan."""

    numbers: list[NumbersRow]
    """limits that change together, mostly one"""


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
    """violations of the motion with the least total violation, missed goals first"""
    changes: list[ChangeRow]
    """changes with each of which a plan was found, the least of each limit"""
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
    """Document of diagnose for a scenario."""

    diagnosis: DiagnosisPart
    """why there is no plan and which changes help"""


@record
class LimitRow:
    """Effect of one limit on the final time of a plan."""

    limit: str
    """name of the limit"""
    change: str
    """change of the limit to which `less_time` refers"""
    less_time: float
    """part of the final time that such a change saves, to first order"""
    vehicles: list[str]
    """names of the vehicles for which the limit counts"""


@record
class TimeDiagnosed(Document):
    """Document of diagnose for a plan in the least time."""

    scenario: str
    """name of the scenario"""
    duration_s: float
    """final time of the plan, counted from the first knot"""
    limits: list[LimitRow]
    """limits that make the plan as long as it is, that with the largest effect first"""
    cut: bool
    """true if time ended before every limit was tried"""


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
class TimeBoundRow:
    """Lower bound of the time that one vehicle takes alone."""

    vehicle: str
    """name of the vehicle"""
    bound_s: float
    """time that it takes at least"""


@record
class TimeCertified(Document):
    """Document of certify with --time."""

    scenario: str
    """name of the scenario"""
    duration_s: float
    """final time of the plan"""
    bound_s: float
    """time that every plan takes at least"""
    gap: float
    """relative gap, (duration - bound) / duration"""
    is_globally_optimal: bool
    """true if the plan holds and its gap is at most a ten-thousandth"""
    holds: bool
    """true if the plan meets its constraints"""
    premise: str
    """for which plans the bound holds"""
    left_out: list[str]
    """what the bound does not count"""
    relaxations: int
    """number of convex programs that were solved"""
    cut: bool
    """true if the search ended before the gap was as small as wanted"""
    vehicles: list[TimeBoundRow]
    """bound of each vehicle alone"""


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
