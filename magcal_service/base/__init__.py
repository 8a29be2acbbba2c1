"""What every room stands on: the version, the errors, units, logs, files written whole, progress, memory, typed TOML.

Nothing here knows of a magnetometer; it imports its own modules alone.
"""
