"""What a user may write: settings, their TOML, link addresses, and the check that files are private.

Imports the physics file, wire and the ground.
"""
