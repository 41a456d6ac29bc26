"""What must hold, as rows of half-spaces: normal · quantity(time) >= bound.

A scenario and, for what is not convex, a reference motion come in; `Constraint`s go out, each of
which returns the rows that a motion violates. Nothing here knows of programs or solvers.
"""
