"""What all displays share: what is drawn of a plan, clearances, names, colours.

A plan, flight or simulation comes in; arrays, words and styles go out, without any drawing.
"""
