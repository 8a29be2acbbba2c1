"""Recordings: a log described by a TOML file, read row by row into the messages of the wire.

Imports config, the scene of physics, wire and the ground.
"""
