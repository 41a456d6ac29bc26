"""Plans and flights in `.npz` files, each with its scenario inside; read without pickle."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Len
from pydantic import Field, TypeAdapter

from drake_rho.motion.plan import Flight, Plan, Statistics, Window
from drake_rho.scenario.errors import DrakeRhoError
from drake_rho.scenario.fields import LARGEST
from drake_rho.scenario.files import replacing, scenario_from_json, scenario_to_json

ENDINGS = (".npz",)
"""Of the files that hold a plan or a flight."""

_PLAN, _FLIGHT = "drake_rho plan 1", "drake_rho flight 1"
_ARRAYS = ("positions", "velocities", "accelerations")
_KINDS = ("plan", "reference")
_SIGHTED = ("learned", "not_avoided")
_STATISTICS = TypeAdapter(Statistics)
_PARTS = ("scenario", "statistics", *_ARRAYS)


class PlanFileError(DrakeRhoError, ValueError):
    """A file is not a plan or a flight, or is damaged."""


def save(planned: Plan | Flight, path: str | Path) -> None:
    """Write a plan or a flight, whole or not at all.

    Args:
        planned: what to keep.
        path: of the file, used as it is; its ending is `.npz`, or it has none.

    Raises:
        ValueError: the ending is that of another format, or a number is beyond any flight.
        OSError: the file cannot be written.
    """
    if (ending := Path(path).suffix) and ending.lower() not in ENDINGS:
        raise ValueError(
            f"{path}: got {ending}, expected the ending {' or '.join(ENDINGS)} or none"
        )
    content: dict[str, Any]
    if isinstance(planned, Flight):
        content = {"format": _FLIGHT} | _pack("plan", planned.plan)
        content["first_knots"] = [window.first_knot for window in planned.windows]
        content["infeasible"] = [window.infeasible for window in planned.windows]
        for name in _SIGHTED:
            content[name] = json.dumps([getattr(window, name) for window in planned.windows])
        for number, window in enumerate(planned.windows):
            content |= _pack(f"window{number}.plan", window.plan)
            content |= _pack(f"window{number}.reference", window.reference)
    else:
        content = {"format": _PLAN} | _pack("plan", planned)
    with replacing(path) as file:
        np.savez_compressed(file, **content)


def load(path: str | Path) -> Plan | Flight:
    """Read what `save` has written.

    Raises:
        PlanFileError: there is no such file, or it is no plan or flight, or it is damaged.
    """
    try:
        with open(path, "rb") as file:
            if not zipfile.is_zipfile(file):
                raise PlanFileError(f"{path}: not a plan or flight of drake_rho, or damaged")
            file.seek(0)
            with np.load(file, allow_pickle=False) as content:
                return _unpack_all(path, content)
    except OSError as error:
        raise PlanFileError(f"{path}: {error.strerror or 'not readable'}") from None
    except PlanFileError:
        raise
    except Exception as error:  # a damaged archive can make its readers raise almost anything
        reason = str(error).replace("'", "") or type(error).__name__
        raise PlanFileError(f"{path}: not a plan or flight, or damaged: {reason}") from None


def _unpack_all(path: str | Path, content: Mapping[str, np.ndarray]) -> Plan | Flight:
    form = str(content["format"]) if "format" in content else ""
    if form not in {_PLAN, _FLIGHT}:
        raise PlanFileError(f"{path}: not a plan or flight of this version of drake_rho")
    first_knots = content["first_knots"].tolist() if form == _FLIGHT else []
    prefixes = [f"window{number}.{kind}" for number in range(len(first_knots)) for kind in _KINDS]
    expected = {f"{prefix}.{part}" for prefix in ["plan", *prefixes] for part in _PARTS}
    expected |= {"format"} | ({"first_knots", "infeasible"} if form == _FLIGHT else set())
    optional = {"format", *_SIGHTED} if form == _FLIGHT else set()  # newer than the format
    if set(content) - optional != expected - optional:
        raise ValueError("parts are missing or do not belong")
    plan = _unpack("plan", content)
    if form == _PLAN:
        return plan
    learned, not_avoided = (_numbers(name, content, len(first_knots)) for name in _SIGHTED)
    windows = tuple(
        Window(
            first_knot,
            _unpack(f"window{number}.plan", content),
            _unpack(f"window{number}.reference", content),
            reason,
            learned[number],
            not_avoided[number],
        )
        for number, (first_knot, reason) in enumerate(
            zip(first_knots, content["infeasible"].tolist(), strict=True)
        )
    )
    _check_windows(plan, windows)
    return Flight(plan, windows)


def _numbers(name: str, content: Mapping[str, np.ndarray], windows: int) -> list[tuple[int, ...]]:
    """Numbers of obstacles for each window; none in files that have no such part."""
    if name not in content:
        return [()] * windows
    return TypeAdapter(
        Annotated[list[tuple[Annotated[int, Field(ge=1)], ...]], Len(windows, windows)]
    ).validate_json(str(content[name]))


def _check_windows(plan: Plan, windows: tuple[Window, ...]) -> None:
    knots = plan.scenario.grid.knots
    starts = [window.first_knot for window in windows]
    rising = all(early < late for early, late in pairwise([-1, *starts, knots - 1]))
    if not rising or starts[:1] != [0] or not all(isinstance(start, int) for start in starts):
        raise ValueError("the windows do not make up the flight")
    for window in windows:
        if {window.plan.scenario.grid.knots, window.reference.scenario.grid.knots} != {
            knots - window.first_knot
        }:
            raise ValueError("a window does not reach the end of the flight")


def _pack(prefix: str, plan: Plan) -> dict[str, Any]:
    _check_numbers(prefix, {name: getattr(plan, name) for name in _ARRAYS})
    return {
        f"{prefix}.scenario": scenario_to_json(plan.scenario),
        f"{prefix}.statistics": _STATISTICS.dump_json(plan.statistics).decode(),
        **{f"{prefix}.{name}": getattr(plan, name) for name in _ARRAYS},
    }


def _unpack(prefix: str, content: Mapping[str, np.ndarray]) -> Plan:
    arrays = {name: content[f"{prefix}.{name}"] for name in _ARRAYS}
    _check_numbers(prefix, arrays)
    statistics = _STATISTICS.validate_json(str(content[f"{prefix}.statistics"]), strict=True)
    under_way = prefix != "plan"  # what a window begins with, no one has chosen
    scenario = scenario_from_json(str(content[f"{prefix}.scenario"]), under_way=under_way)
    positions, velocities, accelerations = (arrays[name] for name in _ARRAYS)
    return Plan(scenario, positions, velocities, accelerations, statistics)


def _check_numbers(prefix: str, arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if array.dtype != np.float64 or not np.all(np.abs(array) <= LARGEST):  # never with a NaN
            raise ValueError(f"{prefix}.{name} has values that are no numbers up to {LARGEST:g}")
