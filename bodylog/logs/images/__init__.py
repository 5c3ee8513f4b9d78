"""Image messages and video files to BGR arrays."""
