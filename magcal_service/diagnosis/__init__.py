"""Where simulation and recording differ: residuals -> locate -> explain -> refit -> report.

Imports offline and every room below it, but daemon, links and watch; of views, the page's style.
"""
