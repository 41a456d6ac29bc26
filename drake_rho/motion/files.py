"""Files of plans, flights and simulations in `.npz` format, with their scenarios, without pickle.

`load` also reads documents and tables of states; it recognises a file by its content, not its
ending.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from pydantic import TypeAdapter

from drake_rho.motion.documents import is_document, read_document
from drake_rho.motion.flight import Flight, Window, beginnings
from drake_rho.motion.flown import Planned
from drake_rho.motion.measurements import Measurements
from drake_rho.motion.plan import Plan
from drake_rho.motion.simulation import Simulation
from drake_rho.motion.statistics import Statistics
from drake_rho.motion.tables import is_table, read_table
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.errors import DrakeRhoError, shortened
from drake_rho.scenario.fields import LARGEST
from drake_rho.scenario.files import scenario_from_json, scenario_to_json
from drake_rho.scenario.maps.map import Map
from drake_rho.scenario.maps.source import warn_if_changed
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.written_maps import map_from_json, map_to_json
from drake_rho.system.arrays import Archive
from drake_rho.system.files import LARGEST_TEXT, atomic_write, opened, read_bytes, reason_of

ENDINGS = (".npz",)
"""Endings of files that contain a plan, a flight or a simulation."""

_LARGEST_ARRAY = 1 << 30
"""Largest size of an array that is read [bytes]."""

_PLAN, _FLIGHT, _SIMULATION = (f"drake_rho {kind} 1" for kind in ("plan", "flight", "simulation"))
_ARRAYS = ("positions", "velocities", "accelerations")
_PLANS = ("plan", "reference", "contingency")
"""Plans stored for a window; only the contingency may be missing."""

_WINDOW_FIELDS: dict[str, TypeAdapter[Any]] = {
    name: TypeAdapter(list[kind])  # type: ignore[valid-type]  # types of fields are values here
    for name, kind in get_type_hints(Window, include_extras=True).items()
    if name not in {"first_knot", "infeasible", *_PLANS}
}
"""Window fields newer than the format of flights: older files do not have them."""

_ALWAYS = ("learned", "not_avoided", "kept", "off_tube")
"""Required window fields; the others are optional, stored only if a window has them."""

_MAP = "map"
"""Prefix of the names of maps, followed by their numbers. Older files have none: their scenarios
contain the maps."""

_SIMULATED = ("times", "positions", "velocities", "wind", "commands")
_ELAPSED, _LOST = "simulation.elapsed", "simulation.lost"
_HEADINGS = {f"simulation.{name}": name for name in ("headings", "commanded_headings")}
_STATISTICS = TypeAdapter(Statistics)
_JUMPS = "plan.jumps"
_UNDER_WAY = "plan.under_way"
"""Name of the knots at which a flight jumps; missing if it has no jumps."""
_MEASURED = ("times", "positions", "velocities")
"""Arrays of a flight's measurements; all are missing if it has none."""
_PARTS = ("scenario", "statistics", *_ARRAYS)


class PlanFileError(DrakeRhoError, ValueError):
    """Error for a file that is not a plan, a flight or a simulation, or is damaged."""


@checked
def save(planned: Planned, path: str | Path) -> None:
    """Write a plan, a flight or a simulation. The file is written completely or not at all.

    Args:
        planned: the plan, flight or simulation.
        path: of the file, used unchanged; its ending is `.npz`, or it has none.

    Raises:
        ValueError: the ending belongs to another format, or a number is too large to be read again.
        OSError: the file cannot be written.

    Examples:
        >>> plan = rho.plan(rho.load_scenario("paper"))
        >>> rho.save(plan, folder / "plan.npz")
        >>> rho.load(folder / "plan.npz").cost == plan.cost
        True
    """
    if (ending := Path(path).suffix) and ending.lower() not in ENDINGS:
        raise ValueError(
            f"{path}: got {ending}, expected the ending {' or '.join(ENDINGS)} or none"
        )
    maps = list[Map]()  # each stored once for all windows
    content = {"format": f"drake_rho {planned.kind} 1"} | _pack("plan", planned.plan, maps)
    if planned.flight is not None:
        content |= _pack_windows(planned.windows, maps) | _pack_measured(planned.flight.measured)
    if planned.plan.jumps:
        content[_JUMPS] = np.array(planned.plan.jumps)
    if planned.scenario.under_way:
        content[_UNDER_WAY] = True
    if planned.simulation is not None:
        content |= _pack_simulation(planned.simulation)
    for number, each in enumerate(maps):
        content[f"{_MAP}{number}"] = np.frombuffer(map_to_json(each).encode(), dtype=np.uint8)
    with atomic_write(path) as file:
        np.savez_compressed(file, **content)


@checked
def load(path: str | Path, scenario: Scenario | None = None) -> Planned:
    """Read a file written by `save`, or a plan that `export` has written as JSON or CSV.

    A file contains the maps of its scenario as they were. A `MapChangedWarning` is given if the
    file of a map has other content now.

    Args:
        path: of the file, with any name.
        scenario: scenario of a CSV table, which does not contain it; other files contain theirs.

    Raises:
        PlanFileError: the file does not exist, is of another kind or is damaged; or it is a table
            that lacks a knot of the scenario, or for which no scenario is given.
        ValueError: a scenario is given for a file that contains its own.
    """
    flown = _load(path, scenario)
    shapes = [each.shape for each in flown.scenario.bodies]
    sources = [each.source for each in shapes if isinstance(each, Map) and each.source is not None]
    for source in {each.path: each for each in sources}.values():
        warn_if_changed(source, "the plan was saved")
    return flown


def _load(path: str | Path, scenario: Scenario | None) -> Planned:
    try:
        with opened(path) as file:
            if zipfile.is_zipfile(file):
                _check_no_scenario(scenario, path)
                file.seek(0)
                return _unpack_all(path, Archive(file, _LARGEST_ARRAY))
        return _read_text(path, read_bytes(path, LARGEST_TEXT), scenario)
    except OSError as error:
        raise PlanFileError(f"{path}: {reason_of(error)}") from None
    except (PlanFileError, _ScenarioGivenError):
        raise
    except Exception as error:  # readers of damaged archives may raise almost anything
        reason = shortened(str(error).replace("'", "")) or type(error).__name__
        raise PlanFileError(f"{path}: not a plan or flight, or damaged: {reason}") from None


class _ScenarioGivenError(ValueError):
    """Error for a scenario given for a file that contains its own."""


def _check_no_scenario(scenario: Scenario | None, path: str | Path) -> None:
    if scenario is not None:
        expected = f"none: {path} has a scenario of its own"
        raise _ScenarioGivenError(f"scenario: got {scenario.name!r}, expected {expected}")


def _read_text(path: str | Path, content: bytes, scenario: Scenario | None) -> Plan:
    """Return the plan in a document or in a table of states."""
    text = content.decode("utf-8-sig", errors="replace")  # other programs may add a byte order mark
    if is_document(text):
        _check_no_scenario(scenario, path)
        return read_document(text)
    if scenario is not None:
        return read_table(text, scenario)
    if is_table(text):
        expected = "expected its scenario, as in load(path, scenario=...)"
        raise PlanFileError(f"{path}: a table of states without a scenario, {expected}")
    raise PlanFileError(
        f"{path}: not a plan or flight of drake_rho, or damaged; trajectories of others need a "
        "scenario: load_trajectories(path, scenario), or --scenario"
    )


def _unpack_all(path: str | Path, content: Archive) -> Planned:
    form = str(content["format"]) if "format" in content else ""
    if form not in {_PLAN, _FLIGHT, _SIMULATION}:
        raise PlanFileError(f"{path}: not a plan or flight of this version of drake_rho")
    first_knots = [] if form == _PLAN else content["first_knots"].tolist()
    prefixes = [prefix for each in _prefixes(len(first_knots), content) for prefix in each.values()]
    expected = {f"{prefix}.{part}" for prefix in ["plan", *prefixes] for part in _PARTS}
    optional = {"format", _JUMPS, _UNDER_WAY}
    if form != _PLAN:
        expected |= {"first_knots", "infeasible"}
        optional |= set(_WINDOW_FIELDS)
        if "measured.times" in content:
            expected |= {f"measured.{name}" for name in _MEASURED}
    if form == _SIMULATION:
        expected |= {"plant", *(f"simulation.{name}" for name in _SIMULATED)}
        optional |= {_ELAPSED, _LOST, *_HEADINGS}
    names = {name for name in content if not name.startswith(_MAP)}
    if names - optional != expected:
        raise ValueError("arrays are missing or do not belong to the format")
    count = len(content) - len(names)
    maps = [map_from_json(content[f"{_MAP}{number}"].tobytes().decode()) for number in range(count)]
    if form == _PLAN:
        return _unpack("plan", content, maps)
    flight = _unpack_flight(content, first_knots, maps)
    return flight if form == _FLIGHT else _unpack_simulation(flight, content)


def _pack_windows(windows: Sequence[Window], maps: list[Map]) -> dict[str, Any]:
    content: dict[str, Any] = {
        "first_knots": [window.first_knot for window in windows],
        "infeasible": [window.infeasible for window in windows],
    }
    for name in _WINDOW_FIELDS:
        values = [getattr(window, name) for window in windows]
        if name in _ALWAYS or any(values):
            content[name] = json.dumps(values)
    for number, window in enumerate(windows):
        for kind in _PLANS:
            if (plan := getattr(window, kind)) is not None:
                content |= _pack(f"window{number}.{kind}", plan, maps)
    return content


def _unpack_flight(content: Archive, first_knots: list[int], maps: Sequence[Map]) -> Flight:
    count = len(first_knots)
    fields: dict[str, Any] = {
        "first_knot": first_knots,
        "infeasible": content["infeasible"].tolist(),
    }
    for name in filter(content.__contains__, _WINDOW_FIELDS):
        fields[name] = _WINDOW_FIELDS[name].validate_json(str(content[name]), strict=True)
    for name, values in fields.items():
        if len(values) != count:
            raise ValueError(f"{name} has {len(values)} values, expected one for each window")
    every = [
        {name: values[number] for name, values in fields.items()}
        | {kind: _unpack(prefix, content, maps) for kind, prefix in prefixes.items()}
        for number, prefixes in enumerate(_prefixes(count, content))
    ]
    windows = tuple(Window(**each) for each in every)
    plan = _unpack("plan", content, maps)
    _check_windows(plan, windows)
    if plan.scenario.smoothing:
        motion = plan.motion()
        windows = tuple(each.going_on(motion.flown_until(each.first_knot)) for each in windows)
    return _with_jumps(Flight(plan, windows, _unpack_measured(plan.scenario, content)))


def _with_jumps(flight: Flight) -> Flight:
    """Return a flight from measured states with its jumps, which older files do not store.

    Their plans integrate the accelerations of all windows from the starts.
    """
    plan = flight.plan
    if plan.jumps or not beginnings(plan.scenario, flight.windows):
        return flight
    flown = Flight.composed(plan.scenario, flight.windows)
    forgetful = Plan.from_accelerations(plan.scenario, flown.plan.accelerations)
    if any(not np.array_equal(getattr(plan, each), getattr(forgetful, each)) for each in _ARRAYS):
        return flight
    return dataclasses.replace(flight, plan=flown.plan.with_statistics(plan.statistics))


def _prefixes(windows: int, content: Mapping[str, np.ndarray]) -> list[dict[str, str]]:
    """Return the name prefixes of every window's plans, by kind."""
    every = [{kind: f"window{number}.{kind}" for kind in _PLANS} for number in range(windows)]
    for each in every:
        if f"{each['contingency']}.scenario" not in content:
            del each["contingency"]
    return every


def _pack_measured(measured: Measurements | None) -> dict[str, Any]:
    if measured is None:
        return {}
    return {f"measured.{name}": getattr(measured, name) for name in _MEASURED}


def _unpack_measured(scenario: Scenario, content: Archive) -> Measurements | None:
    if "measured.times" not in content:
        return None
    (count,) = content.shape("measured.times")
    for name in _MEASURED[1:]:
        _check_shape(content, f"measured.{name}", (count, len(scenario.vehicles), 3))
    return Measurements(scenario.names, *(content[f"measured.{name}"] for name in _MEASURED))


def _pack_simulation(simulation: Simulation) -> dict[str, Any]:
    arrays = {f"simulation.{name}": getattr(simulation, name) for name in _SIMULATED}
    if not np.array_equal(np.asarray(simulation.elapsed), simulation.times - simulation.times[0]):
        arrays[_ELAPSED] = simulation.elapsed  # times on a clock far from 0 are rounded
    if simulation.headings is not None:
        arrays |= {key: getattr(simulation, name) for key, name in _HEADINGS.items()}
    _check_numbers("simulation", arrays)
    lost = {} if simulation.lost is None else {_LOST: simulation.lost}
    return {"plant": simulation.plant, **arrays, **lost}


def _unpack_simulation(flight: Flight, content: Archive) -> Simulation:
    (count,) = content.shape("simulation.times") if "simulation.times" in content else (0,)
    vehicles = len(flight.scenario.vehicles)
    for name in _SIMULATED[1:]:
        _check_shape(content, f"simulation.{name}", (count, vehicles, 3))
    arrays = {name: content[f"simulation.{name}"] for name in _SIMULATED}
    if _ELAPSED in content:
        arrays["elapsed"] = content[_ELAPSED]
    for key in filter(content.__contains__, _HEADINGS):
        _check_shape(content, key, (count, vehicles))
        arrays[_HEADINGS[key]] = content[key]
    _check_numbers("simulation", arrays)
    lost = content.get(_LOST)
    if lost is not None and lost.dtype != np.bool_:
        raise ValueError(f"{_LOST} has values that are not true or false")
    return Simulation(flight, **arrays, plant=str(content["plant"]), lost=lost)


def _check_windows(plan: Plan, windows: tuple[Window, ...]) -> None:
    knots = plan.scenario.grid.knots
    starts = [window.first_knot for window in windows]
    increasing = all(early < late for early, late in pairwise([-1, *starts, knots - 1]))
    if not increasing or starts[:1] != [0] or not all(isinstance(start, int) for start in starts):
        raise ValueError("the windows do not cover the flight in order")
    for window, until in zip(windows, [*starts[1:], knots - 1], strict=True):
        own, reference = (each.scenario.grid.knots for each in (window.plan, window.reference))
        if own != reference or window.first_knot + own <= until:
            raise ValueError("a window does not reach the next one")
        grid, own_grid = plan.scenario.grid, window.plan.scenario.grid
        if not grid.clock.same(own_grid.start, grid.start + window.first_knot * grid.step):
            raise ValueError("a window begins at another time than that of its first knot")


def _pack(prefix: str, plan: Plan, maps: list[Map]) -> dict[str, Any]:
    _check_numbers(prefix, {name: getattr(plan, name) for name in _ARRAYS})
    return {
        f"{prefix}.scenario": scenario_to_json(plan.scenario, maps),
        f"{prefix}.statistics": _STATISTICS.dump_json(plan.statistics).decode(),
        **{f"{prefix}.{name}": getattr(plan, name) for name in _ARRAYS},
    }


def _unpack(prefix: str, content: Archive, maps: Sequence[Map]) -> Plan:
    statistics = _STATISTICS.validate_json(str(content[f"{prefix}.statistics"]), strict=True)
    # the initial state of a window is given by the flight, and may be by the flight before
    under_way = prefix != "plan" or _UNDER_WAY in content
    text = str(content[f"{prefix}.scenario"])
    scenario = scenario_from_json(text, under_way=under_way, maps=maps)
    for name in _ARRAYS:
        knots = scenario.grid.knots - (name == "accelerations")
        _check_shape(content, f"{prefix}.{name}", (len(scenario.vehicles), knots, 3))
    arrays = {name: content[f"{prefix}.{name}"] for name in _ARRAYS}
    _check_numbers(prefix, arrays)
    positions, velocities, accelerations = (arrays[name] for name in _ARRAYS)
    jumps = content[_JUMPS].tolist() if prefix == "plan" and _JUMPS in content else []
    if not all(isinstance(each, int) for each in jumps):
        raise ValueError(f"{_JUMPS} has values that are not whole numbers")
    return Plan(scenario, positions, velocities, accelerations, statistics, jumps=tuple(jumps))


def _check_shape(content: Archive, name: str, expected: tuple[int, ...]) -> None:
    """Check the declared shape of an array before it is read."""
    if (found := content.shape(name)) != expected:
        raise ValueError(f"{name} has the shape {found}, expected {expected}")


def _check_numbers(prefix: str, arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if array.dtype != np.float64 or not np.all(np.abs(array) <= LARGEST):  # also true for NaN
            raise ValueError(f"{prefix}.{name} has values that are not numbers up to {LARGEST:g}")
