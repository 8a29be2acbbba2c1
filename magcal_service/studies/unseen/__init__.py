"""What may go wrong unseen: flights of known truth, what is done to them, how the daemon fares (``integrity``).

Imports the flights of the studies, the daemon's pipeline, config, wire and the ground.
"""
