"""Receding-horizon planning in flight: model predictive control with a shrinking horizon.

Inputs are a scenario and, if available, measured states. Outputs are a `Window` for each replanning
and the `Flight` composed of them.
"""
