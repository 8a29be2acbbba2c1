"""The effects, one a file, found by its presence.

An effect imports the interface, ``drivers`` and ``scene``, never another effect.
"""
