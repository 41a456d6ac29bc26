"""How a plan is found: quadratic programs, the loop that adds rows, and the three planners."""
