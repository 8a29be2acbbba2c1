"""What an effect is driven by where nobody recorded it: warmth, torquing, changes in time, slow drifts.

Imports ``scene`` and the interface of effects.
"""
