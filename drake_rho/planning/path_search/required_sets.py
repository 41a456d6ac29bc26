"""Penalties of path searches for positions outside required sets (`KeepIn`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray
from drake_rho.scenario.parts import Grid
from drake_rho.scenario.records import Scenario
from drake_rho.scenario.requirements import KeepIn


class RequiredSets:
    """Required sets of positions in a scenario, at the layer boundaries of a search.

    Args:
        scenario: the scenario.
        times: layer boundaries since the first knot [s], shape (M + 1,).
    """

    def __init__(self, scenario: Scenario, times: FloatArray) -> None:
        grid, self._names = scenario.grid.beginning_at(0.0), scenario.names
        of_positions = (each for each in scenario.required if each.of == "position")
        self._sets = [each.since(scenario.grid) for each in of_positions]
        self._times = times
        self._active = [_active_layers(each, times, grid) for each in self._sets]

    def of(self, number: int, known: Mapping[int, FloatArray]) -> RequiredOfVehicle | None:
        """Return the required sets of a vehicle; None if it has none.

        Args:
            number: index of the vehicle.
            known: positions of vehicles with paths at the layer boundaries [m], (M + 1, 3) each.
        """
        found = list[tuple[KeepIn, BoolArray, FloatArray, float]]()
        for each, active in zip(self._sets, self._active, strict=True):
            members, partner = each.members(self._names), each.partner(self._names)
            if number in members and partner is None:
                found.append((each, active, each.offset(self._times), 1.0))
            elif number in members and partner is not None and partner in known:
                found.append((each, active, known[partner], 1.0))
            elif number == partner:
                others = [known[i] for i in members.tolist() if i in known]
                found += [(each, active, positions, -1.0) for positions in others]
        return RequiredOfVehicle(found) if found else None

    def order(self, order: IntArray, legs: IntArray) -> IntArray:
        """Return the planning order, in which each linked vehicle follows one of its partners.

        Args:
            order: the order without links.
            legs: number of legs of each vehicle, shape (N,). Among linked vehicles, the one with
                the most legs is first.
        """
        links = [
            (member, partner)
            for each in self._sets
            if (partner := each.partner(self._names)) is not None
            for member in each.members(self._names).tolist()
        ]
        if not links:
            return order
        remaining = sorted(order.tolist(), key=lambda i: -int(legs[i]))
        found = list[int]()
        while remaining:
            linked = {i for pair in links if set(pair) & set(found) for i in pair}
            after = next((i for i in remaining if i in linked), remaining[0])
            remaining.remove(after)
            found.append(after)
        return np.array(found)


class RequiredOfVehicle:
    """Distances of one vehicle outside its required sets, layer by layer."""

    def __init__(self, sets: list[tuple[KeepIn, BoolArray, FloatArray, float]]) -> None:
        self._sets = sets

    def part(self, first: int, last: int) -> RequiredOfVehicle:
        """Return the required sets at the layer boundaries from `first` to `last`."""
        some = slice(first, last + 1)
        return RequiredOfVehicle([(each, on[some], at[some], s) for each, on, at, s in self._sets])

    def outside(self, layer: int, positions: FloatArray) -> FloatArray:
        """Return the sum of distances outside the sets [m], shape (P,), of positions (P, 3)."""
        total = np.zeros(len(positions))
        for each, active, origin, sign in self._sets:
            if active[layer]:
                distances = each.set.signed_distance(sign * (positions - origin[layer]))
                total += np.maximum(np.asarray(distances), 0.0)
        return total


def _active_layers(each: KeepIn, times: FloatArray, grid: Grid) -> BoolArray:
    """Return flags of the layer boundaries, (M + 1,), in or nearest to a requirement's interval."""
    interval = each.interval(grid)
    if interval is None:
        return np.zeros(len(times), dtype=bool)
    half = float(np.diff(times).max()) / 2.0
    return np.asarray((times >= interval[0] - half) & (times <= interval[1] + half))
