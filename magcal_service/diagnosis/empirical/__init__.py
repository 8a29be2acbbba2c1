"""What has no name, as curves over drivers: what a curve is, which are tried, what they gain, which are kept.

Imports the rest of the diagnosis but what comes out of it: the screening's and the explanation's steps, and the ground.
"""
