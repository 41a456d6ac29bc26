"""Option for the headings of vehicles, which `export`, `simulate` and `show` share."""

from __future__ import annotations

from typing import Annotated

import typer

from drake_rho.motion.headings import Direction, Heading, direction_of

HeadingOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="[NAME=]HEADING",
        help="velocity, an angle from the x axis, anticlockwise, in radians, or a point X,Y,Z to "
        "look at; with NAME=, repeatable, that of one vehicle. By default along the x axis; shown "
        "vehicles fly nose first.",
    ),
]


def heading_of(words: list[str] | None) -> Heading | None:
    """Return the heading that options describe: one for all, or one of each named vehicle.

    None stands for no option.

    Raises:
        ValueError: there are several for all vehicles, or for one, or one is invalid.
    """
    given = [each.rpartition("=") for each in words or []]
    names = [name for name, _, _ in given]
    if len(set(names)) < len(names) or ("" in names and len(names) > 1):
        expected = "one, or one NAME=HEADING for each of some vehicles"
        raise ValueError(f"--heading: got {' and '.join(words or [])}, expected {expected}")
    found = {name: _direction_of(text) for name, _, text in given}
    return found.get("", found or None)


def _direction_of(text: str) -> Direction:
    """Return the direction that a text describes.

    Raises:
        ValueError: it describes none.
    """
    try:
        numbers = [float(each) for each in text.split(",")]
    except ValueError:
        return direction_of(text)  # type: ignore[arg-type]  # a word, valid or not
    return direction_of(numbers[0] if len(numbers) == 1 else numbers)
