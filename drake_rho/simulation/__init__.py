"""Simulation of flights in wind, with feedback and replanning; worst-case winds and attacks."""

from drake_rho.simulation import winds as winds
