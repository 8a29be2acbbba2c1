"""Figures for a paper (``magcal plot``, extra ``view``): of a recording, a result, a diagnosis or a study.

Imports diagnosis and rooms below it.
"""
