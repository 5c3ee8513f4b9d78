"""Touches of the skin, strokes in the images, and their match in time."""
