"""Take the README's pictures, still and moving: `python -m tests.screenshot FOLDER`."""

import dataclasses
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import drake_rho as rho
from drake_rho.display.viewer.film import Footage, write_film
from tests.browser import open_page

RATES = {"fleet": 1.5, "viewer": 6.0, "forest": 1.5, "show": 4.0}
"""Seconds of flight in a second of each moving picture."""


def fleet() -> rho.Scenario:
    """Return ten quadrotors on a circle that change places between four pillars."""
    swap = rho.circle_swap(
        10,
        radius=5.0,
        duration=9.0,
        step=0.15,
        height=2.0,
        limits=rho.Limits(position=rho.Box([-7, -7, 0.3], [7, 7, 4.5]), max_acceleration=6.0),
        separation=rho.Separation(0.7, downwash=1.5),
        name="Ten quadrotors change places",
    )
    vehicles = tuple(dataclasses.replace(each, radius=0.25) for each in swap.vehicles)
    pillars = tuple(
        rho.Cylinder([2.2 * np.cos(angle), 2.2 * np.sin(angle), 2.25], 0.45, 4.5)
        for angle in np.radians([20, 110, 200, 290])
    )
    return dataclasses.replace(swap, vehicles=vehicles, obstacles=pillars)


def in_gallery(film: str) -> dict[str, Any]:
    """Return the variables of the gallery's code below a film."""
    page = Path(__file__).parents[1] / "docs" / "gallery.md"
    below = rf"figures/{film}\.gif\).*?^```python\n(.*?)^```"
    found = re.search(below, page.read_text(), re.DOTALL | re.MULTILINE)
    assert found
    variables: dict[str, Any] = {}
    exec(compile(found[1], page.name, "exec"), variables)  # noqa: S102  # of the page
    return variables


def main(folder: Path) -> None:
    """Draw films of a fleet, a forest and a show, and of Example 4 a still and a film."""
    plans = {
        "fleet": rho.plan(fleet()),
        "forest": in_gallery("forest")["flown"].plan,
        "show": in_gallery("show")["plan"],
    }
    for name, plan in plans.items():
        assert rho.verify(plan).ok
        footage = Footage.of(plan.scenario.grid.duration, ".gif", RATES[name])
        write_film(rho.viewer_page(plan), folder / f"{name}.gif", footage)
    flight = rho.plan_rho(rho.load_scenario("paper"))
    html = rho.viewer_page(flight)
    with tempfile.TemporaryDirectory() as scratch, open_page() as (page, _):
        file = Path(scratch) / "page.html"
        file.write_text(html)
        page.goto(file.as_uri())
        page.wait_for_function("window.drakeRho")
        page.evaluate("drakeRho.frame(22, 1)")
        page.screenshot(path=folder / "meshcat.png")
    footage = Footage.of(flight.scenario.grid.duration, ".gif", RATES["viewer"])
    write_film(html, folder / "viewer.gif", footage)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
