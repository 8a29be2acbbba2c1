"""Verdict, reasons, remedies and degraded modes.

Imports estimators, ticks, config and the ground; no clock, no I/O.
"""
