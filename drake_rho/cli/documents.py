"""JSON documents that the commands print with `--json`, made from records.

Keys end in their unit unless a key `unit` stands beside them: `_s` for seconds, `_m` for metres,
`_mps2` for metres per second squared. Costs are in m²/s⁴, `seconds` is wall time. Values that are
unknown or not finite are null. docs/command_line.md describes every key.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from operator import attrgetter

from pydantic_core import to_json

from drake_rho.analysis.certificate import Certificate, VehicleCertificate
from drake_rho.analysis.changes import Change, NewNumbers
from drake_rho.analysis.diagnosis import Diagnosis
from drake_rho.analysis.sensitivity import LimitEffect, TimeSensitivity
from drake_rho.analysis.time_certificate import TimeCertificate, VehicleTimeBound
from drake_rho.motion.deviations import Deviation
from drake_rho.motion.flight import Sighting, Window
from drake_rho.motion.statistics import Statistics
from drake_rho.paper.study import Claim, Example
from drake_rho.scenario.records import Scenario
from drake_rho.shows.certificate import ShowCertificate, TransitionCertificate
from drake_rho.verification.check import Check
from drake_rho.verification.summary import Summary

_KEYS: dict[type, str] = {
    Certificate: "scenario cost lower_bound gap planned_gap is_globally_optimal holds left_out cut "
    "nodes better vehicles",
    Change: "numbers",
    Check: "vehicle constraint=what time_s=time value limit excess errors unit holds asked "
    "penalty? price? deciding_rate_hz=deciding_rate?",
    Claim: "number claim=text evidence found",
    Deviation: "vehicle time_s=time position_m=position velocity_mps=velocity",
    Diagnosis: "scenario feasible conflicts premise violations changes "
    "shortest_duration_s=shortest_duration longest_duration_s=longest_duration is_monotone "
    "acceleration_factor bearable_wind_mps2=bearable_wind cut untried",
    Example: "number method obstacle ok=report.ok cost=plan.cost "
    "lower_bound=certificate.lower_bound seconds programs=plan.statistics.programs",
    LimitEffect: "limit change less_time vehicles",
    NewNumbers: "limit unit now needed",
    Sighting: "obstacle time_s=time avoided planned_for",
    Statistics: "seconds programs linearisations converged cut last_fall solver",
    Summary: "top_speed_mps=top_speed costs least_effort minimised time_bound_s=time_bound "
    "cost_bound largest_deviation",
    TimeCertificate: "scenario duration_s=duration bound_s=bound gap is_globally_optimal holds "
    "premise left_out relaxations cut vehicles",
    TimeSensitivity: "scenario duration_s=duration limits cut",
    VehicleCertificate: "vehicle cost lower_bound gap least_eigenvalue",
    VehicleTimeBound: "vehicle bound_s=bound",
    ShowCertificate: "show squares squares_bound gap transitions",
    TransitionCertificate: "scene duration_s=duration bound_s=bound "
    "any_assignment_s=any_assignment",
    Window: "first_knot kept reason=infeasible",
}
"""Keys of records in documents, each with its attribute where that has another name. For other
records all fields are keys; a scenario is given by its name. A key with a question mark is left out
where it is None."""


def content_of(record: object) -> dict[str, object]:
    """Return the content of a record by key."""
    fields = dataclasses.fields(record)  # type: ignore[arg-type]  # a record is a dataclass
    keys = _KEYS.get(type(record)) or " ".join(field.name for field in fields)
    pairs = [each.rstrip("?").partition("=") for each in keys.split()]
    content = {key: attrgetter(name or key)(record) for key, _, name in pairs}
    optional = {each.partition("=")[0].rstrip("?") for each in keys.split() if each.endswith("?")}
    absent = [key for key, value in content.items() if value is None and key in optional]
    return {key: value for key, value in content.items() if key not in absent}


def json_of(document: object) -> str:
    """Return a document as JSON text; numbers that are not finite become null."""
    return to_json(_plain(document), indent=2, inf_nan_mode="null").decode()


def _plain(value: object) -> object:
    """Return a value with all its records replaced by mappings."""
    if isinstance(value, Scenario):
        return value.name
    if dataclasses.is_dataclass(value):
        value = content_of(value)
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
