"""Parts of the estimator ``spin``: a steady spin as a state, its search, fit, start and watch.

Imports ``parts`` and what that imports; no estimator.
"""
