"""Whole recordings: calibrate, replay through the daemon, and check that a replay equals its session.

Imports daemon and every room below it.
"""
