"""Evaluation: scores of an estimate with and without truth, and bounds on them."""
