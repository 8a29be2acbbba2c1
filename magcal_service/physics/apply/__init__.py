"""The catalogue applied: the forward model, live compensation and ``physics.toml``.

Imports the catalogue, ``drivers`` and ``scene``; effects by their interface only.
"""
