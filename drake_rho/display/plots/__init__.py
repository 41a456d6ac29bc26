"""Figures with matplotlib, for papers and reports.

The input is plans, flights, simulations and results of campaigns; the output is figures or their
files.
"""
