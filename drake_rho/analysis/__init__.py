"""What can be proved of a plan, and why there is none.

A plan comes in and a lower bound on the cost of every plan goes out (`certify`); a scenario comes
in and a diagnosis, the constraints that conflict or the shortest plan go out (`diagnose`,
`infeasible_subset`, `shortest_plan`). Planners and the verifier are called, never changed.
"""
