"""Motions of vehicles: dynamics, and records of planned and flown trajectories."""
