"""Data shared by all displays: motions to draw, clearances, names, colours.

The input is a plan, flight or simulation; the output is arrays, texts and styles. Nothing is drawn
here.
"""
