"""Page that shows a flight: Drake's Meshcat scene with an overlay of names, numbers and controls.

The page is Meshcat's, with another title and icon. The overlay is added at its end: a block of JSON
with all data, a style sheet and a script. Style and script are in `overlay/`; the script is one
module in several files, joined in the order of their names. The page needs no network.
"""

from __future__ import annotations

import json
from html import escape
from importlib.resources import files

from drake_rho.display.meshcat.animation import Stage, draw, start_meshcat
from drake_rho.display.viewer.payload import payload
from drake_rho.motion.flown import Flown
from drake_rho.motion.headings import Heading
from drake_rho.planning.errors import InfeasibleError
from drake_rho.scenario.arguments import checked
from drake_rho.scenario.records import Scenario

_OVERLAY = files("drake_rho.display.viewer") / "overlay"
_END = "</body>"
_IDENTIFIER = "drake-rho"
"""Identifier of the block of data in the page."""
_VIEWPORT = '<meta name="viewport" content="width=device-width, initial-scale=1">'
"""Tag that makes phones show a page at its own size, not as a shrunken wide screen."""
_HEIGHT = 600
"""Height of the frame in a notebook [px]."""


class Page(str):
    """HTML of a page, which a notebook shows in a frame."""

    def __repr__(self) -> str:
        """Return a text such as '<Page of 2.7 MB>'."""
        return f"<Page of {len(self) / 1e6:.1f} MB>"

    def _repr_html_(self) -> str:
        """Return a frame that contains the page."""
        style = f"width:100%;height:{_HEIGHT}px;border:0"
        return f'<iframe title="viewer" srcdoc="{escape(self)}" style="{style}"></iframe>'


@checked
def viewer_page(
    flown: Flown | Scenario,
    *,
    conflicts: InfeasibleError | None = None,
    rate: float | None = None,
    trails: bool | None = None,
    heading: Heading | None = None,
) -> Page:
    """Return a page that shows a plan, flight, simulation or scenario, and needs no network.

    In addition to the scene of `animate`, the page shows the time, each vehicle's speed and
    clearance, and plots of the least separation and clearance with their limits. All numbers are
    computed in Python. Names follow the vehicles. Layers, colours and the camera can be chosen.

    Args:
        flown: plan, flight or simulation to show, or a scenario before it is planned.
        conflicts: error of an infeasible scenario, as in `animate`.
        rate: seconds of flight per second of playback, as in `animate`.
        trails: whether to draw trails, as in `animate`.
        heading: headings to which vehicles are turned, as in `animate`.

    Returns:
        The page, HTML; a notebook shows it.

    Raises:
        ValueError: `rate` is not positive, or the heading is invalid.
        OSError: no port is free; Meshcat needs one during this call.
    """
    stage = Stage.of(flown, rate, conflicts, heading)
    meshcat = start_meshcat()
    draw(meshcat, stage, trails=stage.few_enough_for_trails if trails is None else trails)
    return Page(with_overlay(meshcat.StaticHtml(), payload(stage)))


def with_overlay(page: str, data: dict[str, object]) -> str:
    """Return Meshcat's page with the overlay, which shows the data."""
    head, end, after = page.rpartition(_END)
    return "".join(
        [
            head.replace(
                "<title>Drake MeshCat</title>",
                f'<title>drake_rho</title>{_VIEWPORT}<link rel="icon" href="data:,">',
                1,
            ),
            f'<script type="application/json" id="{_IDENTIFIER}">{_embedded(data)}</script>\n',
            f"<style>\n{_overlay('.css')}</style>\n",
            f'<script type="module">\n{_overlay(".js")}</script>\n',
            end,
            after,
        ]
    )


def _overlay(ending: str) -> str:
    """Return the contents of all overlay files with an ending, in the order of their names."""
    found = [each for each in _OVERLAY.iterdir() if each.name.endswith(ending)]
    return "\n".join(each.read_text("utf-8") for each in sorted(found, key=lambda each: each.name))


def _embedded(data: dict[str, object]) -> str:
    """Return data as JSON, escaped so that no text can end the script or begin a comment."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
