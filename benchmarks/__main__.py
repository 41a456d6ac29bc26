"""`python -m benchmarks [name ...]`: run benchmarks and write their tables."""

from __future__ import annotations

import argparse
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from benchmarks.against import COMMIT
from benchmarks.race import Skipped
from benchmarks.tables import Table, load, to_markdown, write

RACES = ("example_4", "converged", "five_spheres", "mpc")
"""Benchmarks that run every implementation in rounds: `run(repetitions) -> Table`."""

STUDIES = ("growth", "import_time", "certificates")
"""Other benchmarks without fleets: `run() -> Table`."""

EARLIER = ("against",)
"""Benchmarks beside an earlier version: `run(repetitions, commit, folder) -> Table`."""

DRAWN = {
    "fleet_b1": 50,
    "fleet_joint": 5,
    "smoothing_b1": 6,
    "fleet_b2": 10,
    "world_b7": 20,
    "world_b8": 50,
    "known_motions": 500,
    "world_boundary": 20,
    "world_gaps": 20,
    "world_longer": 200,
    "links_cvxpy": 50,
    "links_chains": 50,
    "links_formation": 5,
    "links_corridors": 20,
    "time_fleets": 12,
    "time_gates": 20,
    "time_known": 300,
    "flight_late": 2300,
    "flight_windy_rooms": 200,
    "objective_convex": 60,
    "objective_obstacles": 60,
    "objective_goals": 60,
    "objective_mixed": 1000,
    "online_missions": 300,
    "online_horizons": 2,
    "online_circle": 20,
    "online_fleets": 4,
    "mixed_scenes": 5000,
    "mixed_windows": 1200,
    "damaged_files": 4000,
    "show_random": 20,
    "show_room": 20,
    "bound_fleets": 12,
    "bound_shapes": 200,
    "bound_referee": 50,
    "clients_bags": 1000,
    "clients_pieces": 100_000,
    "clients_damaged": 2000,
}
"""Benchmarks of random fleets, worlds, links, flights, files, and how many:
`run(seeds) -> Table`."""

MISSIONS = (
    "fleet_b3",
    "world_b6",
    "map_forests",
    "map_office",
    "time_bisection",
    "time_bounds",
    "online_forests",
)
"""Benchmarks of missions in files: `run(folder) -> Table`."""

FILES = ("clients_worlds", "clients_missions", "clients_players", "map_building")
"""Benchmarks of public files beside this repository: `run(folder) -> Table`."""

SCALE = ("scale_campaigns", "scale_fleets", "fleet_growth")
"""Benchmarks of many runs: `run() -> Table`."""

SWAPS = ("fleet_b4", "fleet_b5")
"""Benchmarks of given fleets: `run() -> Table`."""

FLIGHT = (
    "flight_worst_case",
    "flight_oracle",
    "flight_radius",
    "flight_cost",
    "flight_window",
    "flight_closed_loop",
    "flight_loops",
    "flight_late",
    "flight_clocks",
    "flight_quadrotor",
    "flight_windy_rooms",
)
"""Benchmarks of wind, feedback, margins and windows; those in no `DRAWN` are `run() -> Table`."""

FLOWN_MISSIONS = ("flight_crazyflow",)
"""Benchmarks of flown missions in files: `run(folder) -> Table`."""

CAMPAIGNS = ("fleet_b1", "fleet_b2", "fleet_b3", "world_b6", "world_b7", "world_b8")
"""Benchmarks that are campaigns, whose stores may be kept: `run(..., stores) -> Table`."""

WORLDS = (
    "world_b6",
    "world_b7",
    "world_b8",
    "world_boundary",
    "world_gaps",
    "world_longer",
    "known_motions",
)
"""Benchmarks of worlds with obstacles."""

OPEN = ("links_cvxpy", "links_corridors", "links_chains", "links_formation")
"""Benchmarks of what a scenario's requirements may keep in any convex set."""


MAPS = ("map_forests", "map_office", "map_building", "map_meshes", "map_points")
"""Benchmarks of maps; those that are in no `MISSIONS` need no folder: `run() -> Table`."""

TIMES = (
    "time_tracks",
    "time_closed_forms",
    "time_ruckig",
    "time_known",
    "time_fleets",
    "time_gates",
    "time_bisection",
    "time_bounds",
)
"""Benchmarks of least times; those that are in no `DRAWN` or `MISSIONS` are `run() -> Table`."""


OBJECTIVE = (
    "objective_convex",
    "objective_known",
    "objective_obstacles",
    "objective_goals",
    "time_gates",
    "objective_mixed",
)
"""Benchmarks of costs, goals and gates; those that are in no `DRAWN` are `run() -> Table`."""


ONLINE = (*(each for each in DRAWN if each.startswith("online_")), "online_forests")
"""Benchmarks of missions in which more becomes known in flight."""


CLIENTS = tuple(each for each in (*FILES, *DRAWN) if each.startswith("clients_"))
"""Benchmarks of files that other programs write or read, and of trajectories of any planner."""


SHOWS = ("show_random", "show_room", "show_large", "show_thousands")
"""Benchmarks of shows."""


BOUNDS = tuple(each for each in DRAWN if each.startswith("bound_"))
"""Benchmarks of global optima."""


MIXED = ("mixed_scenes", "mixed_windows", "damaged_files")
"""Benchmarks of random scenes, flights and files that mix everything."""


GROUPS: dict[str, tuple[tuple[str, ...], str]] = {
    "worlds": (WORLDS, "all benchmarks of worlds"),
    "flight": (FLIGHT + FLOWN_MISSIONS, "all benchmarks of wind and margins"),
    "scale": (SCALE, "benchmarks of large fleets and campaigns"),
    "open": (OPEN, "all benchmarks of requirements"),
    "maps": (MAPS, "all benchmarks of maps"),
    "times": (TIMES, "all benchmarks of least times"),
    "objective": (OBJECTIVE, "all benchmarks of costs"),
    "online": (ONLINE, "all benchmarks of missions online"),
    "clients": (CLIENTS, "benchmarks of other programs' files"),
    "shows": (SHOWS, "benchmarks of shows"),
    "bounds": (BOUNDS, "benchmarks of global optima"),
    "mixed": (MIXED, "benchmarks that mix everything"),
}
"""Groups of benchmarks by their options, each with the option's help."""

ALONE = RACES + STUDIES
"""Benchmarks that run by default."""

KNOWN = tuple(
    name
    for name in dict.fromkeys(
        (
            *(*ALONE, *EARLIER, *DRAWN, *MISSIONS, *SWAPS),
            *(each for names, _ in GROUPS.values() for each in names),
        )
    )
    if find_spec(f"benchmarks.{name}")
)
"""All benchmarks."""


def main() -> None:
    """Run the benchmarks named on the command line, by default the races and studies."""
    arguments, console = _arguments(), Console()
    for name in arguments.names or _chosen(arguments) or ALONE:
        console.rule(name)
        before = load()
        try:
            table = _run(name, arguments)
        except Skipped as reason:
            console.print(f"skipped: {reason}")
            continue
        written = write(table, before)
        console.print(Markdown(to_markdown(table, before, console.width)))
        console.print("written:", *(path.name for path in written))


def _arguments() -> argparse.Namespace:
    """Return the arguments of the command line; exit with a message if one is wrong."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    add = parser.add_argument
    add("names", nargs="*", metavar="name", help=f"one of {', '.join(KNOWN)}")
    add("--fleets", action="store_true", help="all benchmarks of fleets")
    for group, (_, words) in GROUPS.items():
        add(f"--{group}", action="store_true", help=words)
    add("--repetitions", type=int, default=31, help="rounds of a race (31)")
    words = f"earlier version of against ({COMMIT})"
    add("--against", metavar="COMMIT", default=COMMIT, help=words)
    add("--seeds", type=int, help="number of random fleets or worlds of each size")
    words = "folder with missions of the LSC planner, or of LSC-DR"
    add("--missions", type=Path, help=words)
    words = f"folder of public files for {', '.join(FILES)}, as they tell"
    add("--files", type=Path, help=words)
    words = f"folder in which {', '.join(CAMPAIGNS)} store their runs, to resume if interrupted"
    add("--stores", type=Path, help=words)
    arguments = parser.parse_args()
    unknown = [name for name in arguments.names if name not in KNOWN]
    if unknown:
        parser.error(f"names: got {', '.join(unknown)}, expected some of {', '.join(KNOWN)}")
    if arguments.repetitions < 5:
        parser.error("--repetitions: expected at least 5, for a meaningful median")
    if arguments.seeds is not None and arguments.seeds < 1:
        parser.error("--seeds: expected at least 1")
    return arguments


def _chosen(arguments: argparse.Namespace) -> tuple[str, ...]:
    """Return the benchmarks of the groups that are asked for; fleets are those in no other."""
    grouped = {each for names, _ in GROUPS.values() for each in names}
    fleets = tuple(each for each in KNOWN if each not in {*grouped, *ALONE, *EARLIER})
    chosen = fleets if arguments.fleets else ()
    for group, (names, _) in GROUPS.items():
        chosen += names if getattr(arguments, group) else ()
    return chosen


def _run(name: str, arguments: argparse.Namespace) -> Table:
    run = import_module(f"benchmarks.{name}").run
    if name in CAMPAIGNS:
        run = partial(run, stores=arguments.stores)
    table: Table
    if name in RACES:
        table = run(arguments.repetitions)
    elif name in EARLIER:
        table = run(arguments.repetitions, arguments.against, arguments.missions)
    elif name in DRAWN:
        table = run(arguments.seeds or DRAWN[name])
    elif name in MISSIONS + FLOWN_MISSIONS:
        table = run(arguments.missions)
    elif name in FILES:
        table = run(arguments.files)
    else:
        table = run()
    return table


if __name__ == "__main__":
    main()
