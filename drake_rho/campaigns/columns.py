"""Columns of a store for the summary of results."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np

from drake_rho.campaigns.store import StoreError, reading
from drake_rho.scenario.errors import shorten, shortened
from drake_rho.scenario.fields import BoolArray, FloatArray, IntArray


@dataclasses.dataclass(frozen=True, eq=False)
class Columns:
    """Columns for the summary, run by run, each of shape (M,)."""

    pair: IntArray
    """index of the source times the number of methods, plus index of the method"""
    repetition: IntArray
    """number of the repetition"""
    verified: BoolArray
    """true where the plan satisfies every constraint"""
    cost: FloatArray
    """cost of the plan [m²/s⁴]; NaN without a plan"""
    duration: FloatArray
    """time from the first knot to the last [s]; NaN without a plan"""
    seconds: FloatArray
    """wall time of planning [s]; NaN without a plan"""

    @classmethod
    def read(cls, path: Path, scenarios: Sequence[str], methods: Sequence[str]) -> Self:
        """Return the columns of a store.

        Args:
            path: path of the store.
            scenarios: names of the sources of scenarios.
            methods: names of the methods.

        Raises:
            StoreError: a run is of another source or method.
        """
        source_of = {name: number for number, name in enumerate(scenarios)}
        method_of = {name: number for number, name in enumerate(methods)}
        names = "scenario, method, repetition, verified, cost, duration, plan_seconds"
        with reading(path) as connection:
            rows = connection.execute(f"SELECT {names} FROM runs").fetchall()  # noqa: S608
        for scenario, method, *_ in rows:
            if scenario not in source_of or method not in method_of:
                run = f"a run of {shorten(method)} on {shorten(scenario)}"
                expected = shortened(f"runs of {', '.join(methods)} on {', '.join(scenarios)}")
                raise StoreError(f"{path}: got {run}, expected {expected}")
        table = np.array(
            [
                (
                    source_of[scenario] * len(methods) + method_of[method],
                    repetition,
                    verified,
                    *(math.nan if value is None else value for value in values),
                )
                for scenario, method, repetition, verified, *values in rows
            ],
            dtype=np.float64,
        ).reshape(-1, 6)
        pair, repetition, verified, *values = table.T
        return cls(pair.astype(np.int64), repetition.astype(np.int64), verified > 0.0, *values)
