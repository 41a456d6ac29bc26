"""Animation in Meshcat: vehicles, obstacles, trails, tubes and wind.

The input is a plan, flight or simulation; the output is a running Meshcat with the recorded
animation.
"""
