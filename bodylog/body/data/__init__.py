"""Readings to training pairs: angles at images, selection, what was shown."""
