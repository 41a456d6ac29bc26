"""`python ampyc_sets.py CASES SUPPORTS`: disturbance reachable sets of a sampled loop by ampyc.

It runs in an environment that has ampyc and not this package, and so imports neither the package
nor its benchmarks. Time is in samples and acceleration in units of the wind, since ampyc's
tolerances are absolute. Both files are JSON:

- CASES: a list of records with `alpha` and `beta` (the gains k_p δ² and k_v δ), `delay` (0 or 1),
  `position_error` and `velocity_error` (in the units of the loop, W = 1), and `samples`.
- SUPPORTS: for each case, the largest error of the position and of the velocity at the end.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from ampyc.utils import Polytope
from ampyc.utils.set_computation import compute_drs

PIECES = 4
"""Pieces of a sample, in each of which a wind is constant."""


def supports(case: dict[str, Any]) -> list[float]:
    """Return the largest errors at the end of the flight of one case."""
    gains = np.array([case["alpha"], case["beta"]])
    errors = float(gains @ [case["position_error"], case["velocity_error"]])
    free, acts = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([0.5, 1.0])
    wind = _wind()
    if case["delay"] == 0:
        loop = free - np.outer(acts, gains)
        sides = [wind + errors * acts, wind - errors * acts] if errors else [wind]
    else:  # the third state is the feedback that acts in the next sample
        loop = np.zeros((3, 3))
        loop[:2, :2], loop[:2, 2], loop[2, :2] = free, acts, -gains
        flat = np.column_stack([wind, np.zeros(len(wind))])
        error = np.array([0.0, 0.0, errors])
        sides = [flat + error, flat - error]
    disturbances = Polytope(vertices=np.vstack(sides))
    last = compute_drs(loop, disturbances, case["samples"])[-1]
    return [float(last.support(direction)) for direction in np.eye(len(loop))[:2]]


def _wind() -> np.ndarray:
    """Return the effects on (e_p, e_v) of winds of at most 1 in a sample: vertices (V, 2).

    They form a zonotope. Its sides are the effects of a wind in each piece, in the order of their
    slopes.
    """
    left = 1.0 - (np.arange(PIECES) + 0.5) / PIECES
    effects = np.column_stack([left, np.ones(PIECES)]) / PIECES
    signs = np.where(np.tri(PIECES, dtype=bool), -1.0, 1.0)  # the first pieces against the others
    half = np.vstack([np.ones(PIECES), signs]) @ effects
    return np.unique(np.vstack([half, -half]).round(15), axis=0)


if __name__ == "__main__":
    cases = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    Path(sys.argv[2]).write_text(json.dumps([supports(case) for case in cases]), encoding="utf-8")
