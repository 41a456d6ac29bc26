"""Display of scenarios, plans, flights and simulations in notebooks: a sentence and a figure."""

from __future__ import annotations

import base64
import io
from html import escape

from drake_rho.display.plots.path_figure import paths_figure
from drake_rho.motion.flown import Flown
from drake_rho.motion.plan import summary
from drake_rho.scenario.records import Scenario

_DPI = 110.0
"""Resolution of the figure [dots per inch]."""


def html_of(record: Flown | Scenario) -> str:
    """Return the HTML of a record for a notebook."""
    words = f"Scenario {summary(record)}" if isinstance(record, Scenario) else repr(record)[1:-1]
    file = io.BytesIO()
    paths_figure(record).savefig(file, format="png", dpi=_DPI)
    picture = base64.b64encode(file.getvalue()).decode()
    return (
        f"<div>{escape(words)}</div>"
        f'<img style="max-width:100%" alt="paths in space" src="data:image/png;base64,{picture}">'
    )
