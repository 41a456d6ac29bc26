"""The swarm in Meshcat: vehicles, obstacles, trails, tubes and their animation.

A plan, flight or simulation comes in; a running Meshcat with the recorded animation goes out.
"""
