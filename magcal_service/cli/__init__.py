"""The ``magcal`` command, one file a command: parse, call, print.

Imports any room; no room imports it.
"""
