"""Concealed cases in many regimes of motion, sampling and noise, by a simulator that shares nothing with the product.

``python -m tests.regimes --seed S --n N --out DIR`` writes the cases, ``magcal study concealed --recordings DIR``
diagnoses and scores them.  README.md has the regimes and the conventions of the answers.
"""
