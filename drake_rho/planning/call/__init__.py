"""What comes with every call of a planner: options, progress, a time limit and the wall time.

A function that plans is decorated with the last two; options and progress are its arguments.
"""
