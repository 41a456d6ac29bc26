"""Damaged files of ground stations, shows and trajectories: what the command line says."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import drake_rho as rho
from benchmarks.damage import OF_BYTES, OF_TEXT, Damage
from benchmarks.damaged_files import table_of
from benchmarks.file_kinds import Kind, scenario
from benchmarks.tables import Table

_WPL = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.3977\t8.5456\t488\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.3977\t8.5456\t15\t1
2\t0\t3\t16\t2\t0\t0\t0\t47.3980\t8.5463\t20\t1
3\t0\t2\t178\t1\t3\t-1\t0\t0\t0\t0\t1
4\t0\t3\t20\t0\t0\t0\t0\t0\t0\t0\t1
"""


def run(files: int) -> Table:
    """Return a table of the answers to damaged files, a row for each kind."""
    return table_of(files, "clients_damaged", "Damaged files of other programs", kinds)


def kinds(folder: Path) -> list[Kind]:
    """Return a valid file of each kind."""
    plan = rho.plan(scenario(folder))
    judged = ("verify", "{}", "--scenario", "scenario.yaml")
    sampled = (*judged, "--max-acceleration", "5")
    found = [Kind("mission (.waypoints)", ".waypoints", _WPL.encode(), ("read", "{}"), OF_TEXT)]
    (folder / "given.waypoints").write_text(_WPL)
    mission = rho.plan(rho.load_mission(folder / "given.waypoints"))
    rho.export(mission, folder / "given.plan")
    content = (folder / "given.plan").read_bytes()
    found.append(Kind("mission (.plan)", ".plan", content, ("read", "{}"), OF_TEXT))
    rho.export(plan, folder / "given.skyc")
    content = (folder / "given.skyc").read_bytes()
    inside = tuple(_inside(each) for each in OF_TEXT)
    found.append(Kind("show (.skyc)", ".skyc", content, judged, (*OF_BYTES, *inside)))
    one = _alone(folder)
    rho.export(plan, folder / "polynomials", format="crazyswarm")
    content = (folder / "polynomials" / "scout.csv").read_bytes()
    found.append(Kind("polynomials (Crazyswarm)", ".csv", content, (*judged[:3], one), OF_TEXT))
    rho.export(plan, folder / "samples.csv", format="csv", rate=20)
    content = (folder / "samples.csv").read_bytes()
    found.append(Kind("samples (.csv)", ".csv", content, sampled, OF_TEXT))
    return found


def _alone(folder: Path) -> str:
    """Write the scenario of the first vehicle alone, and return its name."""
    whole = scenario(folder)
    path = folder / "alone.yaml"
    alone = rho.Scenario(
        "alone", whole.grid, whole.vehicles[:1], whole.limits, obstacles=whole.obstacles
    )
    rho.save_scenario(alone, path)
    return path.name


def _inside(damage: Damage) -> Callable[[bytes, np.random.Generator], bytes]:
    """Return a damage of one member of an archive."""

    def damaged(content: bytes, rng: np.random.Generator) -> bytes:
        made = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w", 8) as new:
            chosen = rng.integers(len(old.namelist()))
            for number, name in enumerate(old.namelist()):
                member = old.read(name)
                new.writestr(name, damage(member, rng) if number == chosen and member else member)
        return made.getvalue()

    return damaged
