"""Evaluation: how good an estimate is, with and without truth, and bounds on that."""
