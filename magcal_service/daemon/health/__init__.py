"""Health of the daemon: figures, their report, Prometheus text.

Imports config, wire and the ground.
"""
