"""A descriptor made from a raw log: what names and numbers agree on is concluded, the rest is asked.

Imports the readers and specs of recordings, the defects that ``inspect`` finds, earth and base.
"""
