"""Noise of each sense and process noise of the joints:
learned from the log, the body's, or the paper's.
"""
