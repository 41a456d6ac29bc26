"""Collision-free initial guesses: paths and space-time paths around obstacles, found on grids.

A scenario comes in. References for the convex subproblems go out: motions along a path or near it.
They keep clear of obstacles but need not respect the limits of the vehicles.
"""
