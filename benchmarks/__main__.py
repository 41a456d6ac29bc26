"""`python -m benchmarks [name ...]`: run benchmarks and write their tables."""

from __future__ import annotations

import argparse
from importlib import import_module
from importlib.util import find_spec

from rich.console import Console
from rich.markdown import Markdown

from benchmarks.tables import Table, to_markdown, write

RACES = ("example_4", "converged")
"""Those that run every implementation in rounds: `run(repetitions) -> Table`."""

STUDIES = ("growth", "import_time")
"""The others: `run() -> Table`."""


def main() -> None:
    """Run the benchmarks named on the command line, by default all there are."""
    known = [name for name in RACES + STUDIES if find_spec(f"benchmarks.{name}")]
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="name", help=f"of {', '.join(known)}")
    parser.add_argument("--repetitions", type=int, default=9, help="rounds of a race (9)")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.names if name not in known]
    if unknown:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(known)}")
    if arguments.repetitions < 5:
        parser.error("--repetitions: at least 5, for a median that means something")
    console = Console()
    for name in arguments.names or known:
        console.rule(name)
        table = _run(name, arguments.repetitions)
        written = write(table)
        console.print(Markdown(to_markdown(table)))
        console.print("written:", *(path.name for path in written))


def _run(name: str, repetitions: int) -> Table:
    run = import_module(f"benchmarks.{name}").run
    table: Table = run(repetitions) if name in RACES else run()
    return table


if __name__ == "__main__":
    main()
