"""Take the README's picture of the swarm: `python -m tests.screenshot FILE`."""

import sys

import drake_rho as rho
from tests.browser import open_page


def main(path: str) -> None:
    """Example 4 in Meshcat, when the vehicles are at the obstacle."""
    meshcat = rho.animate(rho.plan_rho(rho.load_scenario("paper")))
    with open_page() as (page, _):
        page.goto(meshcat.web_url())
        page.wait_for_function("typeof viewer !== 'undefined' && viewer.animator.duration > 0")
        page.evaluate("viewer.animator.pause(); viewer.animator.seek(29.0)")
        page.evaluate("document.querySelectorAll('.lil-gui, .dg').forEach(e => e.remove())")
        page.wait_for_timeout(1000)
        page.screenshot(path=path, clip={"x": 230, "y": 110, "width": 800, "height": 680})


if __name__ == "__main__":
    main(sys.argv[1])
