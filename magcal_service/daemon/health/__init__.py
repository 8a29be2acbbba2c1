"""How the daemon is: figures, their report, Prometheus text.

Imports config, wire and the ground.
"""
