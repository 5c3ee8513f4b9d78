"""A track's mean from a URDF, a camera and their unknowns."""
