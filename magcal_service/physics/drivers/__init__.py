"""Drivers of effects that are inferred where they were not recorded: warmth, torquing, changes in time, slow drifts.

Imports ``scene`` and the interface of effects.
"""
