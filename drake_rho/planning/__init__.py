"""Planning: from a scenario to a plan or a flight in windows.

A `Scenario` comes in; a `Plan` or a `Flight` goes out, or an `InfeasibleError` with its reason.
`planners` and `horizon` are what users call. They iterate convex subproblems (`scp`), which are
solved as quadratic programs (`programs`) from initial guesses that `path_search` finds; what must
hold enters both as rows of half-spaces (`constraints`).
"""
