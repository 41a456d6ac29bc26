"""The largest speed, judged at the knots, which are enough for every instant."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drake_rho.assurance.report import UNITS, Column
from drake_rho.motion.dynamics import Motion
from drake_rho.scenario.records import Scenario


def check_norms(scenario: Scenario, motion: Motion) -> Iterator[Column]:
    """The check of every limit on a norm that the scenario has.

    The velocity is linear in a step, so its norm, which is convex, is largest at a knot.
    """
    speeds = scenario.fleet.max_speeds()
    if speeds is None:
        return
    norms = np.linalg.norm(motion.velocities, axis=2)
    k = np.argmax(norms, axis=1)  # the first value that is no number, if there is one
    largest = norms[np.arange(len(k)), k]
    yield Column(
        constraint="maximum speed",
        parts=[""] * len(k),
        times=scenario.grid.times[k],
        values=largest,
        limits=speeds.most,
        excess=largest - speeds.most,
        tolerances=speeds.tolerances,
        unit=UNITS["velocity"],
        due=np.isfinite(speeds.most),
    )
