"""Take the README's pictures, still and moving: `python -m tests.screenshot FOLDER`."""

import sys
import tempfile
from pathlib import Path

import drake_rho as rho
from drake_rho.display.viewer.film import Footage, write_film
from tests.browser import open_page

RATE = 6.0
"""Seconds of flight in a second of the moving picture."""


def main(folder: Path) -> None:
    """Draw Example 4: a still next to the obstacle, and a film from start to goal."""
    flight = rho.plan_rho(rho.load_scenario("paper"))
    html = rho.viewer_page(flight)
    with tempfile.TemporaryDirectory() as scratch, open_page() as (page, _):
        file = Path(scratch) / "page.html"
        file.write_text(html)
        page.goto(file.as_uri())
        page.wait_for_function("window.drakeRho")
        page.evaluate("drakeRho.frame(22, 1)")
        page.screenshot(path=folder / "meshcat.png")
    footage = Footage.of(flight.scenario.grid.duration, ".gif", RATE)
    write_film(html, folder / "viewer.gif", footage)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
