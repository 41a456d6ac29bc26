"""Plans and flights in `.npz` files, each with its scenario inside; read without pickle."""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drake_rho.motion.plan import Flight, Plan, Statistics, Window
from drake_rho.scenario.errors import DrakeRhoError
from drake_rho.scenario.files import replacing, scenario_from_json, scenario_to_json

_FORMAT = "drake_rho 1"
_ARRAYS = ("positions", "velocities", "accelerations")


class PlanFileError(DrakeRhoError, ValueError):
    """A file is not a plan or a flight, or is damaged."""


def save(planned: Plan | Flight, path: str | Path) -> None:
    """Write a plan or a flight, whole or not at all.

    Args:
        planned: what to keep.
        path: of the file, used as it is; `.npz` is the customary ending.

    Raises:
        OSError: the file cannot be written.
    """
    content: dict[str, Any] = {"format": _FORMAT}
    if isinstance(planned, Flight):
        content |= _pack("plan", planned.plan)
        content["first_knots"] = [window.first_knot for window in planned.windows]
        content["infeasible"] = [window.infeasible for window in planned.windows]
        for number, window in enumerate(planned.windows):
            content |= _pack(f"window{number}.plan", window.plan)
            content |= _pack(f"window{number}.reference", window.reference)
    else:
        content |= _pack("plan", planned)
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
    if "format" not in content or str(content["format"]) != _FORMAT:
        raise PlanFileError(f"{path}: not a plan or flight of this version of drake_rho")
    plan = _unpack("plan", content)
    if "first_knots" not in content:
        return plan
    windows = tuple(
        Window(
            int(first_knot),
            _unpack(f"window{number}.plan", content),
            _unpack(f"window{number}.reference", content),
            str(infeasible),
        )
        for number, (first_knot, infeasible) in enumerate(
            zip(content["first_knots"], content["infeasible"], strict=True)
        )
    )
    return Flight(plan, windows)


def _pack(prefix: str, plan: Plan) -> dict[str, Any]:
    return {
        f"{prefix}.scenario": scenario_to_json(plan.scenario),
        f"{prefix}.statistics": json.dumps(dataclasses.asdict(plan.statistics)),
        **{f"{prefix}.{name}": getattr(plan, name) for name in _ARRAYS},
    }


def _unpack(prefix: str, content: Mapping[str, np.ndarray]) -> Plan:
    arrays = {name: content[f"{prefix}.{name}"] for name in _ARRAYS}
    for name, array in arrays.items():
        if not np.all(np.isfinite(array)):
            raise ValueError(f"{prefix}.{name} has values that are not finite")
    statistics = json.loads(str(content[f"{prefix}.statistics"]))
    statistics["steps_tried"] = tuple(statistics["steps_tried"])
    scenario = scenario_from_json(str(content[f"{prefix}.scenario"]))
    return Plan(scenario, **arrays, statistics=Statistics(**statistics))
