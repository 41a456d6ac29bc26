"""Tolerances, one for each kind of comparison, and their origin."""

TOLERANCE = 1e-6
"""Relative, of all constraints: a violation that counts as rounding, as documented."""

INDEX = 1e-6
"""Relative, for the index: agreement required of the published figures and of two solvers."""

ROUNDING = 1e-9
"""Relative, for two ways of computing the same thing in double precision."""

MOTION = 1e-5
"""Relative to the largest acceleration, between the answers of two solvers: the solvers' relative
tolerance of the index, 1e-10, leaves accelerations an error of its square root."""
