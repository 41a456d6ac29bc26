"""Tables of the paper's study for the terminal."""

from __future__ import annotations

import numpy as np
from rich.markup import escape
from rich.table import Table

from drake_rho.cli.console import plain_table
from drake_rho.paper.study import REPEATS, Example, Study
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import UNITS


def study_table(study: Study) -> Table:
    """Return a table with one column per example and one row per quantity.

    Clearance is the least distance from the obstacle's surface, at the knots and at every instant.
    """
    examples = study.examples
    heads = (f"Example {example.number}" for example in examples)
    table = plain_table(f"the four examples of {study.scenario.name!r}", *heads)
    table.add_row("method", *(example.method for example in examples))
    table.add_row("obstacle", *(example.obstacle for example in examples))
    table.add_row(
        f"index f {_unit('m²/s⁴')}", *(f"{example.plan.cost:.3f}" for example in examples)
    )
    for when, clearances in (
        ("at knots", [study.clearances(example) for example in examples]),
        ("at all times", [study.clearances_at_all_times(example) for example in examples]),
    ):
        for index, vehicle in enumerate(study.scenario.vehicles):
            row = (f"{values[index] + 0.0:.2f}".replace("-0.00", "0.00") for values in clearances)
            name = escape(vehicle.name)
            table.add_row(f"clearance {when}, {name} {_unit('m')}", *row)
    for quantity, name, unit in (
        ("speed", "velocities", UNITS["velocity"]),
        ("acceleration", "accelerations", UNITS["acceleration"]),
    ):
        values = [getattr(example.plan, name) for example in examples]
        lengths = (np.linalg.norm(value, axis=2) for value in values)
        table.add_row(f"largest {quantity} {_unit(unit)}", *map(_largest, lengths))
        table.add_row(f"  on one axis {_unit(unit)}", *map(_largest, values))
    bounds = (f"{example.certificate.lower_bound:.3f}" for example in examples)
    table.add_row(f"lower bound of f {_unit('m²/s⁴')}", *bounds)
    gaps = (f"{100 * max(0.0, _gap(example)):.4f}" for example in examples)
    table.add_row(f"f above the bound {_unit('%')}", *gaps)
    verdicts = ("yes" if example.report.ok else "[bold red]no[/]" for example in examples)
    table.add_row("all constraints hold", *verdicts)
    programs = (example.plan.statistics.programs for example in examples)
    table.add_row("programs solved", *map(str, programs))
    table.add_row(
        f"time, median of {REPEATS} {_unit('ms')}",
        *(f"{1e3 * example.seconds:.1f}" for example in examples),
    )
    return table


def claims_table(study: Study) -> Table:
    """Return a table of the paper's claims, the evidence, and the verdicts."""
    heads = ("", "claim of the paper, and numbers of the reproduced examples", "confirmed")
    table = plain_table(*heads, texts=3)
    table.leading = 1  # rows have several lines
    for claim in study.claims:
        verdict = "yes" if claim.found else "[bold]no[/]"
        table.add_row(str(claim.number), f"{claim.text}\n[dim]{claim.evidence}[/]", verdict)
    return table


def _gap(example: Example) -> float:
    return example.plan.cost / example.certificate.lower_bound - 1.0


def _unit(unit: str) -> str:
    return escape(f"[{unit}]")


def _largest(values: FloatArray) -> str:
    return f"{np.max(np.abs(values)):.2f}"
