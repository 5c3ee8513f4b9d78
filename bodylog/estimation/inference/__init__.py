"""The Gaussian engine: one pass over a log, the same
instant by instant, and re-acquisition after silences.
"""
