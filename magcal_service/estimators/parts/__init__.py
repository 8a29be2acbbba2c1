"""Parts that several estimators share: unscented transform, spin windows, batch start, process noise.

Imports the interface of estimators, ticks, config and the ground; no estimator.
"""
