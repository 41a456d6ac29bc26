"""The page around Meshcat: its overlay of numbers and controls, and films of it.

A plan, flight or simulation comes in; one HTML page, a server of it or a film goes out. The overlay
in the browser only displays numbers computed in Python.
"""
