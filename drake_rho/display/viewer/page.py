"""One page that shows a flight: Drake's Meshcat scene, and over it names, numbers and controls.

The page is Meshcat's own but for title and icon, with three things at its end: a block of JSON with
all that the overlay says, its style, and its script. These are in `overlay/`; the script is one
module in several files, which are joined in the order of their names. It needs no network.
"""

from __future__ import annotations

import json
from importlib.resources import files

from drake_rho.display.meshcat.animation import Stage, draw, start_meshcat
from drake_rho.display.viewer.payload import told
from drake_rho.motion.flown import Flown
from drake_rho.scenario.arguments import checked

_OVERLAY = files("drake_rho.display.viewer") / "overlay"
_END = "</body>"
_IDENTIFIER = "drake-rho"
"""Of the block of data in the page."""


@checked
def viewer_page(flown: Flown, *, rate: float | None = None, trails: bool | None = None) -> str:
    """Return a plan, a flight or a simulation as one page that opens from disk, without a network.

    Over the scene of `animate` stand time, speed and clearance of every vehicle, and the least
    separation and clearance beside their limits over time, in numbers that Python computed. Names
    follow the vehicles. What is shown, in which colours and from where can be chosen.

    Args:
        flown: what to show.
        rate: seconds of flight in a second of playback, as in `animate`.
        trails: whether to draw them, as in `animate`.

    Returns:
        The page, HTML.

    Raises:
        ValueError: `rate` is not positive.
        OSError: no port is free; Meshcat needs one for as long as this takes.
    """
    stage = Stage.of(flown, rate)
    meshcat = start_meshcat()
    draw(meshcat, stage, trails=stage.few_enough_for_trails if trails is None else trails)
    return with_overlay(meshcat.StaticHtml(), told(stage))


def with_overlay(page: str, data: dict[str, object]) -> str:
    """Meshcat's page with the overlay in it, which says what the data hold."""
    head, end, tail = page.rpartition(_END)
    return "".join(
        [
            head.replace(
                "<title>Drake MeshCat</title>",
                '<title>drake_rho</title><link rel="icon" href="data:,">',
                1,
            ),
            f'<script type="application/json" id="{_IDENTIFIER}">{_embedded(data)}</script>\n',
            f"<style>\n{_overlay('.css')}</style>\n",
            f'<script type="module">\n{_overlay(".js")}</script>\n',
            end,
            tail,
        ]
    )


def _overlay(ending: str) -> str:
    """Return the contents of all overlay files with an ending, in the order of their names."""
    found = [each for each in _OVERLAY.iterdir() if each.name.endswith(ending)]
    return "\n".join(each.read_text("utf-8") for each in sorted(found, key=lambda each: each.name))


def _embedded(data: dict[str, object]) -> str:
    """JSON that ends no script and begins no comment, whatever its texts hold."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
