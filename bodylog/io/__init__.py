"""Atomic files, checks of outputs, safe values from files, and logs behind URLs."""
