"""Convex shapes: spheres, boxes, ellipsoids, cylinders and polytopes.

A shape's dimensions come in; distances, supporting half-spaces and surfaces go out, by the
functions that every shape has (`base`).
"""
