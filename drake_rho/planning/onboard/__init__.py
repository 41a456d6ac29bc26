"""Vehicles that plan for themselves, against the plans that others share.

A vehicle announces a plan, waits until every other one has heard it, and commits itself to it only
if no plan that it has heard conflicts.
"""
