"""Planning in windows while flying: model predictive control with a shrinking horizon.

A scenario, and measured states where there are any, come in; a `Window` for each replanning and the
`Flight` that they make up go out.
"""
