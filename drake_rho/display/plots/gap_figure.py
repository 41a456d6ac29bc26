"""Figure of a certificate's gap as branch and bound closes it."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from drake_rho.analysis.certificate import Certificate
from drake_rho.display.plots.formats import DOUBLE_COLUMN, check_width
from drake_rho.display.plots.legends import add_below
from drake_rho.display.plots.publish import styled
from drake_rho.scenario.arguments import checked

_HEIGHT = 0.4
"""Height over width."""
_SHADE = 0.15
"""Opacity of the area between bound and cost."""


@checked
@styled
def gap_figure(certificate: Certificate, *, width: float = DOUBLE_COLUMN) -> Figure:
    """Plot the lower bound and the cost of the best plan over the number of branches.

    Args:
        certificate: of `plan_global`, or of `certify` with a gap.
        width: width of the figure [in].

    Raises:
        ValueError: the bound is without branches, or the text would be illegible at the width.
    """
    if not certificate.history:
        raise ValueError("certificate: got a bound without branches, expected some")
    branches, bounds, costs = np.transpose(certificate.history)
    figure = Figure(figsize=(check_width(width), _HEIGHT * width), layout="constrained")
    ax = figure.add_subplot()
    ax.step(branches, costs, where="post", label="best plan")
    ax.step(branches, bounds, where="post", label="lower bound")
    ax.fill_between(branches, bounds, costs, step="post", alpha=_SHADE, linewidth=0.0)
    ax.set(xlabel="branches", ylabel="cost [m²/s⁴]", xlim=(0.0, None))
    add_below(figure, ax.get_legend_handles_labels()[0])
    return figure
