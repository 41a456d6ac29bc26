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

RATES = {"fleet": 1.5, "viewer": 6.0, "forest": 1.5}
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


def forest() -> rho.Plan:
    """Return what twenty vehicles fly that plan for themselves, by the code of the gallery."""
    page = Path(__file__).parents[1] / "docs" / "gallery.md"
    below = r"figures/forest\.gif\).*?^```python\n(.*?)^```"
    found = re.search(below, page.read_text(), re.DOTALL | re.MULTILINE)
    assert found
    left: dict[str, Any] = {}
    exec(compile(found[1], page.name, "exec"), left)  # noqa: S102  # the code is that of the page
    plan: rho.Plan = left["flown"].plan
    return plan


def main(folder: Path) -> None:
    """Draw films of a fleet and a forest, and of Example 4 a still and a film."""
    plan = rho.plan(fleet())
    assert rho.verify(plan).ok
    footage = Footage.of(plan.scenario.grid.duration, ".gif", RATES["fleet"])
    write_film(rho.viewer_page(plan), folder / "fleet.gif", footage)
    plan = forest()
    assert rho.verify(plan).ok
    footage = Footage.of(plan.scenario.grid.duration, ".gif", RATES["forest"])
    write_film(rho.viewer_page(plan), folder / "forest.gif", footage)
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
