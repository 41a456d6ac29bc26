"""One tolerance for each kind of comparison, and where it comes from."""

INDEX = 1e-6
"""Relative, for the index: what the published figures and two solvers must agree to."""

ROUNDING = 1e-9
"""Relative, for two ways of computing the same thing in double precision."""

MOTION = 1e-5
"""Relative to the largest acceleration, between two solvers' answers: an index of relative error
1e-10, the solvers' own tolerance, leaves the accelerations an error of its square root."""
