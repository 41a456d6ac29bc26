"""Quadratic programs: from a table of rows to a solution. Loops over rows are in `scp`.

Rows of half-spaces come in; accelerations and multipliers go out. A program is written in the form
that suits its size (dual, reduced, sparse or conic); if a solver fails on it, others follow.
"""
