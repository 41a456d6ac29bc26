"""Sequential convex programming: loops that add rows and loops that linearise constraints.

Given a scenario and a reference, they return a plan near the reference, or an error that names the
conflicting constraints.
"""
