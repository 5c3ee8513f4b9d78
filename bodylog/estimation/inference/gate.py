"""The gate of the filter: readings too far from the belief to be Gaussian."""

GATE_SIGMA = 5.0
"""Standard deviations: a larger innovation d has its noise
inflated so that its weight falls as (GATE_SIGMA/d)⁴.
"""
FLAT_COST_NATS = 1.0
"""Nats from the gate's ½ GATE² to an outlier's cost anywhere:
one in a hundred in an image of 320×240 px costs 14.
"""
