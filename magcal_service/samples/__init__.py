"""What samples and the field's magnitude show by themselves, before any estimator has run.

Imports the ground.
"""
