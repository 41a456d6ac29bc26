"""Figures with matplotlib, for papers and reports.

Plans, flights, simulations and results of campaigns come in; figures go out, or files of them.
"""
