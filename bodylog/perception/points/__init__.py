"""A patch without a marker, followed from image to image."""
