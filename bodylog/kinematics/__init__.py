"""Kinematics: a URDF, a camera and their unknowns, as the mean of what a camera sees."""
