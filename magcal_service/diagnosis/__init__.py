"""Where simulation and recording differ: residuals -> locate -> explain -> refit -> report."""
