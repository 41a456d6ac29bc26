"""Convex shapes: spheres, boxes, ellipsoids, cylinders and polytopes.

Every shape has the functions defined in `base`, which return distances, supporting half-spaces and
surfaces from its dimensions.
"""
