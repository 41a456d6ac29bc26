"""Planning: from a scenario to a plan or a flight in windows.

A `Scenario` comes in; a `Plan` or a `Flight` goes out, or an `InfeasibleError` with its reason.
Users call `planners` and `horizon`. These iterate convex subproblems (`scp`), which are solved as
quadratic programs (`programs`), from initial guesses by `path_search`. Constraints enter as rows of
half-spaces (`constraints`).
"""
