"""Findings about one log: faults, changes, misfits, the verdict and its figures."""
