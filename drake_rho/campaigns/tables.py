"""Results as tables of text, for a terminal of a hundred columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from drake_rho.campaigns.statistics import Comparison, Failure, Group, Quantiles

_TERMINAL_WIDTH = 100
"""Columns of the terminal."""

_SPREAD = "median (10 % quantile to 90 % quantile)"
"""Label of the statistics printed for several values."""

_LEAST_WIDTH = 40
"""Least number of columns for a reason."""


def tables(
    title: str,
    groups: Sequence[Group],
    failures: Sequence[Failure],
    comparisons: Sequence[Comparison],
) -> str:
    """Return tables of success, costs and times, of failures, and of comparisons.

    Final times are omitted where methods keep those of the scenarios.
    """
    parts = [title, _groups(groups)]
    if failures:
        parts.append(_failures(failures))
    if comparisons:
        parts.append(_comparisons(comparisons))
    if any(each.shorter or each.longer for each in comparisons):
        parts.append(_final_times(comparisons))
    return "\n\n".join(parts)


def _groups(groups: Sequence[Group]) -> str:
    """Return a table of all groups, with final times if these differ within a source."""
    found = [(each.scenario, each.duration) for each in groups if each.success.successes]
    ends = {(name, round(end, 9)) for name, of in found for end in (of.least, of.greatest)}
    timed = len(ends) > len({name for name, _ in ends})
    heads = ["scenario", "method", "runs", "success, 95 % [%]", "cost [m²/s⁴]"]
    heads += [*(["final time [s]"] if timed else []), "time [s]"]
    rows = []
    for each in groups:
        low, high = each.success.interval
        rate = f"{100 * each.success.rate:5.1f} ({100 * low:.1f} to {100 * high:.1f})"
        row = (each.scenario, each.method, str(each.success.runs), rate)
        values = [each.cost, *([each.duration] if timed else []), each.seconds]
        rows.append((*row, *map(_spread, values)))
    note = f"cost{', final time' if timed else ''} and time: {_SPREAD}"
    return f"{_in_width(heads, rows)}\n{note}"


def _in_width(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of groups, with the times below if it is wider than the terminal."""
    whole = _grid(heads, rows)
    if max(map(len, whole.splitlines())) <= _TERMINAL_WIDTH:
        return whole
    named, times = 2, heads.index("cost [m²/s⁴]") + 1
    above = _grid(heads[:times], [row[:times] for row in rows])
    heads, *rows = ([*row[:named], *row[times:]] for row in (heads, *rows))
    below = _grid(heads, rows)
    return f"{above}\n\n{below}"


def _failures(failures: Sequence[Failure]) -> str:
    """Return a table with a row for each kind of failure and its reason in full."""
    heads = ("failures of", "status", "runs", "most often because")
    kinds = [(each.method, each.status, str(each.runs)) for each in failures]
    before = sum(max(map(len, column)) + 2 for column in zip(heads[:3], *kinds, strict=True))
    width, rows = max(_TERMINAL_WIDTH - before, _LEAST_WIDTH), list[Sequence[str]]()
    for kind, each in zip(kinds, failures, strict=True):
        first, *others = textwrap.wrap(each.reason, width, break_on_hyphens=False) or [""]
        rows += [(*kind, first), *(("", "", "", line) for line in others)]
    return _grid(heads, rows)


def _comparisons(comparisons: Sequence[Comparison]) -> str:
    heads = ("method / first", "scenario", "both", "only it", "only first", "p")
    rows = [
        (
            f"{each.method} / {each.base}",
            each.scenario or "all",
            str(each.both),
            str(each.only_method),
            str(each.only_base),
            f"{each.p_success:.2g}",
            _spread(each.cost_ratio),
            f"{each.cheaper}:{each.costlier}",
            f"{each.p_cost:.2g}",
            _spread(each.time_ratio),
        )
        for each in comparisons
    ]
    return _grid((*heads, "cost ratio", "cheaper:costlier", "p", "time ratio"), rows)


def _final_times(comparisons: Sequence[Comparison]) -> str:
    heads = ("method / first", "scenario", "both", "final time ratio", "shorter:longer", "p")
    rows = [
        (
            f"{each.method} / {each.base}",
            each.scenario or "all",
            str(each.both),
            _spread(each.duration_ratio),
            f"{each.shorter}:{each.longer}",
            f"{each.p_duration:.2g}",
        )
        for each in comparisons
    ]
    return _grid(heads, rows)


def _spread(values: Quantiles) -> str:
    if math.isnan(values.median):
        return "-"
    return f"{values.median:.4g} ({values.lower:.3g} to {values.upper:.3g})"


def _grid(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, *rows]
    widths = [max(len(line[place]) for line in lines) for place in range(len(heads))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )
