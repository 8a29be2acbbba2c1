"""Real recordings: what is asked of them, what is known of them, and how one question is answered.

Imports diagnosis, recordings and physics.
"""
