"""Gaussian inference: the filter of a log in stretches or instant by instant, re-acquisition after
silences, and the backward pass of the smoother.
"""
