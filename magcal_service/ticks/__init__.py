"""Samples in, one-second ticks out; time is an argument.

Imports config, wire's messages and the ground; no clock, no I/O.
"""
