"""Tracks with kinematics as their mean: a URDF, a camera and their unknowns."""
