"""Seeing it: plots of plans and flights, and the swarm in Meshcat."""
