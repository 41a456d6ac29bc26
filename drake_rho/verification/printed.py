"""Text of a report: the verdict, the key figures, and a table of margins."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence

from drake_rho.scenario.clock import clock_number, clock_time
from drake_rho.system.numbers import percent
from drake_rho.verification.check import AT_ALL_TIMES, AT_KNOTS, MEASURED, Check
from drake_rho.verification.summary import Summary

LONGEST = 12
"""Largest number of violations, or of obstacles, that a printed report shows."""

_EQUALITIES = ("dynamics", "goals", "waypoints")
"""Kinds of equality constraints, met to within rounding, so that they have no margin."""

_ROUNDING = 1e-9
"""Relative rounding error by which a cost may be below the least effort."""


@dataclasses.dataclass(frozen=True)
class Printed:
    """Contents of a printed report."""

    title: str
    """first line: the scenario's name and the verdict"""
    facts: tuple[tuple[str, str], ...]
    """key figures, each with its name"""
    heads: tuple[str, ...]
    """heads of the table's columns"""
    rows: tuple[tuple[str, ...], ...]
    """cells of the table"""
    below: tuple[str, ...]
    """lines below the table"""

    def __str__(self) -> str:
        widths = [max(map(len, column)) for column in zip(self.heads, *self.rows, strict=True)]
        form = "  ".join(
            f"{{:{'<' if number < TEXTS else '>'}{width}}}" for number, width in enumerate(widths)
        )
        longest = max(len(name) for name, _ in self.facts)
        facts = (f"{name:<{longest}}  {words}" for name, words in self.facts)
        table = [form.format(*each).rstrip() for each in (self.heads, *self.rows)]
        return "\n".join([self.title, *facts, *(["", *table] if self.rows else []), *self.below])


TEXTS = 2
"""Number of text columns, from the left."""


def facts(
    summary: Summary, checks: Sequence[Check], duration: float, *, gap: bool
) -> Iterator[tuple[str, str]]:
    """Yield clearance, separation, speed, time and cost, each with its name.

    Args:
        summary: summary of the motion.
        checks: all checks.
        duration: final time of the plan [s], before averaging if it is smoothed.
        gap: whether to include the largest possible optimality gap, of the cost or of the time.
    """
    for name, kind in (("least clearance", "obstacles"), ("least separation", "separation")):
        if (nearest := closest(checks, kind)) is None:
            continue
        yield name, _distance(nearest)
        optional = [each for each in checks if each.kind == kind and not each.asked]
        violated = [each for each in optional if not each.holds and _is_always(each)]
        if violated and nearest.holds:
            worst = max(violated, key=lambda check: check.badness)
            yield "  between knots", f"{_place(worst)}; not required"
        if (sample := closest(checks, kind, measured=True)) is not None:
            yield "  measured", _distance(sample)
    at = clock_time(summary.fastest_at)
    yield "top speed", f"{summary.top_speed:.4g} m/s, {summary.fastest} at {at}"
    times = f"{clock_number(summary.start)} to {clock_time(summary.end)}"
    yield (
        "time",
        times + (_gap_of_time(summary, duration) if gap and summary.minimised == "time" else ""),
    )
    most = summary.cost_bound
    bounds = "" if most is None else f"; at most {most:.6g} m²/s⁴ by the first window's bound"
    prices = [each.price for each in checks if each.price is not None]
    total = summary.cost + sum(prices)
    bounds += _gap_of_cost(summary, total) if gap and summary.minimised == "cost" else ""
    yield "cost", f"{summary.cost:.6g} m²/s⁴{_by_term(summary.costs)}{bounds}"
    if prices:
        yield "penalties", f"{sum(prices):.6g} m²/s⁴ for soft limits"


def in_words(check: Check) -> str:
    """Return a sentence on a soft limit: for whom, by how much, when, at what price."""
    much = f"by {check.excess:.4g} {check.unit} at {clock_time(check.time)}"
    return f"soft: {check.what}, exceeded for {check.vehicle} {much}, for {check.price:.6g} m²/s⁴"


def closest(checks: Iterable[Check], kind: str, *, measured: bool = False) -> Check | None:
    """Return the required check of a kind with the smallest margin; None if there is none.

    Args:
        checks: all checks.
        kind: kind of the check.
        measured: whether it is of measured samples, not of the motion.
    """
    which = (each for each in checks if each.kind == kind and each.is_measured == measured)
    required = (check for check in which if check.asked)
    return max(required, key=lambda check: check.badness, default=None)


def _is_always(check: Check) -> bool:
    """Return whether a check covers every instant though its scenario requires the knots only."""
    return check.part.endswith(AT_ALL_TIMES) and "before" not in check.constraint


def _distance(check: Check) -> str:
    """Return a vehicle's distance from an obstacle or another vehicle, and its margin."""
    verdict = "undecided" if check.is_undecided else "VIOLATED"
    return f"{_place(check)}; {margin_in_words(check) + ' left' if check.holds else verdict}"


def _place(check: Check) -> str:
    """Return a vehicle's distance from an obstacle or another vehicle, and when."""
    other = check.constraint if check.kind == "obstacles" else check.part.removeprefix("from ")
    for instants in (AT_KNOTS, AT_ALL_TIMES, MEASURED):
        other = other.removesuffix(instants).rstrip()
    how = f"{check.value:.4g} m from" if check.value >= 0.0 else f"{-check.value:.4g} m inside"
    if abs(check.value) <= check.tolerance:
        how = "on the surface of"
    return f"{check.vehicle} {how} {other} at {clock_time(check.time)}"


def _gap_of_time(summary: Summary, duration: float) -> str:
    """Return the largest possible gap to the least time on as many knots."""
    if summary.time_bound is None:
        return ", minimised; the gap to the least time is not known"
    gap = max(0.0, 1.0 - summary.time_bound / duration)
    return f", minimised; gap to the least time at most {percent(gap)}"


def _by_term(costs: Mapping[str, float]) -> str:
    """Return the cost of each term, the largest first; nothing if effort is the only one."""
    if list(costs) == ["effort"]:
        return ""
    largest = sorted(costs.items(), key=lambda each: -each[1])
    words = (f"{term.replace('_', ' ')} {cost:.4g}" for term, cost in largest)
    return f" ({', '.join(words)})"


def _gap_of_cost(summary: Summary, total: float) -> str:
    """Return the largest possible optimality gap of the cost; the least effort is the lower bound.

    A motion that jumps is no plan from the starts, so the bound does not apply to its cost.

    Args:
        summary: summary of the motion.
        total: its cost with the price of soft limits [m²/s⁴].
    """
    least = summary.least_effort or 0.0
    if summary.largest_jump is not None or not total >= (1.0 - _ROUNDING) * least > 0.0:
        return ""
    gap = max(0.0, 1.0 - least / total)
    return f"; gap to the optimum at most {percent(gap)} (quick bound)"


def margin_in_words(check: Check) -> str:
    """Return the margin of a check with its unit; 0 to within rounding."""
    return f"{0.0 if abs(check.left) <= check.tolerance else check.left:.3g} {check.unit}"


def is_equality(check: Check) -> bool:
    """Return whether a check is an equality that holds: its margin is only rounding."""
    if check.kind == "goals" and check.constraint != "goal":  # a set
        return False
    return check.kind in _EQUALITIES and check.limit == 0.0 and check.asked and check.holds


Table = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]
"""Heads and cells of a table."""


def short_table(checks: Sequence[Check]) -> Table:
    """Return the table with one column of margins."""
    cells = (
        (
            check.what,
            check.vehicle,
            clock_number(check.time),
            margin_in_words(check),
            _verdict(check),
        )
        for check in checks
    )
    return _without_empty(("constraint", "vehicle", "time [s]", "left", ""), *cells)


def full_table(checks: Sequence[Check]) -> Table:
    """Return the table with values and limits, and with errors if any is positive."""
    cells = (
        (
            check.what,
            check.vehicle,
            clock_number(check.time),
            f"{check.value:.6g}",
            f"{check.limit:.6g}",
            f"{check.errors:.4g}" if check.errors > 0.0 else "",
            f"{check.left + 0.0:+.2e}",
            check.unit,
            _verdict(check) or "holds",
        )
        for check in checks
    )
    heads = ("constraint", "vehicle", "time [s]", "value", "limit", "for errors", "left")
    return _without_empty((*heads, "unit", "verdict"), *cells)


def _verdict(check: Check) -> str:
    """Return a short verdict on a check, if it is not as expected."""
    if check.price is not None:
        return f"soft: {check.price:.6g} m²/s⁴" if check.price else "soft"
    if not check.asked:
        return "not required"
    if check.is_undecided:
        return "undecided"
    return "" if check.holds else "VIOLATED"


def _without_empty(heads: tuple[str, ...], *rows: tuple[str, ...]) -> Table:
    """Return the heads and the rows of a table without its empty columns."""
    shown = [number for number in range(len(heads)) if any(row[number] for row in rows)]
    first, *rest = (tuple(row[number] for number in shown) for row in (heads, *rows))
    return first, tuple(rest)
