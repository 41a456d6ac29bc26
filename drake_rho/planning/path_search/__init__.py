"""Initial guesses: paths and space-time paths past obstacles, found on grids.

A scenario comes in; references for the convex subproblems go out, as motions along a path or near
it. They keep clear of obstacles, and need not keep the vehicles' limits.
"""
