"""Simulation of flights in wind, with feedback and replanning; worst-case winds and attacks."""
