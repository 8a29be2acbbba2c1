"""Concealed cases in many regimes of motion, sampling and noise, by a simulator that shares nothing with the product.

``python -m tests.regimes --seed S --n N --out DIR`` writes the cases, ``python -m tests.regimes.score DIR`` diagnoses
and scores them.  README.md has the regimes, the conventions of the answers and what is counted.
"""
