"""Features common to all calls of planners: options, progress, time limit and wall time.

A function that plans is decorated with the last two; options and progress are its arguments.
"""
