"""Coloured things in images: ranges, blobs, centres, tracks."""
