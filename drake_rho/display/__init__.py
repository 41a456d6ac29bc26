"""Seeing plans, flights and simulations.

They come in, and figures (`plots`), a Meshcat scene (`meshcat`) or a page with controls (`viewer`)
go out. What is shown is computed in `common`, once for all three.
"""
