"""Public missions of ground stations, planned, written, and read again by others.

FILES/missions/NAME/ holds .plan files, .waypoints files and QGC WPL 110 files with the ending .txt,
copies of the test files and examples of a public repository NAME.
"""

from __future__ import annotations

import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import pymap3d

import drake_rho as rho
from benchmarks.race import Skipped
from benchmarks.tables import Cell, Goal, Table
from drake_rho.scenario.fields import FloatArray
from tests.test_ground_stations import own_places, places_by_pymavlink

NEAR, PLANNED, SECONDS = 1e-3, 0.9, 120.0
"""Largest distance of places [m], least part that is planned, and time for a plan [s]."""

ENDINGS = {".plan": own_places, ".waypoints": places_by_pymavlink}
"""Formats to write, with readers that are not this package's."""


def run(folder: Path | None) -> Table:
    """Plan every mission, write it in both formats, and read the places again."""
    if folder is None or not (folder / "missions").is_dir():
        raise Skipped("give a folder with missions/NAME/*.plan: --files FOLDER")
    files = sorted(each for each in (folder / "missions").rglob("*") if each.is_file())
    rows, planned, broken, refused, worst = list[tuple[Cell, ...]](), 0, 0, 0, 0.0
    with tempfile.TemporaryDirectory() as made:
        for path in files:
            found, places, apart, seconds = _mission(path, Path(made))
            planned += found == "planned"
            broken += found.startswith(("broken", "no plan"))
            refused += found.startswith("refused")
            worst = max(worst, apart or 0.0)
            rows.append((path.parent.name, path.name, found, places, apart, seconds))
    return Table(
        name="clients_missions",
        title="Missions of ground stations of others",
        columns=("of", "file", "answer", "places", "written and read again [m]", "plan [s]"),
        rows=tuple(rows),
        notes=(_WORK, f"{planned} of {len(files)} planned, {refused} refused by name and reason."),
        goals=(
            Goal(
                "part of the missions that is not planned", 1.0 - PLANNED, 1 - planned / len(files)
            ),
            Goal("missions without a plan, not verified, or that fail otherwise", 0, broken),
            Goal("largest distance of a place, written and read again [m]", NEAR, worst),
        ),
        packages=("drake-rho", "drake", "numpy", "pymavlink", "pymap3d"),
    )


_WORK = f"""\
Loaded with `load_mission(path)`, at most 5 m/s unless the file says more, and 2.5 m/s²; planned in
at most {SECONDS:.0f} s and verified. Written as .plan, which a parser of the tests reads, and
as .waypoints, which pymavlink reads. The distance is the largest from a place of the scenario to
the nearest one in a file, in metres by pymap3d. Files for fixed wings count too: they are flown as
by a multicopter."""


def _mission(path: Path, made: Path) -> tuple[str, int | None, float | None, float | None]:
    """Return the answer, the number of places, their largest distance and the time of a plan."""
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rho.DrakeRhoWarning)
            scenario = rho.load_mission(path)
            plan = rho.plan(scenario, options=rho.Options(time_limit=SECONDS))
            seconds = time.perf_counter() - began
            if not rho.verify(plan).ok:
                return "broken: not verified", None, None, seconds
    except rho.ScenarioError as error:
        said = str(error).replace(f"{path}", path.name)
        one = "\n" not in said and said.startswith(path.name)
        return ("refused: " if one else "broken: ") + said[:220], None, None, None
    except (rho.InfeasibleError, rho.OutOfTimeError) as error:
        return f"no plan: {error}"[:220], None, None, None
    except Exception as error:
        return f"broken: {type(error).__name__}: {error}"[:220], None, None, None
    places = _places(scenario)
    apart = max(_apart(plan, places, made / f"m{ending}") for ending in ENDINGS)
    return "planned", len(places), apart, seconds


def _places(scenario: rho.Scenario) -> FloatArray:
    """Return the places of waypoints and of the goal, shape (P, 3)."""
    (vehicle,) = scenario.vehicles
    ends = [each.position for each in (*vehicle.waypoints, vehicle.goal)]
    return np.array([each for each in ends if each is not None], dtype=float)


def _apart(plan: rho.Plan, places: FloatArray, file: Path) -> float:
    """Return the largest distance of a place from those of a file, read by others [m]."""
    rho.export(plan, file)
    frame = plan.scenario.frame
    assert frame is not None  # noqa: S101  # of a mission
    home = frame.latitude, frame.longitude, frame.altitude
    local = np.stack(pymap3d.geodetic2enu(*ENDINGS[file.suffix](file).T, *home), axis=-1)
    return float(np.linalg.norm(places[:, None] - local, axis=-1).min(axis=1).max())
