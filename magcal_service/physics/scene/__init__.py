"""What a recording offers to an effect: field, places, light, spin, channels.

Imports the ground; no effect.
"""
