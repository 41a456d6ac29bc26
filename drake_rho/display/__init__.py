"""Visualisation of plans, flights and simulations.

The output is figures (`plots`), a Meshcat scene (`meshcat`) or a page with controls (`viewer`).
The quantities shown are computed in `common`, once for all three.
"""
