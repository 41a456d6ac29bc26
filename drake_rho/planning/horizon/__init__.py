"""Receding-horizon planning in flight: model predictive control with a shrinking horizon.

A scenario comes in, and measured states if there are any. A `Window` for each replanning and the
`Flight` composed of them go out.
"""
