"""JSON documents of motions: scenario, units, and the states of every vehicle."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from typing import IO, Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from drake_rho.motion.flown import Flown, sample
from drake_rho.motion.plan import Plan
from drake_rho.motion.samples import with_knots
from drake_rho.motion.statistics import Statistics
from drake_rho.scenario.fields import LARGEST
from drake_rho.scenario.files import scenario_from_json, scenario_to_json

_PLAN, _TRUE = "drake_rho plan 1", "drake_rho true motion 1"
UNITS = {"times": "s", "positions": "m", "velocities": "m/s", "accelerations": "m/s^2"}

_Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
_Vectors = list[tuple[_Number, _Number, _Number]]
_CHECKED = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_CHECKED)
class _Vehicle:
    name: str
    positions: _Vectors
    velocities: _Vectors
    accelerations: _Vectors


@dataclass(frozen=True, config=_CHECKED)
class _Document:
    format: Literal["drake_rho plan 1", "drake_rho true motion 1"]
    units: dict[str, str]
    scenario: dict[str, Any]
    statistics: Statistics
    times: list[_Number]
    knots: list[Annotated[int, Field(ge=0)]]
    vehicles: list[_Vehicle]
    jumps: list[Annotated[int, Field(ge=0)]] = dataclasses.field(default_factory=list)
    under_way: bool = False


_DOCUMENT = TypeAdapter(_Document)


_FORMAT = re.compile(r'"format"\s*:\s*"drake_rho ')
"""Name of the format, which begins alike for plans and for true motions."""


def write_document(file: IO[bytes], flown: Flown, rate: float | None = None) -> None:
    """Write the states at every knot and, if a rate is given [1/s], at that rate as well.

    With a smoothing, these are the states of the plan before averaging.
    """
    times, knots = with_knots(flown.scenario.grid, rate)
    samples = sample(flown.plan.stepwise() if flown.scenario.smoothing else flown, times)
    content = {
        "format": _PLAN if flown.simulation is None else _TRUE,
        "units": UNITS,
        "scenario": json.loads(scenario_to_json(flown.scenario)),
        "statistics": TypeAdapter(Statistics).dump_python(flown.statistics, mode="json"),
        "times": samples.times.tolist(),
        "knots": knots.tolist(),
        "vehicles": [
            {
                "name": name,
                "positions": states[:, :3].tolist(),
                "velocities": states[:, 3:6].tolist(),
                "accelerations": states[:, 6:].tolist(),
            }
            for name, states in samples.by_vehicle()
        ],
    }
    if flown.simulation is None and flown.plan.jumps:
        content["jumps"] = flown.plan.jumps
    if flown.scenario.under_way:
        content["under_way"] = True
    text = io.TextIOWrapper(file, "utf-8", newline="\n")
    json.dump(content, text, ensure_ascii=False, allow_nan=False)
    text.write("\n")
    text.detach()  # flushes the buffer and leaves the file open


def is_document(text: str) -> bool:
    """Return whether text begins like a JSON object, and so may be a document."""
    return text.lstrip().startswith("{")


def is_exported(text: str) -> bool:
    """Return whether text is a document with the format's name, not just any JSON object."""
    return is_document(text) and _FORMAT.search(text) is not None


def read_document(text: str) -> Plan:
    """Return the plan of a document, with exact numbers; for a flight, its flown plan.

    Raises:
        ValueError: the document is damaged, or contains the true motion of a simulation, which is
            not a plan.
    """
    try:
        document = _DOCUMENT.validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        raise ValueError(f"{'.'.join(map(str, first['loc'])) or 'JSON'}: {first['msg']}") from None
    if document.format != _PLAN:
        expected = "expected a plan: simulations can be saved as .npz"
        raise ValueError(f"the true motion of a simulation, {expected}")
    scenario = scenario_from_json(json.dumps(document.scenario), under_way=document.under_way)
    names = [vehicle.name for vehicle in scenario.vehicles]
    if [vehicle.name for vehicle in document.vehicles] != names or document.units != UNITS:
        raise ValueError("vehicles differ from those of the scenario, or units from drake_rho's")
    knots = np.array(document.knots)
    if not np.array_equal(np.array(document.times)[knots], scenario.grid.times):
        raise ValueError("knots differ from those of the scenario")
    p, v, a = (
        np.array([getattr(vehicle, part) for vehicle in document.vehicles])[:, knots]
        for part in ("positions", "velocities", "accelerations")
    )
    jumps = tuple(document.jumps)
    return Plan(scenario, p, v, a[:, :-1], document.statistics, jumps=jumps)
