"""The watch over the model: running sums of the residual, their evidence, drivers at a sample's time.

Imports estimators, ticks, config and the ground; no clock, no I/O.
"""
