"""Decode image messages and video files to BGR arrays."""
