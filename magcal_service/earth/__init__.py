"""The Earth's main field (IGRF-14), the frames that it is given in, and where a craft is by its element sets.

It imports ``base`` alone.
"""
