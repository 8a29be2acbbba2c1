"""Many pieces of work at once: in a pool of processes, or on a dask cluster, with the same bits from each.

``pieces`` what a piece is and what becomes of it, ``plain`` values as data, ``identity`` what makes two pieces
the same, ``store`` finished ones on disk, ``pool`` and ``cluster`` the engines, ``executor`` all of it together.
Imports base alone.
"""
