"""Touches of the skin, strokes seen, and how they match in time."""
