"""Order of the motion model, and what depends on it."""

EVEN = {2: 16, 3: 4}
"""Instants after which a covariance is made symmetric, before rounding errors grow, by the motion's order."""
