"""What disturbs a magnetometer: what an effect is, the catalogue, what a recording offers, and their application.

Imports config, recordings by type, and the ground.
"""
