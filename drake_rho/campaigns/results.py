"""`Results`: contents of a store as a frame, as a file, and as a summary."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import tempfile
from collections import Counter
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from drake_rho.campaigns.columns import Columns
from drake_rho.campaigns.runs import Row
from drake_rho.campaigns.statistics import (
    Comparison,
    Failure,
    Group,
    Proportion,
    Quantiles,
    compare,
)
from drake_rho.campaigns.store import COLUMNS, StoreError, check_rows, reading
from drake_rho.campaigns.tables import tables
from drake_rho.motion.files import load
from drake_rho.motion.flown import Planned
from drake_rho.scenario.fields import FloatArray, IntArray, Name
from drake_rho.system.files import atomic_write

if TYPE_CHECKING:
    import pandas as pd


ENDINGS = (".csv", ".parquet")
"""Endings of the files that `Results.export` writes."""


_SELECT = f"SELECT {', '.join(COLUMNS)} FROM runs"  # noqa: S608


@dataclasses.dataclass(frozen=True)
class _Named:
    """Source of scenarios, or method, of a study."""

    name: Name


@dataclasses.dataclass(frozen=True)
class _Names:
    """Parts of a study that results need; the study may be of another version."""

    name: Name
    scenarios: Annotated[list[_Named], Field(min_length=1)]
    methods: Annotated[list[_Named], Field(min_length=1)]


class Results:
    """Results in a store; prints as tables.

    Args:
        path: path of the store.

    Raises:
        StoreError: there is no such file, or it is not a store.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with reading(self.path) as connection:
            check_rows(connection, self.path)
            found = connection.execute("SELECT study FROM study").fetchone()
            (self.runs,) = connection.execute("SELECT count(*) FROM runs").fetchone()
        if found is None:
            raise StoreError(f"{self.path}: got no study, expected the study of the runs")
        try:
            names = TypeAdapter(_Names).validate_json(found[0])
        except ValidationError:
            expected = "the name of the study, and those of its scenarios and methods"
            raise StoreError(f"{self.path}: got a damaged study, expected {expected}") from None
        self.study: str = names.name
        self.scenarios: tuple[str, ...] = tuple(each.name for each in names.scenarios)
        self.methods: tuple[str, ...] = tuple(each.name for each in names.methods)

    def frame(self) -> pd.DataFrame:
        """Return a pandas frame with one row for each run (extra `results`).

        Raises:
            ImportError: pandas is not installed.
        """
        import pandas as pd

        with reading(self.path) as connection:
            frame = pd.read_sql_query(_SELECT, connection)
        return frame.astype({"verified": bool, "vehicles": "Int64", "programs": "Int64"})

    def rows(self) -> Iterator[Row]:
        """Yield all rows as records, in their order in the store."""
        with reading(self.path) as connection:
            for values in connection.execute(f"{_SELECT} ORDER BY rowid"):
                row = dict(zip(COLUMNS, values, strict=True))
                yield Row(**(row | {"verified": bool(row["verified"])}))

    def export(self, path: str | Path) -> None:
        """Write one row for each run, completely or not at all.

        Args:
            path: path of the file; its ending determines the format: `.csv`, or `.parquet` (extra
                `results`).

        Raises:
            ValueError: the path has another ending.
            OSError: the file cannot be written.
            ImportError: for Parquet, pandas or pyarrow is not installed.
        """
        ending = Path(path).suffix.lower()
        if ending not in ENDINGS:
            raise ValueError(f"{path}: got {ending!r}, expected the ending {' or '.join(ENDINGS)}")
        with atomic_write(path) as file:
            if ending == ".parquet":
                self.frame().to_parquet(file, index=False)
                return
            text = io.TextIOWrapper(file, encoding="utf-8", newline="", write_through=True)
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(COLUMNS)
            with reading(self.path) as connection:
                writer.writerows(connection.execute(_SELECT))
            text.detach()

    def plan(self, key: str) -> Planned:
        """Return the plan, flight or simulation of a run, if the study keeps plans.

        Raises:
            StoreError: the run has no plan, or plans were not kept.
        """
        with reading(self.path) as connection:
            found = connection.execute("SELECT content FROM plans WHERE key = ?", (key,)).fetchone()
        if found is None:
            raise StoreError(f"{self.path}: got no plan of run {key}, expected one that was kept")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "plan.npz"
            path.write_bytes(found[0])
            return load(path)

    @cached_property
    def groups(self) -> tuple[Group, ...]:
        """Summaries of each method on each source of scenarios that have runs."""
        columns, found = self._columns, list[Group]()
        for number in range(len(self.scenarios) * len(self.methods)):
            here = columns.pair == number
            if not np.any(here):
                continue
            i, j = divmod(number, len(self.methods))
            good = here & columns.verified
            found.append(
                Group(
                    self.scenarios[i],
                    self.methods[j],
                    Proportion(int(np.sum(good)), int(np.sum(here))),
                    Quantiles.of(columns.cost[good]),
                    Quantiles.of(columns.duration[good]),
                    Quantiles.of(columns.seconds[here]),
                )
            )
        return tuple(found)

    @cached_property
    def failures(self) -> tuple[Failure, ...]:
        """Runs without a verified plan, by method and status, the most frequent first."""
        found = dict[tuple[str, str], Counter[str]]()
        columns = "method, status, reason"
        query = f"SELECT {columns}, count(*) FROM runs WHERE NOT verified GROUP BY {columns}"  # noqa: S608
        with reading(self.path) as connection:
            for method, status, reason, count in connection.execute(query):
                found.setdefault((method, status), Counter())[reason] += count
        failures = [
            Failure(method, status, reasons.most_common(1)[0][0], reasons.total())
            for (method, status), reasons in found.items()
        ]
        return tuple(sorted(failures, key=lambda each: (-each.runs, each.method, each.status)))

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Comparisons of all other methods with the first, on each source and on all sources."""
        others = [each for each in self.methods if each != self.methods[0]]
        sources = [*self.scenarios, ""] if len(self.scenarios) > 1 else self.scenarios
        found = [
            self.compare(method, self.methods[0], scenario)
            for method in others
            for scenario in sources
        ]
        return tuple(each for each in found if each is not None)

    def compare(self, method: str, base: str, scenario: str = "") -> Comparison | None:
        """Compare two methods on their common runs; None if there are none.

        Args:
            method: name of the method.
            base: name of the method to compare with.
            scenario: name of a source; all sources if not given.

        Raises:
            ValueError: there is no method or source of this name.
        """
        for field, name, known in (
            ("method", method, self.methods),
            ("base", base, self.methods),
            ("scenario", scenario or self.scenarios[0], self.scenarios),
        ):
            if name not in known:
                raise ValueError(f"{field}: got {name!r}, expected one of {', '.join(known)}")
        ones, others = self._paired(method, base, scenario)
        if not len(ones):
            return None
        columns = self._columns
        return compare(
            (scenario, method, base),
            (columns.verified[ones], columns.verified[others]),
            (columns.cost[ones], columns.cost[others]),
            (columns.duration[ones], columns.duration[others]),
            (columns.seconds[ones], columns.seconds[others]),
        )

    def seconds_of(self, method: str) -> FloatArray:
        """Return planning times of a method's M verified runs, ascending [s], shape (M,)."""
        columns, j = self._columns, self.methods.index(method)
        here = (columns.pair % len(self.methods) == j) & columns.verified
        return np.sort(columns.seconds[here])

    def cost_ratios(self, method: str, base: str) -> FloatArray:
        """Return cost ratios of a method to a base where both are verified, ascending, (M,)."""
        ones, others = self._paired(method, base, "")
        columns = self._columns
        both = columns.verified[ones] & columns.verified[others] & (columns.cost[others] > 0.0)
        return np.sort(columns.cost[ones][both] / columns.cost[others][both])

    def runs_of(self, method: str) -> int:
        """Return the number of runs of a method."""
        return int(np.sum(self._columns.pair % len(self.methods) == self.methods.index(method)))

    def to_json(self) -> dict[str, Any]:
        """Return the summary as mappings, lists and values; unknown values are None."""
        groups = [
            dataclasses.asdict(each)
            | {"rate": each.success.rate, "interval_95": list(each.success.interval)}
            for each in self.groups
        ]
        comparisons = [
            dataclasses.asdict(each)
            | {name: getattr(each, name) for name in ("p_success", "p_cost", "p_duration")}
            for each in self.comparisons
        ]
        content = {
            "study": self.study,
            "runs": self.runs,
            "groups": groups,
            "failures": [dataclasses.asdict(each) for each in self.failures],
            "comparisons": comparisons,
        }
        return {name: _without_nan(value) for name, value in content.items()}

    def __len__(self) -> int:
        return int(self.runs)

    def __str__(self) -> str:
        title = f"{self.study}: {self.runs} runs"
        return tables(title, self.groups, self.failures, self.comparisons)

    def _paired(self, method: str, base: str, scenario: str) -> tuple[IntArray, IntArray]:
        """Return indices of two methods' runs on the same scenarios and seeds, shape (M,) each."""
        columns, count = self._columns, len(self.methods)
        source, j = np.divmod(columns.pair, count)
        place = source * (columns.repetition.max(initial=0) + 1) + columns.repetition
        selected = np.full(len(place), True)
        if scenario:
            selected = source == self.scenarios.index(scenario)
        ones, others = (
            np.flatnonzero(selected & (j == self.methods.index(name))) for name in (method, base)
        )
        _, first, second = np.intersect1d(place[ones], place[others], return_indices=True)
        return ones[first], others[second]

    @cached_property
    def _columns(self) -> Columns:
        return Columns.read(self.path, self.scenarios, self.methods)


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _without_nan(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
