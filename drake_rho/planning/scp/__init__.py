"""The loops: cutting planes add rows, sequential convex programming linearises anew.

A scenario and a reference come in; a plan near it goes out, or the error that says which rows
cannot be met together.
"""
