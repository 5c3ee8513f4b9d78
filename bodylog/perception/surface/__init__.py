"""The robot's own surface in images: repeated frames, corners, and their tracks."""
