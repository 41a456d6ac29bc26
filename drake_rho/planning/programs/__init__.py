"""Rows to a quadratic program to a solution, without any loop.

Rows of half-spaces come in; accelerations and multipliers go out. A program is written in the form
that suits its size (dual, reduced, sparse or conic), and solvers are asked one after another.
"""
