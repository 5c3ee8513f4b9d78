"""Layouts and recordings for Foxglove and Rerun."""
