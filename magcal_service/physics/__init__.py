"""What disturbs a magnetometer: what an effect is, the catalogue, what a recording offers, and their application.

Imports wire's messages and the ground.
"""
