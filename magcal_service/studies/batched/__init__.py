"""The filters of the studies, many runs at once.

Imports estimators and the ground.
"""
