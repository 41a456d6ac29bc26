"""Checks of, and notes on, vehicles that hold at their goals after the end."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.scenario.clock import clock_time
from drake_rho.scenario.records import Scenario
from drake_rho.verification.check import AT_ALL_TIMES, Column
from drake_rho.verification.rest import REACHED, Rest

_NAMED = 3
"""Largest number of vehicles that are named in notes."""


def check_rest(scenario: Scenario) -> Iterator[Column]:
    """Yield the margins of holding at the goals for ever, if required: one check per unit.

    A check is of the most violated constraint or, if all hold, of the closest.
    """
    if not scenario.hold_at_goal:
        return
    rest, count = Rest.of(scenario), len(scenario.vehicles)
    columns = [] if rest is None else rest.columns()
    for unit in dict.fromkeys(["m", *(each.unit for each in columns)]):
        yield _worst_of(unit, [each for each in columns if each.unit == unit], scenario, count)


def _worst_of(unit: str, columns: list[Column], scenario: Scenario, count: int) -> Column:
    """Return the worst checks of columns with one unit; an inactive column if there are none."""
    numbers = {name: np.zeros(count) for name in ("times", "values", "limits", "excess", "errors")}
    numbers["tolerances"] = np.ones(count)
    parts, concerned = [""] * count, np.zeros(count, dtype=bool)
    worst = np.full(count, -np.inf)
    for each in columns:
        excess = np.where(np.isnan(each.excess), np.inf, each.excess)
        violated = excess > each.tolerances
        badness = np.where(violated, excess / each.tolerances, np.minimum(excess, 0.0))
        worse = (badness > worst) & each.concerned
        worst[worse], concerned = badness[worse], concerned | worse
        for name, values in numbers.items():
            values[worse] = getattr(each, name)[worse]
        for vehicle in np.flatnonzero(worse).tolist():
            parts[vehicle] = _named(each, vehicle)
    return Column(
        kind="holding",
        constraint="hold at goal",
        parts=parts,
        times=numbers["times"],
        values=numbers["values"],
        limits=numbers["limits"],
        excess=numbers["excess"],
        tolerances=numbers["tolerances"],
        errors=numbers["errors"],
        unit=unit,
        concerned=concerned,
    )


def _named(column: Column, vehicle: int) -> str:
    """Return the constraint and part of a check, without its times."""
    return f"{column.constraint} {column.parts[vehicle].removesuffix(AT_ALL_TIMES)}".strip()


def notes_on_rest(scenario: Scenario) -> tuple[str, ...]:
    """Return notes on vehicles that cannot hold at their goals for ever: until when, and why."""
    rest = Rest.of(scenario)
    if rest is None:
        return ()
    columns = rest.columns()
    failing = [
        vehicle
        for vehicle in range(len(rest.scenario.vehicles))
        if any(each.is_beyond(vehicle) for each in columns)
    ]
    notes = [_note(rest, columns, vehicle) for vehicle in failing[:_NAMED]]
    if len(failing) > _NAMED:
        notes.append(f"{len(failing) - _NAMED} more vehicles cannot hold at their goals for ever")
    return tuple(notes)


def _note(rest: Rest, columns: list[Column], vehicle: int) -> str:
    """Return a note on the time until which a vehicle can hold, and its first violation."""
    time = rest.until(vehicle)
    lasting = max(time - rest.begin, rest.shortest)
    then = zip(columns, rest.columns(lasting), strict=True)
    failing = [(now, each) for each, now in then if each.is_beyond(vehicle)]
    now, each = next((both for both in failing if both[0].is_beyond(vehicle, REACHED)), failing[0])
    name, at_once = rest.scenario.names[vehicle], time == rest.begin
    until = f"{name} can hold at its goal until {clock_time(time)} only"
    if at_once:
        until = f"{name} cannot hold at its goal"
    if not rest.is_bounded:
        return f"{until}, for {_named(now, vehicle)}: its errors go on growing"
    beyond = f"by up to {each.excess[vehicle]:.3g} {each.unit}"
    violated = "is violated" if at_once else "is violated later,"
    return f"{until}: {_named(now, vehicle)} {violated} {beyond}"
