"""Concealed cases: where they lie, what is true of each, what is said of it, and how the two are compared.

Imports the diagnosis' answer, physics, many and base.
"""
