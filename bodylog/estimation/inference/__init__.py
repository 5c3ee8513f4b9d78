"""Gaussian inference: the filter of a whole log or instant by instant, re-acquisition after
silences, and the backward passes of the smoother.
"""
