"""Exports replayed by the programs that fly them: Skybrush's player, the Crazyflie's evaluator.

FILES holds copies of two public repositories, whose licences do not let them be part of this one:

- `skybrush/` of skybrush-server, with `src/flockwave/server/show/player.py`;
- `firmware/` of crazyflie-firmware, with `src/modules/src/pptraj.c`, compiled here with `cc`.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import drake_rho as rho
from benchmarks.race import Skipped
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray
from tests.test_export import rough

NEAR = 1e-3
"""Largest distance from the plan [m]."""

RANDOM = 200
"""Number of random plans of each kind."""

_MAIN = r"""
#include <stdio.h>
#include "pptraj.h"
int main(void) {
  static struct poly4d pieces[64];
  struct piecewise_traj all = {0};
  int count, times;
  float t;
  if (scanf("%d %d", &count, &times) != 2 || count > 64) return 1;
  for (int i = 0; i < count; i++) {
    if (scanf("%f", &pieces[i].duration) != 1) return 1;
    for (int k = 0; k < 32; k++)
      if (scanf("%f", &pieces[i].p[k / 8][k % 8]) != 1) return 1;
  }
  all.timescale = 1.0f;
  all.n_pieces = count;
  all.pieces = pieces;
  for (int i = 0; i < times; i++) {
    if (scanf("%f", &t) != 1) return 1;
    struct traj_eval at = piecewise_eval(&all, t);
    printf("%.9g %.9g %.9g\n", at.pos.x, at.pos.y, at.pos.z);
  }
  return 0;
}
"""


def run(folder: Path | None) -> Table:
    """Replay exports at every millisecond, and return the largest distances from the plans."""
    if folder is None or not folder.is_dir():
        raise Skipped("give a folder with skybrush/ and firmware/: --files FOLDER")
    rows, most = list[tuple[Cell, ...]](), list[float]()
    with tempfile.TemporaryDirectory() as made:
        players = {
            "skyc": _skybrush(folder / "skybrush", Path(made)),
            "crazyswarm": _firmware(folder / "firmware", Path(made)),
        }
        for format, replay in players.items():
            if replay is None:
                rows.append((format, "its program is not in the folder", None, None, None))
                continue
            for name, plans in _plans().items():
                found = [_replayed(plan, format, replay) for plan in plans]
                reported, apart = (float(max(each)) for each in zip(*found, strict=True))
                rows.append((format, name, len(plans), reported, apart))
                most.append(apart)
    return Table(
        name="clients_players",
        title="Exports replayed by the programs that fly them",
        columns=("format", "plans", "number", "reported [m]", "replayed [m]"),
        rows=tuple(rows),
        notes=(_WORK,),
        goals=(Goal("largest distance from the plan [m]", NEAR, max(most) if most else None),),
    )


_WORK = """\
Every vehicle at every millisecond, or at 20 000 times where that is fewer; the distance is that
from `plan.at`. skyc: skybrush-server's own trajectory player, in Python. crazyswarm:
`piecewise_eval` of the Crazyflie's firmware in single precision, compiled for this machine. Random
plans have 30 steps of 0.1 to 0.5 s, so that a step is a piece, within some tens of metres."""


def _plans() -> dict[str, list[rho.Plan]]:
    rng = np.random.default_rng(50)
    shorter = [
        rough(steps=30, step=int(rng.integers(100, 501)) / 1000.0, seed=k) for k in range(RANDOM)
    ]
    return {
        "courier": [rho.plan(rho.load_scenario("courier"))],
        "eight change sides of a circle": [
            rho.plan(rho.circle_swap(8, radius=2.0, duration=10.0, step=0.2))
        ],
        "Example 4 of the paper": [rho.plan_rho(rho.load_scenario("paper")).plan],
        "random": shorter,
    }


def _replayed(plan: rho.Plan, format: str, replay: Any) -> tuple[float, float]:
    """Return the deviation that the export reports, and that of its replay [m]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("show.skyc" if format == "skyc" else "swarm")
        written = rho.export(plan, path, format=format)
        last = int(1000.0 * (plan.times[-1] - plan.times[0]))
        ticks = np.unique(np.linspace(0, last, min(last + 1, 20_000)).astype(int))
        expected = plan.sampled(ticks / 1000.0).positions
        found = replay(path, ticks / 1000.0)
    return written.deviation, float(np.linalg.norm(found - expected, axis=2).max())


def _skybrush(folder: Path, made: Path) -> Any:
    """Return a function that replays a show by the player of skybrush-server, if it is there."""
    del made
    source = folder / "src" / "flockwave" / "server" / "show"
    if not (source / "player.py").is_file():
        return None
    for name in ("flockwave", "flockwave.server", "flockwave.server.show"):
        package = ModuleType(name)
        package.__path__ = [str(source)] if name.endswith("show") else []
        sys.modules[name] = package
    given: dict[str, dict[str, Any]] = {  # what its modules import, and playing does not need
        "pyledctrl": {"__path__": []},
        "pyledctrl.player": {"Player": object},
        "crcmod": {"mkCrcFun": lambda *args, **named: None},
        "flockwave.server.utils": {"constant": lambda value: lambda *args: value},
    }
    for name, content in given.items():
        vars(sys.modules.setdefault(name, ModuleType(name))).update(content)
    player = importlib.import_module("flockwave.server.show.player")
    trajectory = importlib.import_module("flockwave.server.show.trajectory")

    def replay(path: Path, times: FloatArray) -> FloatArray:
        found = []
        with zipfile.ZipFile(path) as archive:
            drones = json.loads(archive.read("show.json"))["swarm"]["drones"]
            for each in drones:
                link = each["settings"]["trajectory"]["$ref"]
                content = json.loads(archive.read(link.removeprefix("./").removesuffix("#")))
                playing = player.TrajectoryPlayer(trajectory.TrajectorySpecification(content))
                begin = content.get("takeoffTime", 0.0)
                found.append([playing.position_at(begin + time) for time in times])
        return np.array(found)

    return replay


def _firmware(folder: Path, made: Path) -> Any:
    """Return a function that evaluates polynomials as a Crazyflie does, if its source is there."""
    source = folder / "src" / "modules"
    if not (source / "src" / "pptraj.c").is_file():
        return None
    (made / "main.c").write_text(_MAIN)
    files = [str(made / "main.c"), str(source / "src" / "pptraj.c")]
    command = ["cc", "-O2", "-I", str(source / "interface"), *files, "-lm", "-o", str(made / "fly")]
    subprocess.run(command, check=True, capture_output=True)  # noqa: S603  # as the user asked

    def replay(path: Path, times: FloatArray) -> FloatArray:
        found = []
        for file in sorted(path.iterdir()):
            _, *lines = file.read_text().splitlines()
            numbers = " ".join(line.replace(",", " ") for line in lines)
            given = f"{len(lines)} {len(times)} {numbers} {' '.join(map(repr, times.tolist()))}"
            ran = subprocess.run(  # noqa: S603
                [str(made / "fly")], input=given, capture_output=True, text=True, check=True
            )
            found.append(np.array(ran.stdout.split(), dtype=float).reshape(-1, 3))
        return np.array(found)

    return replay
